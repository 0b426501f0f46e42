"""Notes on runs that reach the end, and runs that are wrong without one."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import cell_of, long, reference, toy
from planted import STEPS, edited, everything, page_data, plant, planted
from small_stores import atlas_with

from bench.results.quantities import TRUST, WRONG
from bench.results.records import Record, SceneRecord, endings
from bench.results.store import Store
from bench.running.scene_records import uncontrolled
from bench.running.worker import Worker
from integrators import Tolerances, Trajectory
from integrators.checks import caution
from integrators.methods.hht_i3 import HHTI3
from problems.base.checks import FalseAnswer
from problems.scenes.oscillators import DrivenSprings
from problems.scenes.pendulums import DoublePendulum, Pendulum, StiffBar
from problems.scenes.slider_crank import SliderCrank, SliderCrankMinimal
from reports.pages.html_report import write_html_report
from reports.pages.markdown_report import write_markdown_report
from reports.questions import plain
from reports.scenes import NO_SCENE, StoredRuns
from reports.series import series_of
from reports.tables.run_tables import notes_table
from reports.verdicts import failings, method_card
from reports.wrong import STIFF, UNDAMPED, silent_tables, wrong_on, wrong_sentences


def exact_run(scene, steps: int, part: float = 1.0) -> Trajectory:
    """The exact motion at equal steps over a part of the interval."""
    t0, t_end = scene.interval
    t_end = t0 + part * (t_end - t0)
    t = np.linspace(t0, t_end, steps + 1)
    values = reference(scene, t_end)(t)
    return Trajectory(
        t, **{group: values[group] for group in ("q", "v", "a", "lam", "x", "xdot", "y")}
    )


@pytest.mark.parametrize(
    "cases", [((Pendulum(), 30),), *long([(SliderCrank(), 200), (DoublePendulum(), 50)])]
)
def test_a_motion_without_fast_vibrations_has_no_note(cases):
    for rtol in [0.3, 1e-3]:
        for scene, steps in cases:
            assert uncontrolled(scene, exact_run(scene, steps), rtol) == ""


def test_a_vibration_that_v_hides_is_told_until_the_tolerance_sees_its_phase():
    """18124 rad/s in 10 s are 28 845 periods; v is 7.72 m/s and dv/dt, averaged, 19.6 m/s^2."""
    for rtol, speaks in [(1e-3, True), (1e-6, True), (1e-8, True), (1e-11, False)]:
        note = uncontrolled(StiffBar(), exact_run(StiffBar(), 1000), rtol)
        assert bool(note) == speaks
        assert not speaks or ("1.81e+04 rad/s" in note and "smaller rtol" in note)
        assert not speaks or "a step spans 29 periods of the fastest vibration" in note


def test_constant_steps_of_more_than_half_a_period_leave_it_out():
    for h, speaks in [(1e-2, True), (1.8e-4, True), (1.6e-4, False)]:
        note = uncontrolled(StiffBar(), exact_run(StiffBar(), round(0.1 / h), 0.01), None)
        assert bool(note) == speaks
        assert not speaks or "smaller steps" in note


def test_rows_of_a_long_run_are_further_apart_than_its_steps():
    run = exact_run(StiffBar(), 100, 0.01)
    assert uncontrolled(StiffBar(), run, None) != ""
    run.work.steps = 1000
    assert uncontrolled(StiffBar(), run, None) == ""


def test_a_vibration_that_dies_out_adds_up_no_longer():
    """Of 5000 periods of the spring 3.4 are over when it has fallen to 1/e; the natural size of a
    is 1.44 m/s^2, not that of the jolt at the start."""
    for rtol, speaks in [(1e-5, True), (1e-7, False)]:
        note = uncontrolled(DrivenSprings(), exact_run(DrivenSprings(), 1000), rtol)
        assert bool(note) == speaks
        assert not speaks or "3.16e+03 rad/s" in note


def measured(worker: Worker, scene: str, method: str, t_end: float, resolution) -> Record:
    record = worker.measure(cell_of(worker.registry, scene, method, t_end, resolution)).record
    assert record.status == "ok", record.message
    return record


OTHERS = [
    ("radau_iia", 1e-4), ("generalized_alpha_adaptive", 1e-3), ("bdf_adaptive", 1e-3),
    ("hht_i3", 1e-4), ("ida", 1e-2), ("cvode", 1e-2), ("kvaerno5", 1e-2), ("radau", 1e-2),
]  # fmt: skip


@pytest.mark.parametrize("cases", [[("rodas5p", 1e-4)], *long(OTHERS)])
def test_every_method_with_a_tolerance_says_so(worker, cases):
    for method, rtol in cases:
        record = measured(worker, "stiff_bar", method, 0.1, Tolerances(rtol))
        assert "Accelerations are not controlled" in record.message
        assert record.error("a", "max") > 0.1  # the note is true
        assert record.notes[0] == record.message
        assert record.notes[-1].startswith("Errors above 0.1")


def test_the_published_mix_of_forces_says_that_it_loses_its_order_where_the_mass_varies():
    varying, forces = SliderCrankMinimal(), HHTI3(mixed="forces")
    assert "order 1 here, not 2" in (forces.caution(varying) or "")
    assert forces.caution(Pendulum()) is None
    assert HHTI3().caution(varying) is None


def test_a_caution_is_none_or_a_sentence():
    with pytest.raises(FalseAnswer, match="caution"):
        caution(toy(base=HHTI3, caution=lambda self, scene: "")(), Pendulum())


def test_errors_above_a_tenth_are_a_note_and_those_of_failed_runs_are_none():
    record = everything()[0]
    record.status, record.message, record.errors = (
        "ok",
        "",
        {"q": {"max": 0.11}, "v": {"max": 0.09}},
    )
    record.claims, record.rtol = {"q": 2}, None
    (note,) = record.notes
    assert note.endswith(": q 0.11; its steps are too large for order 2.")
    record.rtol = 1e-4
    assert record.notes[0].endswith("; the error of q is 1.1e+03 times rtol.")
    record.status = "diverged"
    assert record.notes == []


def test_runs_with_a_note_are_counted_and_listed():
    noted, other = everything()[:2]
    noted.status = other.status = "ok"
    noted.message, other.message = "It may be wrong.", ""
    assert endings([noted, other]) == "2 ok (1 with a warning), 0 failed with a reason"
    table = notes_table([noted, noted, other])
    assert table is not None
    assert [row[2:] for row in table.rows] == [["2", "It may be wrong."]]
    assert notes_table([other]) is None


#: A vibration of 100 rad/s in an interval of 1 s.
FAST = SceneRecord(problem="s", t_end=1.0, t0=0.0, rates={"oscillation": 100.0})


def runs(name, *errors, scene="s", **changes):
    return [
        planted(scene, name, {}, h=h, errors={"a": {"max": e}}, **changes)
        for h, e in zip(STEPS, errors, strict=False)
    ]


def test_a_run_is_wrong_that_ends_well_with_a_large_error():
    for changes, wrong in [
        ({}, True),
        ({"errors": {"a": {"max": WRONG}}}, False),
        ({"errors": {"a": {"max": None}}}, False),
        ({"errors": {"q": {"max": 9.0}, "a": {"max": 0.0, "end": 9.0}}}, False),
        ({"status": "diverged"}, False),
        ({"reference_error": {"a": {"max": 0.3 / TRUST}}}, False),  # cannot be judged
        ({"reference_error": {"a": {"max": 0.1 / TRUST}}}, True),
        ({"message": "It may be wrong."}, True),
    ]:
        run = planted("s", "m", {}, h=0.1, **{"errors": {"a": {"max": 0.2}}, **changes})
        assert run.wrong("a") == wrong
        assert any("Errors above" in note for note in run.notes) == (wrong or run.wrong("q"))


def test_an_integrator_is_told_whose_every_run_that_ended_is_wrong():
    failed = planted("s", "open", {}, h=0.1, status="diverged")
    series = series_of([*runs("wrong", 3.0, 0.2), *runs("late", 3.0, 0.05), failed])
    scene = SceneRecord(problem="s", t_end=1.0, t0=0.0, difficulties=["It is stiff."])
    atlas = atlas_with("wrong", UNDAMPED)
    stored = StoredRuns("", {}, {"s": scene}, {}, atlas=atlas)

    def found(group="a"):
        return [wrong_on("s", s, group, NO_SCENE, {}) for s in series]

    def said(group="a"):
        other = [w._replace(scene="t", silent=0, warned=0, judged=0) for w in found(group)]
        return [*map(plain, wrong_sentences([*found(group), *other], group, {}))]

    head = (
        "Silently wrong: {} of 4 runs that reached the end "
        "(error in acceleration above 0.1, largest over time){}."
    )
    never = "Wrong at every step and tolerance (smallest error): wrong ({}0.2)."
    assert said() == [head.format(3, ""), never.format("s: ")]
    assert plain(wrong_sentences(found(), "a", {}, "s")[-1]) == never.format("")
    assert said("lam") == []
    for label, when in {"wrong": "always", "late": "coarsest run alone (1 scene)"}.items():
        first, count, *_ = map(plain, failings(label, "a", stored, found()))
        assert first == f"Silently wrong, {when}: s."
        assert count.startswith("These are ")
    seldom = [w._replace(label="m", scene=w.kind or "t") for w in found()]
    seldom.append(seldom[0]._replace(scene="t", warned=1))  # not always silently
    assert plain(failings("m", "a", stored, seldom)[0]) == (
        "Silently wrong, always: every; sometimes: t; coarsest run alone (1 scene): coarsest."
    )
    every, coarsest = silent_tables(found(), "a", stored)
    assert every.caption == "Wrong at every resolution, in acceleration: 2 runs"
    assert every.rows == [["wrong", "s", "2 of 2", "0.2 at h=0.05", "difficulty: It is stiff."]]
    told = [w._replace(cause=UNDAMPED) for w in found()]
    assert silent_tables(told, "a", stored)[0].rows[0][-1] == "1. About undamped_index3"
    assert coarsest.rows[0][:3] == ["late", "s", "1 of 2"]
    series[0].records[0].message = "It may be wrong."  # one run of them says nothing
    assert said() == [head.format(2, "; 1 more with a warning"), never.format("s: ")]
    for record in (*series[0].records, *series[1].records):
        record.message = "It may be wrong."
    assert said() == [head.format(3, "").replace("Silently wrong", "Wrong with a warning")]
    assert silent_tables(found(), "a", stored) == []


def cause(s, group, scene, atlas):
    return wrong_on("s", s, group, scene, atlas).cause


def test_a_cause_is_named_where_its_experiment_hit_the_method_on_such_a_scene():
    tolerance = {"formulation": "index3", "controls": "tolerance", "rtol": 1e-3}
    for group, error, changes, scene, why in [
        ("a", 9.0, {}, FAST, STIFF),
        ("a", 9.0, {"work": {"steps": 32}}, FAST, ""),
        ("a", 9.0, {"work": {"steps": 31}}, FAST, STIFF),
        ("v", 9.0, {}, FAST, ""),
        ("lam", 9.0, {}, FAST, STIFF),
        ("a", 9.0, {}, NO_SCENE, ""),  # it has no constraints
        ("a", 9.0, {"formulation": "index3"}, NO_SCENE, UNDAMPED),
        ("a", 9.0, tolerance, NO_SCENE, ""),
        ("a", 9.0, {"pattern": (0.3, 0.7)}, NO_SCENE, "variable_steps"),
    ]:
        name = "m[rho_inf=1,newton=modified]"
        made = [planted("s", name, {}, h=h, **{"work": {"steps": 10}, **changes}) for h in STEPS]
        for run in made:
            run.errors = {group: {"max": error}, "q": {"max": run.h**2}}
        (s,) = series_of(made)
        known = STIFF, UNDAMPED, "variable_steps"
        for method, told in (("m[rho_inf=1]", why), ("m", ""), ("spared", "")):
            assert cause(s, group, scene, atlas_with(method, *known)) == told
        assert cause(s, group, scene, {}) == ""
        for run in made:
            run.errors["q"]["max"] = 0.2  # the motion itself is wrong
        assert cause(s, group, scene, atlas_with("m[rho_inf=1]", *known)) == ""


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """Runs of which one integrator is never right, and another one says so itself."""

    def spoil(r):
        if r.problem == "pendulum" and r.integrator.startswith(("ringing", "good[rho_inf=0.5]")):
            r.errors["a"]["max"], r.errors["lam"]["max"] = 9.0, r.h**2
            r.formulation = "index3"
            r.message = "" if r.integrator.startswith("ringing") else "It may be wrong."

    folder = plant(tmp_path_factory.mktemp("wrong") / "results", everything())
    return edited(folder, "spoilt", spoil)


def test_pages_and_terminal_say_the_same(store):
    operations, time, count, silent = method_card(store, "")
    assert operations.startswith("Fewest operations to 1e-4 in acceleration: ")
    assert operations.endswith("cheapest on 1 of 2 scenes.")
    assert time.startswith("Least time to 1e-4 in acceleration: good 0.8 is cheapest on both ")
    assert count.startswith("Silently wrong: ")
    lead = "Wrong at every step and tolerance (smallest error)"
    assert silent == f"{lead}: ringing 1 (pendulum: 9)."
    write_html_report(store)
    write_markdown_report(store)
    data = page_data(store)
    assert data["wrong"]["a"]["filters"]["all"][0] == [count]
    (failed, *_) = [s for (s, *_) in data["wrong"]["a"]["scenes"] if s[0] == "Failed: "]
    assert " Difficulty: λ oscillates." in failed
    for page in ("report.md", "report/failures.html"):
        assert count.partition(": ")[2].partition("(")[0] in (store / page).read_text(
            encoding="utf-8"
        ), page
    own = method_card(store, "ringing[rho_inf=1]")
    assert "pendulum. These are 6 of 6 runs" in " ".join(own)
    assert "ilently wrong" not in " ".join(method_card(store, "adaptive"))


def test_the_cause_leads_to_the_chapter_of_the_atlas(store):
    folder = edited(store, "with_atlas", lambda r: None)
    with Store(folder, create=True) as opened:
        opened.keep(atlas_with("ringing[rho_inf=1]", UNDAMPED)[UNDAMPED])
    write_html_report(folder)
    pages = folder / "report"
    assert (pages / "atlas.html").read_text().count(f'id="atlas-{UNDAMPED}"') == 1
    failures = (pages / "failures.html").read_text()
    assert f'href="atlas.html#atlas-{UNDAMPED}"' in failures
    assert "2 · 8 wrong</span>" in failures
