"""`stepbench realtime`: a fixed budget per step. Times are read, never judged."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from helpers import long

from bench.results.table import NO_VALUE
from bench.running.constant_steps import (
    RealTimeRun,
    realtime_job,
    realtime_sentence,
    realtime_tables,
    stepping,
    timed,
)
from integrators.native.loops.constant_steps import SingleStep
from integrators.resolutions import Steps
from problems.truth.reference import Reference

GROUPS = ("q", "v", "a", "lam", "x", "y")
FULL, MODIFIED = "generalized_alpha[rho_inf=0.8]", "generalized_alpha[newton=modified,rho_inf=0.8]"


def run_of(worker, problem, integrator, rate, steps, iterations=None):
    """The trajectory of single steps, the number of unconverged ones, and the step itself."""
    scene = worker.problem(problem)
    method = stepping(worker.registry.integrator(integrator), scene)
    step = SingleStep(*method.program(scene), scene, 1 / rate, steps, iterations)
    return *step.run(timed(step, steps)[1]), step


def apart(one, other):
    """The largest difference of two runs in any group, relative to the group."""
    sizes = {g: np.abs(getattr(other, g)).max(initial=0.0) or 1.0 for g in GROUPS}
    return max(
        np.abs(getattr(one, g) - getattr(other, g)).max(initial=0.0) / sizes[g] for g in GROUPS
    )


# ---- single steps ------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("problem", "integrator"),
    [
        ("pendulum", FULL),
        *long(
            ("quarter_car", MODIFIED),
            ("pendulum", "linearly_implicit_euler"),
            ("pendulum", "rodas5p[steps=constant,constraints=projected]"),
        ),
    ],
)
def test_without_a_limit_the_states_are_those_of_solve(worker, problem, integrator):
    run, unconverged, _ = run_of(worker, problem, integrator, 100.0, 50)
    scene, method = worker.problem(problem), worker.registry.integrator(integrator)
    solved = method.prepare(scene, scene.interval[0] + 0.5, Steps(1e-2)).measure()
    assert (run.status, solved.status, unconverged) == ("ok", "ok", 0)
    assert run.t == pytest.approx(solved.t, rel=1e-14)
    assert apart(run, solved) < 1e-10  # that of q over h^2 is in a


def test_one_iteration_solves_linear_equations_and_a_run_ends_before_a_step_without_a_result(
    worker,
):
    one, _, _ = run_of(worker, "oscillator", FULL, 100.0, 200, 1)
    many, _, step = run_of(worker, "oscillator", FULL, 100.0, 200)
    assert step.iterates
    assert apart(one, many) < 1e-11
    # The explicit step is far beyond its limit of stability, 2 s.
    run, _, _ = run_of(worker, "oscillator", "semi_implicit_euler", 0.2, 25)
    assert (run.status, 1 < len(run.t) < 26) == ("diverged", True)
    assert all(np.isfinite(getattr(run, group)).all() for group in GROUPS)


@pytest.mark.long
def test_few_iterations_leave_an_error_that_falls_with_the_rate_and_with_their_number(worker):
    reference, left, errors = Reference(worker.problem("slider_crank"), 0.5), [], []
    for rate in (50, 100, 200):
        one, unconverged, _ = run_of(worker, "slider_crank", FULL, rate, rate // 2, 1)
        many, _, _ = run_of(worker, "slider_crank", FULL, rate, rate // 2)
        assert (one.status, unconverged) == ("ok", rate // 2)
        left.append(apart(one, many))
        exact = reference(one.t)["q"]
        errors.append([np.abs(run.q - exact).max() for run in (one, many)])
    assert left[0] > 4 * left[1] > 16 * left[2]
    (first, converged), (second, _), (third, _) = errors
    assert first > 2 * converged  # 50 Hz
    assert first > 4 * second > 16 * third
    two, _, _ = run_of(worker, "slider_crank", FULL, 200, 100, 2)
    assert apart(two, many) < 1e-3 * left[2]  # full Newton: quadratic


# ---- the study ---------------------------------------------------------------------------
@pytest.mark.long
def test_both_limits_are_measured_side_by_side_and_residuals_are_those_of_the_rows(worker):
    one, own = realtime_job(worker, "slider_crank", FULL, 100.0, 50, None)
    assert [run.iterations for run in (one, own)] == ["1", "unlimited"]
    assert (one.unconverged, own.unconverged, one.steps) == (50, 0, 50)
    assert {"q", "v", "a", "lam"} <= one.errors.keys()
    for problem, method, limit, shown, near in (
        ("slider_crank", FULL, 2, "2", 1e-3),
        ("slider_crank", MODIFIED, None, "unlimited", 1e-6),
        ("pendulum", "half_explicit_euler", 3, "none", None),
    ):
        (run,) = realtime_job(worker, problem, method, 100.0, 50, limit)
        assert run.iterations == shown
        if near:
            assert run.errors["q"] == pytest.approx(own.errors["q"], rel=near)
        else:
            assert run.unconverged == 0
    # A pendulum's rod: its length, and the speed along it, by hand.
    (found,) = realtime_job(worker, "pendulum", "linearly_implicit_euler", 200.0, 100, None)
    run, _, _ = run_of(worker, "pendulum", "linearly_implicit_euler", 200.0, 100)
    scene, h = worker.problem("pendulum"), 1e-6
    rows = list(zip(run.q, run.v, run.t, strict=True))
    length = max(np.abs(np.asarray(scene.constraint(q, t))).max() for q, _, t in rows)
    along = max(
        np.abs(np.asarray(scene.constraint(q + h * v, t) - scene.constraint(q - h * v, t))).max()
        for q, v, t in rows
    )
    assert found.constraint["position"] == pytest.approx(length, rel=1e-9)
    assert found.constraint["velocity"] == pytest.approx(along / (2 * h), rel=1e-6)
    assert length > 1e-6


# ---- what is said ------------------------------------------------------------------------
def planted(integrator="newmark", iterations="1", missed=0, error=1e-3, **more):
    seconds = np.full(1000, 1e-4)
    seconds[:missed] = 2e-3
    run = RealTimeRun(
        problem="pendulum", integrator=integrator, iterations=iterations, rate=1e3, asked=1000,
        steps=1000, status="ok", message="", unconverged=10, seconds=seconds,
        errors={"q": error, "v": error, "a": error, "lam": error / 2},
        constraint={"position": 1e-9, "velocity": 2e-6},
    )  # fmt: skip
    vars(run).update(more)
    return run


def test_the_sentence_names_the_least_error_among_those_that_hold_the_rate():
    late = planted("late", missed=2, error=1e-9)
    assert (late.missed, late.median_us) == (2, pytest.approx(100.0))
    assert (late.p999_us, late.worst_us) == (pytest.approx(2000.0), pytest.approx(2000.0))
    failed = planted("failed", status="diverged", errors={}, message="It grew.")
    good, bad = planted("good", "none", error=1e-4), planted("bad", missed=1, error=2e-4)
    said = realtime_sentence([late, failed, bad, good])
    assert said.startswith("2 of 4 hold 1000 Hz on pendulum")
    assert "good has the least error in q, v, a and lam (0.0001), at 100 µs" in said
    assert realtime_sentence([late]).startswith("None holds 1000 Hz")
    assert "2 more have the same" in realtime_sentence([good, good, good])
    unknown = planted("unknown", errors={"q": 1e-9, "v": None})
    assert unknown.error == math.inf
    assert "good has the least" in realtime_sentence([unknown, good])
    assert "no errors are known" in realtime_sentence([unknown])
    times, errors = realtime_tables([failed, good])
    assert times.rows[1] == ["good", "none", "100", "100", "100", "0 (0 %)"]
    assert errors.rows == [
        ["failed", "1", *4 * [NO_VALUE], "1e-9", "2e-6", "1%", "diverged, step 1001"],
        ["good", "none", *3 * ["0.0001"], "5e-5", "1e-9", "2e-6", NO_VALUE, "ok"],
    ]


# ---- the command -------------------------------------------------------------------------
@pytest.mark.long
def test_the_command_prints_json_and_tells_what_failed(stepbench):
    line = ["realtime", "oscillator", "newmark", "ida", "--rate", "100", "--duration", "0.5"]
    result = stepbench(*line, "--json")
    assert result.exit_code == 1
    assert "ida[formulation=stabilised_index2] has no step of constant size" in result.stderr
    found = json.loads(result.stdout)
    assert [run["iterations"] for run in found["runs"]] == ["1", "unlimited"]
    assert all(run["asked"] == run["steps"] == 50 for run in found["runs"])
    assert "on oscillator" in found["summary"]
