"""solve_dae's Radau and BDF: accuracy in each formulation, counts, and ways to end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import long
from probe import worst

from integrators import Tolerances, Trajectory
from integrators.adapters import dae, solve_dae
from integrators.adapters.solve_dae import BDFDAE, RadauDAE, SolveDAESolver, packed_jacobians
from problems import MechatronicSystem
from problems.formulations import dae_layout
from problems.scenes.pendulum import Pendulum
from problems.spec import build

INDEX_UP_TO_2 = ("stabilised_index2", *long("index1", "index2"))
pytestmark = pytest.mark.parametrize("cls", [RadauDAE, *long(BDFDAE)], ids=lambda c: c.name)


def run(
    method: SolveDAESolver, scene: MechatronicSystem, rtol: float, t_end: float = 0.0
) -> Trajectory:
    return method.prepare(scene, t_end or scene.interval[1], Tolerances(rtol)).measure()


# ---- accuracy --------------------------------------------------------------------------
@pytest.mark.parametrize("formulation", INDEX_UP_TO_2)
def test_errors_fall_with_the_tolerance_in_every_group_and_formulation(cls, formulation):
    method = cls(formulation=formulation)
    loose, tight = (run(method, Pendulum(), rtol) for rtol in (1e-4, 1e-8))
    assert loose.status == tight.status == "ok", tight.message
    assert tight.t[[0, -1]].tolist() == [0.35, 1.35]
    for group, limit in (("q", 1e-6), ("v", 1e-6), ("a", 1e-5), ("lam", 1e-4)):
        assert worst(tight, Pendulum(), group) < limit
        assert worst(tight, Pendulum(), group) < worst(loose, Pendulum(), group) / 50


def test_the_stabilised_form_keeps_both_constraints_and_index_1_drifts(cls):
    def violation(formulation):
        z = run(cls(formulation=formulation), Pendulum(), 1e-4, 20.0)
        return max(np.abs(np.sum(z.q * w, axis=1) - w0).max() for w, w0 in ((z.q, 1), (z.v, 0)))

    assert violation("stabilised_index2") < violation("index1") / 10


def test_the_reported_multiplier_is_the_solvers_own_and_the_acceleration_that_of_the_equations(cls):
    z = run(cls(), Pendulum(), 1e-5)
    weight = np.array([0.0, -9.81])
    exact = (z.q @ weight + np.sum(z.v**2, axis=1)) / np.sum(z.q**2, axis=1)
    assert z.a == pytest.approx(weight - exact[:, None] * z.q, abs=1e-12)
    assert 1e-7 < np.abs(z.lam[:, 0] - exact).max() < 1e-1


@pytest.mark.parametrize("formulation", [*INDEX_UP_TO_2, *long("index3")])
def test_the_jacobians_are_the_derivatives_of_the_equations(cls, formulation):
    scene, generator = Pendulum(), np.random.default_rng(2)
    n = dae_layout(scene.sizes, formulation).size
    p, w, wdot = (np.array(list(scene.parameters().values())), *generator.normal(size=(2, n)))
    key = scene.template(), formulation
    residual, jacobians = dae.packed_residual(*key).bind(p), packed_jacobians(*key).bind(p)

    def differences(move):
        pairs = [(move(d), move(-d)) for d in 1e-6 * np.eye(n)]
        return np.stack([(residual(0.0, *a) - residual(0.0, *b)) / 2e-6 for a, b in pairs])

    by_w, by_wdot = jacobians(0.0, w, wdot)
    assert by_w == pytest.approx(differences(lambda d: (w + d, wdot)), abs=1e-6)
    assert by_wdot == pytest.approx(differences(lambda d: (w, wdot + d)), abs=1e-6)


# ---- work ------------------------------------------------------------------------------
def test_counts_agree_with_the_librarys_own_and_with_what_an_iteration_costs(cls):
    prepared = cls().prepare(Pendulum(), 1.35, Tolerances(1e-5))
    solver = prepared.new_solver(prepared.counted_equations())
    steps = 0
    while solver.status == "running":
        solver.step()
        steps += 1
    work = prepared.measure().work
    assert (work.steps, work.residuals) == (steps, solver.nfev)
    assert (work.jacobians, work.factorisations) == (solver.njev, solver.nlu)
    if cls is BDFDAE:
        assert work.newton == work.residuals == work.solves
    else:
        # Three stages an iteration, and an evaluation for the error of each converged attempt.
        converged = work.residuals - 3 * work.newton
        assert work.steps <= converged <= work.steps + work.rejected
        assert work.solves == 2 * work.newton + converged
    assert all(type(count) is int for count in vars(work).values())


def test_multipliers_in_the_error_test_cost_calls_on_index_1(cls):
    fair, plain = (
        run(cls(formulation="index1", multipliers_in_error_test=tested), Pendulum(), 1e-6)
        for tested in (False, True)
    )
    assert fair.status == plain.status == "ok"
    assert plain.work.residuals > 1.2 * fair.work.residuals


# ---- ways to end -----------------------------------------------------------------------
def test_multipliers_in_the_error_test_end_the_stabilised_form_with_a_reason(cls):
    trajectory = run(cls(multipliers_in_error_test=True), Pendulum(), 1e-10)
    assert trajectory.status in ("step_too_small", "budget_exceeded", "newton_failed")
    assert "use multipliers_in_error_test=false" in trajectory.message
    assert trajectory.t[-1] < 1.0


def test_raw_index_3_ends_with_a_reason_at_small_tolerances(cls):
    # From 3e-10 on both end in the first 0.04 s, whatever the rounding; at 1e-8 some runs do not.
    trajectory = run(cls(formulation="index3", max_calls=10_000), Pendulum(), 1e-10)
    assert trajectory.status in ("step_too_small", "budget_exceeded", "newton_failed")
    assert "use formulation=stabilised_index2" in trajectory.message


# ---- options ---------------------------------------------------------------------------
def test_without_the_package_the_reason_says_what_to_install(cls, monkeypatch):
    assert cls().supports(Pendulum()) is None
    monkeypatch.setattr(solve_dae, "find_spec", lambda name: None)
    reason = cls().supports(Pendulum())
    assert reason == f'{cls.name} needs the package solve-dae: pip install "stepbench[dae]".'


def test_the_formulation_is_always_part_of_the_name(cls):
    assert cls().spec == f"{cls.name}[formulation=stabilised_index2]"
    method = build(cls, {"formulation": "index1", "multipliers_in_error_test": "true"}, cls.name)
    assert method == cls(formulation="index1", multipliers_in_error_test=True)
    assert (
        replace(method, multipliers_in_error_test=False).spec == f"{cls.name}[formulation=index1]"
    )
