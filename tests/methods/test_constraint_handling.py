"""Constraints of methods on the explicit ODE: left to drift, pulled back, or projected onto."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import errors_at, long, nothing_compiled, slope

from integrators import Integrator, Tolerances, Trajectory
from integrators.adapters.diffrax_methods import Dopri8, Kvaerno3
from integrators.adapters.scipy_ode import BDF, Radau
from problems import jax, jnp
from problems.constraints import constraint_velocity
from problems.initial_values import consistent_start
from problems.projections import projected_state
from problems.scenes.car_axis import CarAxis
from problems.scenes.double_pendulum import DoublePendulum
from problems.scenes.pendulum import Pendulum
from problems.scenes.spring_mass import SpringMass

SCENE, LONG, RTOL = Pendulum(), 10.35, 1e-5
METHODS = long(Dopri8, Kvaerno3, Radau, BDF)


def run(method: Integrator, rtol: float = RTOL, t_end: float = LONG) -> Trajectory:
    trajectory = method.prepare(SCENE, t_end, Tolerances(rtol)).measure()
    assert trajectory.status == "ok", trajectory.message
    return trajectory


def off(run: Trajectory) -> np.ndarray:
    """Distance of each row from the constraint."""
    return abs(0.5 * ((run.q**2).sum(axis=1) - 1))


@pytest.mark.parametrize("cls", METHODS)
def test_drift_grows_under_index_1_is_bounded_under_baumgarte_and_gone_by_projection(cls):
    drifts, pulled = (run(cls(constraints=handling)) for handling in ("index1", "baumgarte"))
    half = len(drifts.t) // 2
    assert off(drifts)[-1] > 2 * off(drifts)[half] > 0
    assert off(drifts)[-1] > 20 * off(pulled).max()
    assert off(pulled)[len(pulled.t) // 2 :].max() < 2 * off(pulled)[: len(pulled.t) // 2].max()
    if cls in (Dopri8, Kvaerno3):
        projected = run(cls(constraints="projected"))
        assert off(projected).max() < 1e-14
        assert abs((projected.q * projected.v).sum(axis=1)).max() < 1e-14
    # Reported accelerations are those of the equations of motion, Baumgarte's term left out.
    assert pulled.a == pytest.approx(np.array([0.0, -9.81]) - pulled.lam * pulled.q, abs=1e-11)


@pytest.mark.long
@pytest.mark.parametrize("handling", ["projected", *long("baumgarte")])
@pytest.mark.parametrize(
    ("cls", "coarse"), [(Kvaerno3, 0.02), *long((Dopri8, 0.1))], ids=["kvaerno3", "dopri8"]
)
@pytest.mark.parametrize(("scene", "t_end"), [(SCENE, 1.35), *long((DoublePendulum(), 1.0))])
def test_neither_changes_the_order(cls, coarse, handling, scene, t_end):
    rates = {"alpha": 10.0, "beta": 10.0} if handling == "baumgarte" else {}
    method = cls(constraints=handling, **rates).at_constant_steps()
    ratio = 2**0.5 if cls is Dopri8 else 2
    steps = [1 / round(ratio**k / coarse) for k in range(3)]
    errors = [errors_at(method, scene, t_end, h) for h in steps]
    for group in ("q", "v", "a", "lam"):
        order = slope(steps, [np.sqrt(np.mean(e[group] ** 2)) for e in errors])
        assert order > method.orders[group] - 0.3, group


@pytest.mark.long
def test_large_rates_of_baumgarte_are_stiff_to_an_explicit_method_and_small_ones_hold_nothing():
    steps, largest = {}, {}
    for rate in (0.1, 20.0, 500.0):
        done = run(Dopri8(constraints="baumgarte", alpha=rate, beta=rate))
        steps[rate], largest[rate] = done.work.steps, off(done).max()
    assert steps[500.0] > 10 * steps[20.0]
    assert largest[0.1] > 10 * largest[20.0]


@pytest.mark.long
def test_other_rates_compile_nothing_new():
    method = Dopri8(constraints="baumgarte")
    run(method, t_end=1.35)
    with nothing_compiled():
        run(replace(method, alpha=1.0), t_end=1.35)


@pytest.mark.long
def test_without_constraints_all_are_the_same_and_projections_are_billed():
    free = [Dopri8(constraints=handling) for handling in ("index1", "baumgarte", "projected")]
    ends = [m.prepare(SpringMass(), 1.0, Tolerances(1e-5)).measure().q[-1, 0] for m in free]
    assert ends[0] == ends[1] == ends[2]
    plain, projected = (
        Dopri8(constraints=handling).prepare(SCENE, 1.35, Tolerances(RTOL))
        for handling in ("index1", "projected")
    )
    bills = [one.bill(one.measure()) for one in (plain, projected)]
    assert bills[1]["inner solves"] > 1.1 * bills[0]["inner solves"]


def test_the_projection_takes_the_least_changes_onto_moving_constraints():
    scene = CarAxis()
    z = consistent_start(scene).z
    t, n = jnp.asarray(0.7), len(z.q)
    noise = 1e-3 * np.random.default_rng(1).standard_normal(2 * n)
    s = projected_state(scene, t, np.concatenate([z.q, z.v, z.x]) + noise)
    q, v = s[:n], s[n : 2 * n]
    position, velocity, jacobian, mass = map(np.asarray, jax.jit(lambda q, v: (
        scene.constraint(q, t), constraint_velocity(scene, q, v, t),
        jax.jacfwd(scene.constraint)(q, t), scene.mass(q),
    ))(q, v))  # fmt: skip
    assert np.abs(position).max() < 1e-15
    assert np.abs(velocity).max() < 1e-14
    # Of all changes to these velocities it is the least: M-orthogonal to what constraints leave.
    free = np.linalg.svd(jacobian)[2][len(jacobian) :]
    change = v - (z.v + noise[n:])
    assert np.abs(free @ mass @ change).max() < 1e-13 * np.abs(change).max()
