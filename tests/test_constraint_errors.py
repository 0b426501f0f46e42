"""Violations of constraints as errors: their size, their rounding, and questions about them."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import reference
from planted import planted

from bench.results.quantities import NORMS, VIOLATIONS
from bench.results.records import flatten
from bench.running.errors import ROUNDING, constraint_errors, constraint_sizes, relative_errors
from integrators.contract import Trajectory, Work
from problems.scenes.oscillator import Oscillator
from problems.scenes.pendulum import Pendulum
from problems.scenes.slider_crank import SliderCrankDriven
from reports.questions.answers import answer
from reports.questions.phrases import plain
from reports.questions.question import Question
from reports.questions.sentences import scene_sentence, sentences
from reports.questions.words import words_of
from reports.series import series_of

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


def test_a_row_has_the_size_that_positions_and_velocities_give_it():
    """Phi = (x^2 + y^2 - L^2)/2 of a pendulum: Phi_q = (x, y)."""
    known = reference(Pendulum(), 1.0)
    t = np.linspace(known.scene.interval[0], 1.0, 65)
    q, (of_q, _), (of_v, _) = known(t)["q"], known.largest["q"], known.largest["v"]
    gradient = np.abs(q)
    sizes = constraint_sizes(known)
    assert sizes[0] == pytest.approx(np.max(gradient @ of_q), rel=1e-9)
    assert sizes[1] == pytest.approx(np.max(gradient @ of_v), rel=1e-9)


def test_a_violation_does_not_depend_on_the_unit_of_length():
    found = []
    for length in (1.0, 1000.0):
        known = reference(Pendulum(length=length, g=9.81 * length), 1.0)
        found.append(largest(constraint_errors(run_of(known, q=1e-6, v=1e-6), known)))
    assert found[0] == pytest.approx(found[1], rel=1e-6)


def test_turns_of_a_crank_do_not_make_its_length_count_less():
    one, many = (reference(SliderCrankDriven(), t_end) for t_end in (0.05, 0.5))
    assert many.largest["q"][0].max() > 50  # rad
    sizes = [constraint_sizes(known) for known in (one, many)]
    np.testing.assert_allclose(sizes[0], sizes[1], rtol=2e-2)


def test_exact_values_are_at_the_floor_in_every_norm():
    known = reference(Pendulum(), 1.0)
    found = constraint_errors(run_of(known), known)
    assert set(found.errors) == set(VIOLATIONS)
    for name in VIOLATIONS:
        assert found.reference_errors[name] == dict.fromkeys(NORMS, ROUNDING)
        assert all(ROUNDING <= error < 100 * ROUNDING for error in found.errors[name].values())


def test_a_scene_without_constraints_has_no_violation():
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
    found, words = answer(scenes, HELD), words_of(scenes, {})
    assert [*found.scenes] == ["held"]
    entries = found.scenes["held"].entries
    assert [entry.value for entry in entries.values()] == [3000.0, 1000.0, 1000.0]
    assert found.scenes["held"].winners == ["exact", "projects"]
    said = [plain(sentence) for sentence in sentences(found, words)]
    assert said[0].startswith(
        "To 1e-4 in constraints (largest over time), exact and projects tie for the fewest"
    )
    assert scene_sentence(found, "free", words) == []


def test_violations_are_columns_of_flat_rows():
    row = flatten(held("held", "exact", [1e-3])[0], {})
    assert row["error_constraint_max"] == 1e-3
    assert row["reference_error_constraint_max"] == ROUNDING
    assert row["error_constraint_velocity_max"] is None
    assert "error_constraint_components_max" not in row
