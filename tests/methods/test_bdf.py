"""Backward differences: formulas of their steps, tolerances, orders, constraints."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from helpers import long, reference
from proofs import SWING, TWO_RODS

from bench.check.trials import ForcedOscillator
from integrators import Steps, Tolerances
from integrators.methods.bdf2 import BDF2
from integrators.methods.bdf_adaptive import BDFAdaptive, _respaced
from problems import jax, jnp
from problems.initial_values import consistent_start
from problems.scenes.car_axis import CarAxis
from problems.scenes.double_pendulum import DoublePendulumControlled
from problems.scenes.spring_mass import SpringMass


def test_controller_states_follow_the_formulas_of_the_first_and_of_later_steps():
    h = 0.1
    run = BDF2().prepare(SpringMass(), 2 * h, Steps(h)).measure()
    (x0, x1, x2), (f0, f1, f2) = run.x, run.xdot
    assert x1 - x0 == pytest.approx(h * (f0 + 3 * f1) / 4, rel=1e-12)
    assert 3 * x2 - 4 * x1 + x0 == pytest.approx(2 * h * f2, rel=1e-12)


@pytest.mark.long
def test_positions_are_corrected_in_the_directions_of_the_constraints_before_the_step():
    """On a scene whose directions Phi_q(q, t) move with time: those at the end are others."""
    scene, h = CarAxis(), 0.05
    run = BDF2(formulation="stabilised_index2").prepare(scene, h, Steps(h)).measure()
    corrected = run.q[1] - run.q[0] - h * run.v[0] - h**2 / 2 * run.a[1]

    jacobian = jax.jit(jax.jacfwd(scene.constraint))

    def off(q, t):
        directions = np.asarray(jacobian(q, t)).T
        part = np.linalg.lstsq(directions, corrected)[0]
        return np.linalg.norm(corrected - directions @ part) / np.linalg.norm(corrected)

    assert off(run.q[0], 0.0) < 1e-6
    for elsewhere in ((run.q[0], h), (run.q[1], 0.0)):
        assert off(*elsewhere) > 1e-3


def _largest_errors(method, scene, t_end, rtol):
    run = method.prepare(scene, t_end, Tolerances(rtol)).measure()
    assert run.status == "ok", run.message
    exact = reference(scene, t_end)(run.t)
    found = {}
    for group in ("q", "v", "a", "lam", "x"):
        if exact[group].shape[1]:
            off = np.linalg.norm(getattr(run, group) - exact[group], axis=1).max()
            found[group] = off / np.linalg.norm(exact[group], axis=1).max()
    return found, run.work


def _states(method, scene, steps):
    """States after steps of the given sizes."""
    program, numbers = method.program(scene, sparse=False)
    start = jax.tree.map(jnp.asarray, consistent_start(scene))
    step = jax.jit(lambda state, t, h: program.step(scene, numbers, state, t, h)[0])
    t, states = start.z.t, [program.begin(scene, numbers, start, jnp.asarray(steps[0]))]
    for h in map(jnp.asarray, steps):
        t = t + h
        states.append(step(states[-1], t, h))
    return [carried.state for carried in states]


@pytest.mark.long
def test_steps_are_those_of_polynomials_through_the_last_values():
    steps = np.array([0.02, 0.03, 0.025, 0.02, 0.03, 0.04, 0.03, 0.02, 0.03, 0.025])
    states = _states(BDFAdaptive(), ForcedOscillator(), steps)
    times = np.concatenate([[0.0], np.cumsum(steps)])
    v = np.array([float(state.shown.v[0]) for state in states])
    a = np.array([float(state.shown.a[0]) for state in states])
    assert {int(state.order_before) for state in states} >= {2, 3, 4}
    for n in range(6, len(states)):
        k, h = int(states[n].order_before), steps[n - 1]
        # Monomials about the end, in units of the step.
        at = (times[n - k - 1 : n] - times[n]) / h
        p = np.polynomial.Polynomial.fit(at, v[n - k - 1 : n], k, domain=[-1, 1], window=[-1, 1])
        leading = sum(1 / j for j in range(1, k + 1))
        corrected = p(0.0) + (h * a[n] - p.deriv()(0.0)) / leading
        assert v[n] == pytest.approx(corrected, abs=1e-11)
        # DASSL's error constant, from the times alone; 1/(k + 1) at equal steps.
        parts = h / (times[n] - times[n - 1 - np.arange(k + 1)])
        constant = max(parts[k], abs(parts[k] + parts[:k].sum() - leading))
        error = float(states[n].error[1])
        assert error == pytest.approx(constant * (v[n] - p(0.0)), rel=1e-5, abs=1e-14)
        # Divided differences, scaled: the first is the change in the step.
        assert float(states[n].differences[1, 1]) == pytest.approx(v[n] - v[n - 1], abs=1e-14)


@pytest.mark.long
@pytest.mark.parametrize(
    ("method", "on"),
    [
        (BDFAdaptive(), SWING),
        (BDFAdaptive(), (SpringMass(), 1.0)),
        *long(
            (BDFAdaptive(), TWO_RODS),
            (BDFAdaptive(), (ForcedOscillator(), 7.0)),
            (BDFAdaptive(formulation="index2"), SWING),
            (BDFAdaptive(formulation="index1"), TWO_RODS),
            (BDFAdaptive(max_order=2), SWING),
            (BDFAdaptive(max_order=3), SWING),
        ),
    ],
)
def test_errors_follow_the_tolerance(method, on):
    rtols = (1e-4, 1e-6, 1e-8)
    runs = [_largest_errors(method, *on, rtol) for rtol in rtols]
    for (errors, _), rtol in zip(runs, rtols, strict=True):
        assert max(errors.values()) < 3 * rtol
    for (coarse, _), (fine, _) in pairwise(runs):
        assert 30 < coarse["v"] / fine["v"] < 300


@pytest.mark.long
def test_index_3_follows_it_in_q_and_v_and_loses_part_of_a_and_lam():
    runs = [_largest_errors(BDFAdaptive(formulation="index3"), *SWING, r)[0] for r in (1e-5, 1e-7)]
    for errors, rtol in zip(runs, (1e-5, 1e-7), strict=True):
        assert max(errors["q"], errors["v"]) < 3 * rtol
    assert 5 < runs[0]["lam"] / runs[1]["lam"] < 40


@pytest.mark.long
def test_a_controller_that_begins_at_zero_does_not_hold_up_index_3():
    method = BDFAdaptive(formulation="index3")
    for rtol in (1e-4, 1e-6, 1e-9):
        run = method.prepare(DoublePendulumControlled(), 1.0, Tolerances(rtol)).measure()
        assert run.status == "ok", run.message
        assert run.work.rejected < 0.1 * run.work.steps


@pytest.mark.long
def test_a_controller_on_index_3_follows_the_tolerance_by_q_alone():
    method, on = BDFAdaptive(formulation="index3"), (DoublePendulumControlled(), 0.2)
    coarse, fine = (_largest_errors(method, *on, rtol)[0] for rtol in (1e-4, 1e-8))
    assert max(coarse["q"] / 1e-4, fine["q"] / 1e-8) < 3
    assert 30 < coarse["x"] / fine["x"] < 3000


@pytest.mark.long
def test_a_first_step_that_is_tried_again_has_the_start_of_its_own_size():
    method, scene = BDFAdaptive(formulation="index3"), DoublePendulumControlled()
    start = jax.tree.map(jnp.asarray, consistent_start(scene))
    tried, own = (_respaced(method.begin(scene, start, h), 0.001) for h in (0.1, 0.001))
    assert np.asarray(tried.spans) == pytest.approx(np.asarray(own.spans), rel=1e-13)
    assert np.asarray(tried.differences) == pytest.approx(np.asarray(own.differences), abs=1e-15)


@pytest.mark.long
def test_higher_orders_save_steps():
    steps = [_largest_errors(BDFAdaptive(max_order=k), *SWING, 1e-7)[1].steps for k in (2, 3, 5)]
    assert steps[0] > 4 * steps[1] > 16 * steps[2]


@pytest.mark.parametrize("cases", [("stabilised_index2",), *long(["index3", "index2", "index1"])])
def test_the_constraints_of_the_formulation_hold(cases):
    for formulation in cases:
        run = BDFAdaptive(formulation=formulation).prepare(*SWING, Tolerances(1e-6)).measure()
        positions = abs(0.5 * ((run.q**2).sum(axis=1) - 1)).max()
        velocities = abs((run.q * run.v).sum(axis=1)).max()
        assert (positions < 1e-13) == (formulation in ("index3", "stabilised_index2"))
        assert (velocities < 1e-12) == (formulation in ("index2", "stabilised_index2"))


@pytest.mark.long
def test_modified_newton_and_sparse_tangents_stay_within_the_tolerance():
    for more in ({"newton": "modified"}, {"newton": "modified", "linear_solver": "sparse"}):
        errors, work = _largest_errors(BDFAdaptive(**more), *TWO_RODS, 1e-6)
        assert max(errors.values()) < 3e-6
        assert work.factorisations < 0.8 * work.newton
