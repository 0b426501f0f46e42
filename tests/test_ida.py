"""IDA: accuracy, formulations, honest counts, and every way in which a run can end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from helpers import long
from probe import Probe, worst

from integrators import Tolerances, Trajectory
from integrators.adapters import dae
from integrators.adapters.ida import IDA
from problems import MechatronicSystem
from problems.formulations import dae_layout
from problems.scenes.pendulum import Pendulum
from problems.scenes.spring_mass import SpringMass

every_callback = pytest.mark.parametrize("callbacks", ["compiled", "python"])
FORMULATIONS = ("stabilised_index2", *long("index1", "index2", "index3"))


@dataclass(frozen=True)
class WeighedPendulum(Pendulum):
    """A pendulum whose motor's torque follows the measured force in the rod."""

    def output(self, z):
        return z.lam

    def actuation(self):
        return np.array([[0.01], [0.0]])


def run(scene: MechatronicSystem, rtol: float, t_end: float = 0.0, **options) -> Trajectory:
    t_end = t_end or scene.interval[1]
    return IDA(**options).prepare(scene, t_end, Tolerances(rtol)).measure()


# ---- accuracy --------------------------------------------------------------------------
@pytest.mark.parametrize("scene", [Pendulum(), *long(SpringMass())], ids=lambda s: s.name)
def test_it_reaches_eight_digits_in_positions_velocities_and_accelerations(scene):
    t_end = 5.0 if scene.name == "spring_mass" else 1.35
    trajectory = run(scene, 1e-11, t_end)
    assert trajectory.status == "ok", trajectory.message
    assert trajectory.t[[0, -1]].tolist() == [scene.interval[0], t_end]
    for group in ("q", "v", "a"):
        assert worst(trajectory, scene, group) < 1e-8


@pytest.mark.parametrize("formulation", ["stabilised_index2", *long("index1", "index2")])
def test_the_error_falls_with_the_tolerance(formulation):
    errors = [
        worst(run(Pendulum(), rtol, formulation=formulation), Pendulum(), "q")
        for rtol in (1e-5, 1e-7, 1e-9)
    ]
    assert errors[0] < 1e-3
    assert errors[1] < errors[0] / 10
    assert errors[2] < errors[1] / 10


def test_the_stabilised_form_keeps_position_and_velocity_constraints_and_index_1_drifts():
    def violation(formulation):
        z = run(Pendulum(), 1e-6, 10.0, formulation=formulation)
        return max(np.abs(np.sum(z.q * w, axis=1) - w0).max() for w, w0 in ((z.q, 1), (z.v, 0)))

    # Newton's method leaves a violation of the size of the tolerance, but it does not add up.
    assert violation("stabilised_index2") < 1e-5
    assert violation("index1") > 1e-4


def test_the_reported_multiplier_is_the_solvers_own_and_the_acceleration_that_of_the_equations():
    z = run(Pendulum(), 1e-6)
    weight = np.array([0.0, -9.81])
    exact = (z.q @ weight + np.sum(z.v**2, axis=1)) / np.sum(z.q**2, axis=1)
    assert z.a == pytest.approx(weight - exact[:, None] * z.q, abs=1e-12)
    difference = np.abs(z.lam[:, 0] - exact).max()
    assert 1e-9 < difference < 1e-2


def test_outputs_that_measure_a_multiplier_do_not_stop_the_stabilised_form():
    scene = WeighedPendulum()
    trajectory = run(scene, 1e-8, max_calls=20_000)
    assert trajectory.status == "ok", trajectory.message
    assert trajectory.y == pytest.approx(trajectory.lam, abs=1e-6)


# ---- equations given to the solver -----------------------------------------------------
@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize(
    "scene", [WeighedPendulum(), *long(SpringMass(), Pendulum())], ids=lambda s: s.name
)
def test_the_start_satisfies_the_equations_and_the_jacobian_is_their_derivative(scene, formulation):
    at = dae_layout(scene.sizes, formulation)
    w, wdot = dae.start_vectors(scene, at)
    of, p = (scene.template(), formulation), np.array([*scene.parameters().values()])
    residual, transposed = dae.packed_residual(*of).bind(p), dae.packed_jacobian(*of).bind(p)
    t0, cj = scene.interval[0], 37.0
    assert np.abs(residual(t0, w, wdot)).max() < 1e-12

    generator = np.random.default_rng(1)
    w, wdot = w + generator.normal(size=at.size), wdot + generator.normal(size=at.size)
    e = 1e-6 * np.eye(at.size)
    differences = [
        (residual(t0, w + d, wdot + cj * d) - residual(t0, w - d, wdot - cj * d)) / 2e-6 for d in e
    ]
    assert transposed(t0, w, wdot, cj) == pytest.approx(np.stack(differences), rel=1e-6, abs=1e-5)


# ---- work ------------------------------------------------------------------------------
@every_callback
@pytest.mark.parametrize("scene", [Pendulum(), *long(SpringMass())], ids=lambda s: s.name)
def test_counts_agree_with_idas_own_and_the_timed_solve_takes_the_same_steps(scene, callbacks):
    prepared = IDA(callbacks=callbacks).prepare(scene, 1.0, Tolerances(1e-7))
    trajectory, timed = prepared.measure(), prepared.execute()
    work = trajectory.work
    assert (work.residuals, work.jacobians) == (timed.nfev, timed.njev)
    assert work.residuals > work.steps > work.jacobians == work.factorisations > 0
    if callbacks == "python":  # scikit-sundae does not tell
        assert work.rejected is work.newton is work.solves is None
    else:  # every residual is followed by an iteration
        assert work.newton == work.solves == work.residuals > work.steps + work.rejected
    at = dae_layout(scene.sizes, "stabilised_index2")
    assert trajectory.q[-1].tolist() == timed.y[at.q].tolist()


# ---- ways to end -----------------------------------------------------------------------
@every_callback
def test_raw_index_3_ends_within_its_budget_and_says_what_to_use(callbacks):
    trajectory = run(Pendulum(), 1e-6, formulation="index3", max_calls=10_000, callbacks=callbacks)
    assert trajectory.status in ("budget_exceeded", "newton_failed", "step_too_small")
    assert trajectory.work.residuals <= 10_000
    assert "formulation=stabilised_index2" in trajectory.message
    assert 0.35 <= trajectory.t[-1] < 1.35


@pytest.mark.parametrize("formulation", ["stabilised_index2", *long("index2")])
@every_callback
def test_multipliers_in_the_error_test_fail_with_a_reason_and_without_a_word(
    formulation, callbacks, capfd
):
    trajectory = run(
        Pendulum(),
        1e-6,
        formulation=formulation,
        multipliers_in_error_test=True,
        max_calls=10_000,
        callbacks=callbacks,
    )
    assert trajectory.status in ("budget_exceeded", "newton_failed", "step_too_small")
    assert "; use " in trajectory.message
    assert capfd.readouterr().out == ""


# ---- options ---------------------------------------------------------------------------
def test_the_formulation_is_always_part_of_the_name():
    assert IDA().spec == "ida[formulation=stabilised_index2]"
    assert IDA(max_order=2).spec == "ida[formulation=stabilised_index2,max_order=2]"


def test_a_lower_order_needs_more_steps():
    low, high = run(Probe(), 1e-6, max_order=2), run(Probe(), 1e-6)
    assert low.status == high.status == "ok"
    assert low.work.steps > 2 * high.work.steps
