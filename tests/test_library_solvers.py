"""Solvers of other libraries: states of controllers, other parameters, and every way to end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import long
from probe import Probe, worst

from integrators import Tolerances, Trajectory
from integrators.adapters.cvode import CVODE
from integrators.adapters.ida import IDA
from integrators.adapters.scipy_ode import BDF, Radau
from integrators.adapters.solve_dae import BDFDAE, RadauDAE
from problems import MechatronicSystem
from problems.scenes.pendulum import Pendulum
from problems.scenes.spring_mass import SpringMass

every_solver = pytest.mark.parametrize(
    "method",
    [
        *(IDA(), CVODE(), Radau(), RadauDAE()),
        *long(IDA(callbacks="python"), CVODE(callbacks="python"), CVODE(method="adams")),
        *long(BDF(), BDFDAE()),
    ],
    ids=lambda method: method.spec,
)


def run(method, scene: MechatronicSystem, rtol: float, t_end: float = 0.0) -> Trajectory:
    return method.prepare(scene, t_end or scene.interval[1], Tolerances(rtol)).measure()


@every_solver
def test_controller_states_and_outputs_are_followed_too(method):
    trajectory = run(method, SpringMass(), 1e-9, 2.0)
    assert trajectory.status == "ok", trajectory.message
    for group in ("q", "v", "a", "x", "y"):
        assert worst(trajectory, SpringMass(), group) < 1e-6
    # The second output is the limited first one, implicit in y.
    assert trajectory.y == pytest.approx(
        np.stack([trajectory.x[:, 0], np.tanh(trajectory.y[:, 0])], axis=1), abs=1e-6
    )


@every_solver
def test_another_end_and_other_parameters_are_taken(method):
    scene = replace(Pendulum(), length=2.0)
    trajectory = run(method, scene, 1e-9, 0.8)
    assert trajectory.t[-1] == 0.8
    assert worst(trajectory, scene, "q") < 1e-6


@every_solver
def test_runs_are_equal_to_the_bit(method):
    prepared = method.prepare(Pendulum(), 1.0, Tolerances(1e-6))
    first, second = prepared.measure(), prepared.measure()
    assert first.work == second.work
    for name in ("t", "q", "v", "a", "lam"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


@every_solver
def test_a_budget_ends_the_run_after_exactly_that_many_calls_and_keeps_its_rows(method):
    trajectory = run(replace(method, max_calls=100), Pendulum(), 1e-8)
    assert trajectory.status == "budget_exceeded"
    assert "raise max_calls" in trajectory.message
    assert f"t={trajectory.t[-1]:.6g} s of 1.35 s" in trajectory.message
    assert trajectory.work.residuals == 100
    assert len(trajectory.t) == len(trajectory.q) == len(trajectory.a) > 3
    assert worst(trajectory, Pendulum(), "q") < 1e-6


@every_solver
@pytest.mark.parametrize("breaks_at", [0.0, 0.5])
def test_a_force_that_becomes_nan_ends_the_run_at_once_and_names_the_time(method, breaks_at, capfd):
    prepared = method.prepare(Probe(breaks_at=breaks_at), 2.0, Tolerances(1e-6))
    trajectory = prepared.measure()
    assert trajectory.status == "diverged"
    assert trajectory.t[-1] <= breaks_at + 1e-9
    assert trajectory.a[0] == pytest.approx(-4.0)  # the start is kept
    assert np.isfinite(trajectory.a).all()
    assert f"t={trajectory.t[-1]:.6g} s of 2 s" in trajectory.message
    assert trajectory.work.residuals < 5000
    ended = prepared.execute()
    assert ended is None or ended.status == "diverged"
    assert capfd.readouterr().out == ""


@every_solver
def test_a_pole_of_the_solution_ends_the_run_near_it(method):
    # q'' = 6 q^2 with q = 1/(1-t)^2.
    trajectory = run(method, Probe(k=0.0, c=6.0, v0=2.0), 1e-5)
    assert trajectory.status in ("step_too_small", "newton_failed", "diverged", "budget_exceeded")
    assert trajectory.t[-1] == pytest.approx(1.0, abs=5e-3)
