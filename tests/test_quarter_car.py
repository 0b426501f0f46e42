"""The quarter car and its damper: balances, characteristics, an independent solution, orders."""

from __future__ import annotations

import numpy as np
import pytest
from scene_mechanics import flipped
from scipy.integrate import solve_ivp

from integrators import Steps
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems import Variables, jax
from problems.initial_values import consistent_start
from problems.scenes.quarter_car import QuarterCar


def random_states():
    random = np.random.default_rng(3)
    for _ in range(4):
        q, v = 0.05 * random.normal(size=2), 0.5 * random.normal(size=2)
        yield q, v, np.array([*random.uniform(-0.5, 5.0, 2), random.normal()]), random.uniform(0, 2)


def at(scene, q, v, x, t):
    """Variables and xdot from the scene's blocks alone; a follows from the outputs."""
    z = Variables(q, v, np.zeros(2), np.zeros(0), x, np.zeros(2), t)
    y = np.asarray(scene.output(z))
    right = scene.force(q, v, t) + scene.actuation() @ y
    a = np.linalg.solve(scene.mass(q), right)
    z = z._replace(a=a, y=y)
    return z, np.asarray(scene.state_rate(z))


# ---- balances, and their violation by a sign error -------------------------------------
def check_balances(scene):
    for q, v, x, t in random_states():
        z, xdot = at(scene, q, v, x, t)
        height, climb = map(float, jax.jvp(scene._road, (t,), (1.0,)))
        masses = np.array([scene.m_body, scene.m_wheel])
        # Momentum: only the tyre acts from outside.
        tyre = scene.k_tyre * (height - q[1])
        assert masses @ z.a == pytest.approx(tyre, rel=1e-10, abs=1e-9)

        # Energy of masses, springs and compressed oil: the road gives, the flows take.
        gained = masses @ (v * z.a) + scene.k * (q[0] - q[1]) * (v[0] - v[1])
        gained += tyre * (climb - v[1])
        volumes = np.array([scene.v_reb, scene.v_comp])
        gained += 1e6 * volumes @ (x[:2] * xdot[:2]) / scene.bulk
        drops = np.array([x[0], x[1] - x[0], -x[1]])
        flows = np.array(scene._flows(x[0], x[1], z.y[0]))
        lost = 1e6 * drops * flows
        assert (lost >= 0).all()
        size = np.abs([tyre * climb, *lost]).sum() + masses @ np.abs(v * z.a)
        assert gained == pytest.approx(tyre * climb - lost.sum(), abs=1e-11 * size)

        # The controller: velocity from acceleration; current only against the body's velocity.
        assert xdot[2] == pytest.approx(z.a[0] - 0.5 * x[2], rel=1e-12)
        usable = x[2] * (v[0] - v[1]) > 0
        middle = 0.5 * (scene.i_min + scene.i_max)
        assert (z.y[0] > middle) == (usable and 3.0 * abs(x[2]) > middle - scene.i_min)


MUTANTS = {
    "force": ["k", "k_tyre", "q0", "q1"],
    "_pressure_rates": ["a_piston", "a_rod", "bulk"],
    "_damper_force": ["a_piston", "a_rod"],
    "_flows": ["check", "soft_area"],
    "state_rate": ["leak"],
    "output": ["gain"],
}


def test_momentum_energy_and_control_are_balanced():
    check_balances(QuarterCar())


def test_a_flipped_sign_is_caught():
    for block, what in [(block, what) for block, names in MUTANTS.items() for what in names]:
        with pytest.raises(AssertionError):
            check_balances(flipped(QuarterCar(), block, what))


def test_it_starts_at_rest():
    start = consistent_start(QuarterCar())
    rates = np.concatenate([start.z.a, start.xdot, start.z.y[1:]])
    assert np.abs(rates).max() < 1e-9


# ---- characteristics of the damper -----------------------------------------------------
def steady(scene, i, speed):
    """Pressures and force at a constant speed of extension."""
    rates = jax.jit(lambda p: jax.numpy.stack(scene._pressure_rates(*p, i, speed)))
    p = solve_ivp(lambda t, p: rates(p), (0, 0.5), np.zeros(2), method="LSODA", rtol=1e-9).y[:, -1]
    assert np.abs(rates(p)).max() < 1e-2  # MPa/s, of some hundred
    return p, float(scene._damper_force(*p))


def test_the_damper_has_the_forces_of_a_passenger_car_at_0_3_m_per_s():
    scene = QuarterCar()
    for speed in (0.3, -0.3):
        soft, firm = (abs(steady(scene, i, speed)[1]) for i in (scene.i_min, scene.i_max))
        assert 300 < soft < 600
        assert 2000 < firm < 2500
        assert np.sign(steady(scene, scene.i_min, speed)[1]) == np.sign(speed)


def test_the_compression_chamber_is_low_extending_and_near_the_other_one_compressing():
    scene = QuarterCar()
    (reb, comp), _ = steady(scene, scene.i_max, 0.3)
    assert -0.3 < comp < 0  # fed from the accumulator, below its pressure
    assert reb > 5
    (reb, comp), _ = steady(scene, scene.i_max, -0.3)
    assert reb > 4.5
    assert 0 < comp - reb < 0.1 * reb


# ---- over time -------------------------------------------------------------------------
def body_shaking(scene):
    """RMS of the body's acceleration over the interval, and the currents."""
    run = GeneralizedAlpha(rho_inf=0.9).prepare(scene, 4.0, Steps(1e-3)).measure()
    assert run.status == "ok"
    return np.sqrt(np.trapezoid(run.a[:, 0] ** 2, run.t) / 4.0), run.y[:, 0]


@pytest.mark.long
def test_the_controlled_body_shakes_less_than_with_any_constant_current():
    controlled, current = body_shaking(QuarterCar())
    assert current.min() < 0.35
    assert current.max() > 1.4
    for area in (5e-6, 3.2e-6, 1.5e-6, 3e-7):
        constant, _ = body_shaking(QuarterCar(soft_area=area, firm_area=area))
        assert controlled < 0.96 * constant
