"""Violations of constraints as errors: their size, their rounding, and questions about them."""

from dataclasses import replace

import numpy as np
import pytest
from chromium import each, visit
from helpers import reference, toy
from planted import answer, plant, planted

from bench.results.quantities import COSTS, NORMS, VIOLATIONS
from bench.running.errors import ROUNDING, constraint_errors, constraint_sizes, relative_errors
from bench.running.measure import constraint_unit
from integrators.contract import Trajectory, Work
from problems import jnp
from problems.scenes.oscillators import Oscillator
from problems.scenes.pendulums import Chain, Pendulum
from problems.scenes.slider_crank import SliderCrank, SliderCrankDriven
from problems.truth.reference import Reference
from reports.formatting import NO_VALUE
from reports.pages.html_report import write_html_report
from reports.questions import FIRST, Question, plain
from reports.ranking import answers
from reports.scenes import StoredRuns
from reports.series import series_of
from reports.tables.ranking_tables import targets_table, winners_table
from reports.tables.run_tables import held_table
from reports.verdicts import headline, stored_card, violation_text

HELD = Question("constraint", 1e-4, "operations")


def run_of(known, **off):
    """The reference as a run of 41 rows, off by these parts of the components' sizes."""
    t = np.linspace(known.scene.interval[0], known.t_end, 41)
    exact = known(t)
    for group, parts in off.items():
        exact[group] = exact[group] + parts * known.largest[group][0]
    return Trajectory(t=t, status="ok", work=Work(), **exact)


def largest(found):
    return {name: norms["max"] for name, norms in found.errors.items()}


def test_a_violation_is_no_larger_than_the_errors_that_make_it():
    known = reference(Pendulum(), 1.0)
    signs = np.random.default_rng(4).choice([-1, 1], (41, 2))
    for off in (1e-7 * signs, np.full((41, 2), 1e-7), 1e-7 * np.array([1, 0])):
        run = run_of(known, q=off, v=off)
        allowed = relative_errors(run, known).errors["q"]["max"]
        # Errors in q change Phi_q v, too: on this pendulum by at most as much.
        for name, factor in (("constraint", 1), ("constraint_velocity", 2)):
            assert 0.1 * allowed < largest(constraint_errors(run, known))[name] <= factor * allowed


def test_a_violation_depends_neither_on_the_unit_of_length_nor_on_turns_of_a_crank():
    found = []
    for length in (1.0, 1000.0):
        known = reference(Pendulum(length=length, g=9.81 * length), 1.0)
        found.append(largest(constraint_errors(run_of(known, q=1e-6, v=1e-6), known)))
    assert found[0] == pytest.approx(found[1], rel=1e-6)
    one, many = (reference(SliderCrankDriven(), t_end) for t_end in (0.05, 0.5))
    assert many.largest["q"][0].max() > 50  # rad
    np.testing.assert_allclose(*(constraint_sizes(known)[0] for known in (one, many)), rtol=2e-2)


def along(self, t):
    still, v = 0 * t, np.stack([2.0 + 0 * t, 1e-17 * np.cos(t)], axis=1)
    rows = {"q": np.stack([2 * t, still], axis=1), "v": v, "a": 0 * v}
    return rows | {"lam": still[:, None]}


#: A mass that goes along a rail at 2 m/s, and across it by rounding.
Rail = toy(
    "Rail", q=[0.0, 0.0], v=[2.0, 0.0], force=lambda self, q, v, t: jnp.zeros(2), exact=along,
    kinematics=lambda self, q, v: v, constraint=lambda self, q, t: 3.0 * q[1:],
)  # fmt: skip


def test_a_row_has_the_size_that_positions_and_velocities_give_it():
    """Phi = (x^2 + y^2 - L^2)/2 of a pendulum: Phi_q = (x, y); across a rail that of the motion."""
    known = reference(Pendulum(), 1.0)
    q, (of_q, _), (of_v, _) = (
        known(np.linspace(0.35, 1.0, 65))["q"], known.largest["q"], known.largest["v"]
    )  # fmt: skip
    sizes = constraint_sizes(known)
    assert sizes[0] == pytest.approx(np.max(np.abs(q) @ of_q), rel=1e-9)
    assert sizes[1] == pytest.approx(np.max(np.abs(q) @ of_v), rel=1e-9)
    for size in constraint_sizes(Reference(Rail(), 1.0)):
        assert size == pytest.approx([3 * 2.0], rel=1e-9)  # the way of 2 m


def test_exact_values_are_at_the_floor_in_every_norm_and_free_scenes_have_no_violation():
    known = reference(Pendulum(), 1.0)
    found = constraint_errors(run_of(known), known)
    assert set(found.errors) == set(VIOLATIONS)
    for name in VIOLATIONS:
        assert found.reference_errors[name] == dict.fromkeys(NORMS, ROUNDING)
        assert all(ROUNDING <= error < 100 * ROUNDING for error in found.errors[name].values())
    known = reference(Oscillator(), 1.0)
    assert not constraint_errors(run_of(known), known).errors


# ---- questions about constraints ---------------------------------------------------------
def held(scene, name, errors, **changes):
    """Runs at falling steps, with these violations."""
    return [
        planted(
            scene, name, {"q": (1.0, k)}, h=0.1 / 2**k,
            errors={"q": {"max": 10.0**-k}, "constraint": {"max": e}} if e else {"q": {"max": 0.1}},
            reference_error={"q": {"max": 1e-15}, "constraint": {"max": ROUNDING}},
            work={"residuals": 100 * (k + 1), "steps": 1 + ord(name[0])}, **changes,
        )
        for k, e in enumerate(errors)
    ]  # fmt: skip


def test_questions_ask_for_the_constraints():
    """Two methods hold them up to rounding, where they tie; one scene has no constraints."""
    on = {
        "held": [
            *held("held", "drifts", [1e-2, 1e-3, 1e-5]),
            *held("held", "exact", [ROUNDING, 3 * ROUNDING]),
            *held("held", "projects", [5 * ROUNDING, ROUNDING]),
        ],
        "free": [*held("free", "drifts", [None]), *held("free", "exact", [None])],
    }
    scenes = {name: series_of(records) for name, records in on.items()}
    found = answer(scenes, HELD)
    assert [*found.scenes] == ["held"]
    entries = found.scenes["held"].entries
    assert [entry.value for entry in entries.values()] == [3000.0, 1000.0, 1000.0]
    assert found.scenes["held"].tied == ["exact", "projects"]
    assert plain(headline(found, {})) == (
        "exact and projects are each cheapest on the scene (all tied)."
    )


# ---- violations in words -----------------------------------------------------------------
def won(scene, name="one", cost=100, size=2.2e-3, error=7.3e-3, h=0.01, **changes):
    """A run that reaches 1e-4 in a and leaves such a violation, relative ``error``."""
    errors = {"a": {"max": 5e-5}, "q": {"max": 1e-4 * cost}}
    known = {"constraint": {"position": size}, "constraint_unit": "m", "formulation": "index2"}
    known |= {"errors": errors | ({"constraint": {"max": error}} if error else {})}
    known |= {"reference_error": {}, "work": {"residuals": cost}, "key": f"{scene} {name}"}
    known["run_s"] = [1e-6 * cost] * 7
    return planted(scene, name, {"a": (1, 2)}, h=h, **(known | changes))


FREE = {"constraint": {}, "error": None}
#: The violation that `won` leaves unless another is given, told for the accuracy 1e-4.
HELD_TO = "0.0022 m, relative 0.0073"
OFF = f"{HELD_TO}: 73 times the accuracy"


def test_a_violation_has_its_unit_and_says_how_often_it_is_the_accuracy():
    assert violation_text([won("s")], 1e-4) == OFF
    assert violation_text([won("s")], 1e-2) == violation_text([won("s")], 7.3e-3) == HELD_TO
    tied = [won("s", size=1e-9, error=1e-9), won("s"), won("s", size=1e-3, error=1e-3)]
    assert violation_text(tied, 1e-4) == OFF
    # Stores of earlier versions have neither units nor relative violations.
    assert violation_text([won("s", error=None, constraint_unit="")], 1e-4) == "0.0022"
    assert violation_text([won("s", **FREE)], 1e-4) == violation_text([], 1e-4) == ""


def test_the_unit_of_constraints_follows_from_their_multipliers():
    """λ Φ is an energy; the driven crank has rows in m² and rad."""
    for scene, unit in [
        (Pendulum(), "m²"),
        (SliderCrank(), "m"),
        (SliderCrankDriven(), "m² or rad"),
        (Chain(links=2), "m²"),
        (Oscillator(), ""),
    ]:
        assert constraint_unit(scene) == unit


def test_tables_of_winners_have_a_column_of_violations_for_each_cost():
    series = series_of([won("s"), won("s", "two", cost=300)])
    free = series_of([won("f", **FREE), won("f", "two", cost=300, **FREE)])
    asked = [replace(FIRST, cost=cost) for cost in COSTS]
    found = answers({"s": series, "f": free}, [FIRST.group], [FIRST.target])
    table = winners_table({q: found[q] for q in asked}, {})
    assert table.head[-1] == "|Φ| of the winners, largest over time"
    assert {row[0]: row[-1] for row in table.rows} == {"s": OFF, "f": NO_VALUE}
    own = {row[0]: row[-1] for row in targets_table(series, {}).rows}
    assert own["a to 1e-2"] == HELD_TO
    assert "|Φ|" not in " ".join(targets_table(free, {}).head)
    quick = won("s", cost=300, size=1e-9, error=1e-9, run_s=[1e-4] * 7)
    series = series_of([won("s", "two", run_s=[1e-2] * 7), quick])
    own = {row[0]: row[-1] for row in targets_table(series, {}).rows}
    assert own["a to 1e-4"].split(" · ") == [OFF, "1e-9 m, relative 1e-9", OFF]


def test_the_card_of_a_method_tells_its_own_violation():
    scenes = {"s": series_of([won("s"), won("s", "two", cost=300, size=1e-9, error=1e-9)])}
    stored = StoredRuns("", scenes, {}, {})
    card = [plain(s) for s in stored_card("one", answer(scenes, FIRST), stored)]
    assert f"Cheapest alone by operations: s (|Φ| up to {OFF})." in card


def test_who_holds_the_constraints_is_told_by_formulation_with_its_exceptions():
    records = [won("s", error=0.5), won("s", error=0.002, h=0.005)]
    records += [won("s", name, error=1e-9) for name in ("two", "three")]
    records += [won("s", "three", error=1e-12, h=0.005), won("s", "four", status="diverged")]
    records += [won("s", "five", error=1e-11, formulation="index3")]
    names = {name: name.upper() for name in ("one", "two", "three", "four", "five")}
    assert held_table(series_of(records), names).rows == [
        ["index 3", "1e-11", "1e-11"],
        ["index 2 but ONE", "1e-9", "1e-12"],
        ["ONE", "0.5", "0.002"],
    ]
    assert held_table(series_of([won("s", **FREE)]), names) is None


def test_a_link_asks_for_the_constraints_and_the_table_of_methods_has_their_violation(
    browser, tmp_path
):
    records = [won("pendulum"), won("pendulum", "two", cost=300, size=1e-9, error=1e-9)]
    records += [won("spring_mass", **FREE, formulation="unconstrained")]
    write_html_report(plant(tmp_path, records))

    def asked(scene, question):
        visit(browser, tmp_path / "report" / f"scene-{scene}.html", question)
        return [each(browser, part, "node.innerText") for part in ("[data-verdict]", ".methods tr")]

    (verdict,), rows = asked("pendulum", "#group=constraint&target=1e-3&cost=operations")
    assert "1e-3" in each(browser, "[data-verdict] .whole", "node.innerText")
    assert verdict.startswith(
        "To 1e-3 (relative) in constraints Φ: two (3000 operations at h=0.01; violation of Φ"
    )
    assert " ".join(rows[-1].split()).startswith("one index 2 not reached")
    _, (head, one, two) = asked("pendulum", "#group=a&target=1e-4&cost=operations")
    assert "violation of Φ" in head
    assert one.startswith("one index 2\t")
    assert one.endswith("\t0.0022 m\t0.0073: 73 times the accuracy")
    assert two.endswith("\t1e-9 m\t1e-9")
    _, (head, one) = asked("spring_mass", "#group=a&target=1e-4&cost=operations")
    assert "violation" not in head
    assert "index" not in one
