"""Endings of runs: their statuses, messages, counts and last rows."""

import numpy as np
import pytest
from helpers import long, run_of, toy
from test_starts import Rough

from bench.plugins.registry import Registry
from integrators import Steps, Tolerances
from integrators.methods.energy_momentum import EnergyMomentum
from integrators.native.loops.kernel import Ending
from problems import parameter
from problems.base.spec import SpecError
from problems.scenes.pendulums import Pendulum

REGISTRY = Registry()


#: An oscillator with a fast filter that nothing feeds back.
Filtered = toy(
    "Filtered", x=[0.0], interval=(0.0, 6.0), nominal_step=0.01,
    rate=parameter(1e3, "1/s", "rate of the filter"),
    force=lambda self, q, v, t: -q, state_rate=lambda self, z: self.rate * (z.q - z.x),
)  # fmt: skip
#: A mass is driven away by a spring, far more than steps can follow.
Falling = toy("Falling", q=[1e-3], interval=(0.0, 1.0), force=lambda self, q, v, t: 1e4 * q)
Driven = toy(
    "Driven", q=[1e-3], force=lambda self, q, v, t: 1.0 - 4 * q**3,
    energy=lambda self, q, v: v @ v / 2 + q[0] ** 4,
)  # fmt: skip


@pytest.mark.parametrize(
    "method",
    [
        "half_explicit_euler",
        *long("phem56[steps=constant]", "noh_bathe", "explicit_generalized_alpha"),
        *long("semi_implicit_euler"),
    ],
)
def test_a_state_that_nothing_feeds_back_diverges(method):
    for t_end in [0.5, 6.0]:
        run = run_of(REGISTRY.integrator(method), Filtered(), 0.01, t_end, "diverged")
        assert np.isfinite(run.x).all()
        assert run.work.steps == len(run.t) - 1


@pytest.mark.long
def test_a_state_that_grows_ends_a_run_whose_steps_follow_a_tolerance():
    method = REGISTRY.integrator("generalized_alpha_adaptive")
    run = run_of(method, Filtered(rate=-100.0), Tolerances(1e-3), 6.0, "diverged")
    assert 0.25 < run.t[-1] < 0.35  # exp(100 t) passes 1e12


@pytest.mark.long
@pytest.mark.parametrize(
    "method", ["generalized_alpha_adaptive", "rodas5p", "bdf_adaptive", "phem56"]
)
def test_sparse_tangents_that_are_singular_from_the_first_end_with_their_name(method):
    method = REGISTRY.integrator(f"{method}[linear_solver=sparse]")
    run = run_of(method, Pendulum(copies=2), Tolerances(1e-4), 0.45, "newton_failed")
    assert run.message.startswith("Ended at t=0.35 s of 0.45 s: the tangent is singular")
    assert (len(run.t), run.work.steps) == (1, 0)


def test_a_run_ends_after_its_start():
    for method, resolution in (("phem56", Tolerances(1e-6)), ("generalized_alpha", Steps(0.1))):
        for t_end in (0.1, 0.35, np.nan):
            with pytest.raises(SpecError, match=r"does not lie after the start at 0\.35 s"):
                REGISTRY.integrator(method).prepare(Pendulum(), t_end, resolution)


def test_remedies_name_what_a_method_takes():
    method = REGISTRY.integrator("hht_i3[control=chrono,max_steps=3]")
    run = run_of(method, Pendulum(), 0.01, 1.35, "budget_exceeded")
    assert "a larger rtol or step" in run.message
    for ending in Ending:
        assert "newton_max" not in ending.outcome(0.0, 1.0)[1]


def test_a_refused_step_is_no_failure_of_newton():
    method = REGISTRY.integrator("linearly_implicit_euler")
    run = method.prepare(Falling(), 1.0, Steps(0.05)).measure()
    assert (run.status, run.work.newton, run.work.steps) == ("newton_failed", 0, 0)
    assert "no sound solution" in run.message
    assert "Newton" not in run.message


def test_a_step_that_newton_did_not_solve_is_not_called_refused():
    class Careless(EnergyMomentum):
        def supports(self, scene):
            return None

    for most, reason in [(1, "Newton's method did not converge"), (20, "no sound solution")]:
        run = run_of(Careless(newton_max=most), Driven(), 0.5, 1.0, "newton_failed")
        assert reason in run.message


def test_a_failed_run_keeps_its_last_good_step():
    for steps, t_end in [(2, 5.0), (20_003, 40_000.0)]:
        method = REGISTRY.integrator("generalized_alpha")
        scene = Rough(1.0, steps + 0.345)
        run = run_of(method, scene, 1.0, t_end, "newton_failed")
        assert run.t[-1] == pytest.approx(steps, abs=1.0)
        assert run.work.steps == round(run.t[-1])
        assert f"Ended at t={run.t[-1] + 1:.6g} s" in run.message
        assert len(run.notes["h"]) == len(run.t) <= 8192
        assert (np.diff(run.t) > 0).all()
