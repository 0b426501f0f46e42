"""Runs that reach the end and are wrong: the rule, its sentences, and where they are told."""

from __future__ import annotations

import pytest
from planted import STEPS, edited, everything, page_data, plant, planted
from small_stores import atlas_with

from bench.results.quantities import TRUST, WRONG
from bench.results.records import SceneRecord
from bench.results.store import Store
from reports.pages.html_report import write_html_report
from reports.pages.markdown_report import write_markdown_report
from reports.questions import plain
from reports.series import series_of
from reports.verdicts import method_card
from reports.wrong import STIFF, UNDAMPED, silent_tables, wrong_on, wrong_sentences

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
    scenes = {"s": SceneRecord(problem="s", t_end=1.0, t0=0.0, difficulties=["It is stiff."])}

    def found(group="a"):
        return [wrong_on("s", s, group, None, {}) for s in series]

    def said(group="a"):
        other = [w._replace(scene="t", silent=0, warned=0, judged=0) for w in found(group)]
        return [*map(plain, wrong_sentences([*found(group), *other], group, {}))]

    head = (
        "Wrong without warning: {} of 4 runs that reached the end "
        "(error in acceleration above 0.1, largest over time){}."
    )
    never = "Wrong without warning at every step and tolerance (smallest error): wrong ({}0.2)."
    assert said() == [head.format(3, ""), never.format("s: ")]
    assert plain(wrong_sentences(found(), "a", {}, "s")[-1]) == never.format("")
    assert said("lam") == []
    every, coarsest = silent_tables(found(), "a", scenes)
    assert every.caption == "Wrong at every resolution, in acceleration: 2 runs"
    assert every.rows == [["wrong", "s", "2 of 2", "0.2 at h=0.05", "It is stiff."]]
    assert coarsest.rows[0][:3] == ["late", "s", "1 of 2"]
    series[0].records[0].message = "It may be wrong."  # one run of them says nothing
    assert said() == [head.format(2, "; with a warning: 1"), never.format("s: ")]
    for record in (*series[0].records, *series[1].records):
        record.message = "It may be wrong."
    assert said() == [head.format("none", "; with a warning: 3")]
    assert silent_tables(found(), "a", scenes) == []


def cause(s, group, scene, atlas):
    return wrong_on("s", s, group, scene, atlas).cause


def test_a_cause_is_named_where_its_experiment_hit_the_method_on_such_a_scene():
    tolerance = {"formulation": "index3", "controls": "tolerance", "rtol": 1e-3}
    for group, error, changes, scene, why in [
        ("a", 9.0, {}, FAST, STIFF),
        ("a", 9.0, {"work": {"steps": 32}}, FAST, ""),
        ("a", 9.0, {"work": {"steps": 31}}, FAST, STIFF),
        ("v", 9.0, {}, FAST, ""),
        ("a,lam", 9.0, {}, FAST, STIFF),
        ("a", 9.0, {}, None, ""),  # it has no constraints
        ("a", 9.0, {"formulation": "index3"}, None, UNDAMPED),
        ("a", 9.0, tolerance, None, ""),
        ("a", 9.0, {"pattern": (0.3, 0.7)}, None, "variable_steps"),
    ]:
        name = "m[rho_inf=1,newton=modified]"
        made = [planted("s", name, {}, h=h, **{"work": {"steps": 10}, **changes}) for h in STEPS]
        for run in made:
            run.errors = {**{g: {"max": error} for g in group.split(",")}, "q": {"max": run.h**2}}
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
    assert count.startswith("Wrong without warning: ")
    lead = "Wrong without warning at every step and tolerance (smallest error)"
    assert silent == f"{lead}: ringing 1 (pendulum: 9)."
    write_html_report(store)
    write_markdown_report(store)
    data = page_data(store)
    assert data["wrong"]["a"]["filters"]["all"][0] == [count]
    for page in ("report.md", "report/failures.html"):
        assert count.partition("(")[0] in (store / page).read_text(encoding="utf-8"), page
    own = method_card(store, "ringing[rho_inf=1]")
    assert "Wrong without warning: 6 of 6 runs" in " ".join(own)
    assert "without warning" not in " ".join(method_card(store, "adaptive"))


def test_the_cause_leads_to_the_chapter_of_the_atlas(store):
    folder = edited(store, "with_atlas", lambda r: None)
    with Store(folder, create=True) as opened:
        opened.keep(atlas_with("ringing[rho_inf=1]", UNDAMPED)[UNDAMPED])
    write_html_report(folder)
    pages = folder / "report"
    assert (pages / "atlas.html").read_text().count(f'id="atlas-{UNDAMPED}"') == 1
    failures = (pages / "failures.html").read_text()
    assert f'href="atlas.html#atlas-{UNDAMPED}"' in failures
    assert "2 · silent 8</span>" in failures
