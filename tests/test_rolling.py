"""Scenes of rolling and of friction by forces of constraints: closed forms, other equations."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from helpers import long, reference
from scipy.optimize import brentq

from problems import jax, jnp
from problems.equations.constraints import constraint_velocity
from problems.equations.formulations import ode_rate
from problems.scenes.rolling import Bicycle, ChaplyginSleigh, RollingDisc
from problems.scenes.slider_crank import SliderCrankFriction


# ---- the sleigh --------------------------------------------------------------------------
def test_the_sleigh_turns_by_a_known_angle_and_runs_forwards():
    scene = ChaplyginSleigh()
    k = np.sqrt(scene.j / scene.m + scene.arm**2)
    ahead = np.arcsin(np.tanh(np.arcsinh(scene.u0 / (k * scene.w0))))
    end = scene.exact(np.array([0.0, 50.0]))
    assert end["q"][1, 2] == pytest.approx(k / scene.arm * (np.pi / 2 - ahead), abs=1e-12)
    assert end["v"][1, 0] == pytest.approx(np.hypot(scene.u0, k * scene.w0), abs=1e-12)


# ---- the disc ----------------------------------------------------------------------------
@cache
def program(cls):
    """Jacobians of rates and of constraints by the state, of a kind of scene."""
    template = cls().template()

    def rates(p, s):
        return ode_rate(template.with_parameters(p), jnp.zeros(()), s)

    def levels(p, s):
        scene, (q, v) = template.with_parameters(p), jnp.split(s, 2)
        rows = [scene.constraint(q, jnp.zeros(()))] if scene.sizes.nh else []
        return jnp.concatenate([*rows, constraint_velocity(scene, q, v, jnp.zeros(()))])

    return jax.jit(lambda p, s: (jax.jacfwd(rates, 1)(p, s), jax.jacfwd(levels, 1)(p, s)))


def jacobians(scene):
    q, v, _ = scene.initial_state()
    return map(np.asarray, program(type(scene))(scene.parameters(), np.concatenate([q, v])))


def test_an_upright_disc_is_stable_above_the_published_spin():
    for spin in [0.9, 1.1, 3.0]:
        # Neimark & Fufaev: spin^2 > A m g r/(C (C + m r^2)), which for a disc is g/(3 r).
        m, r, g = 1.7, 0.4, 9.81
        across, axial = m * r**2 / 4, m * r**2 / 2
        limit = across * m * g * r / (axial * (axial + m * r**2))
        assert limit == pytest.approx(g / (3 * r))
        rate = spin * np.sqrt(limit)
        scene = RollingDisc(m=m, r=r, g=g, lean_rate0=0.0, spin0=rate)
        values = np.linalg.eigvals(next(jacobians(scene)))
        square = m * g * r * (1 - spin**2) / (across + m * r**2)
        lean = np.sqrt(complex(square))
        for wanted in (lean, -lean):
            assert np.abs(values - wanted).min() < 1e-9
        others = np.abs(np.abs(values) - abs(lean)) > 1e-6
        assert np.count_nonzero(others) == 8
        assert np.abs(values[others]).max() < 1e-4  # zeros of multiplicity two
        assert (values.real.max() > 1.0) == (spin < 1)


def test_a_leaning_disc_rolls_in_a_circle():
    # (C + m r^2) W n cos(lean) = A n^2 sin(lean) cos(lean) - m g r sin(lean) for turn n.
    m, r, g, lean, n = 1.0, 0.5, 9.81, 0.4, -2.0
    c, s = np.cos(lean), np.sin(lean)
    axial = (r**2 / 4 * n**2 * s * c - g * r * s) / (1.5 * r**2 * n * c)
    scene = RollingDisc(lean0=lean, turn0=n, lean_rate0=0.0, spin0=axial - n * s)
    t = np.linspace(0.0, 1.0, 6)
    z = reference(scene, 1.0)(t)
    radius = r * axial / n  # signed, to the left
    wanted = [radius * np.sin(n * t), radius * (1 - np.cos(n * t)), n * t, lean + 0 * t]
    assert z["q"] == pytest.approx(np.column_stack([*wanted, (axial - n * s) * t]), abs=1e-11)
    # The plane pushes the centre towards that of the circle.
    push = m * r * axial * n
    assert z["lam"] == pytest.approx(np.tile([0.0, -push], (6, 1)), abs=1e-10)


def test_a_swaying_disc_obeys_newton_and_euler():
    scene = RollingDisc()
    z = reference(scene, 1.0)(np.linspace(0.0, 1.0, 6))
    lean, (_, _, turn, nod, spin) = z["q"][:, 3], z["v"].T
    _, _, turn_rate, nod_rate, spin_rate = z["a"].T
    m, r, g, c, s, zero = scene.m, scene.r, scene.g, np.cos(lean), np.sin(lean), 0 * lean
    axial, axial_rate = spin + turn * s, spin_rate + turn_rate * s + turn * c * nod
    # Along the heading, the axle, and from the ground to the centre; these axes turn, too.
    axes = np.column_stack([nod, turn * s, turn * c])
    inertia = m * r**2 / 4 * np.array([1.0, 2.0, 1.0])
    whirl = np.cross(axes, inertia * np.column_stack([nod, axial, turn * c]))
    tilting = turn_rate * c - turn * s * nod
    rate = inertia * np.column_stack([nod_rate, axial_rate, tilting]) + whirl
    moved = r * np.column_stack([axial, -nod, zero])
    push = r * np.column_stack([axial_rate, -nod_rate, zero]) + np.cross(axes, moved)
    push = m * (push + g * np.column_stack([zero, s, c]))
    assert rate == pytest.approx(np.cross([0.0, 0.0, -r], push), abs=1e-9)
    assert np.abs(lean).max() > 0.3


# ---- the bicycle -------------------------------------------------------------------------
def of_lean_and_steer(speed):
    """Matrix ``(4, 4)`` of the upright bicycle's linear motion in lean, steer and their rates."""
    rates, levels = jacobians(Bicycle(speed=speed, lean_rate=0.0))
    # Place, yaw, turns and speed of the wheels stay; the rest follows by the constraints.
    free, bound = [4, 6, 13, 15], [2, 5, 9, 10, 11, 12, 14, 17]
    along = np.zeros((18, 4))
    along[free] = np.eye(4)
    along[bound] = -np.linalg.solve(levels[:, bound], levels[:, free])
    return (rates @ along)[free]


def weave(speed):
    values = np.linalg.eigvals(of_lean_and_steer(speed))
    return values[values.imag > 0].real.max()


@pytest.mark.long
def test_the_bicycle_is_stable_between_the_published_speeds():
    tight = {"xtol": 1e-14, "rtol": 1e-14}
    # Meijaard et al. (2007), table 2 and section 4.
    capsize = brentq(lambda v: np.linalg.det(of_lean_and_steer(v)), 5.0, 7.0, **tight)
    assert brentq(weave, 4.0, 5.0, **tight) == pytest.approx(4.29238253634111, abs=1e-12)
    assert capsize == pytest.approx(6.02426201538837, abs=1e-11)
    for speed, stable in ((4.2, False), (4.4, True), (5.9, True), (6.1, False)):
        assert (np.linalg.eigvals(of_lean_and_steer(speed)).real.max() < 0) == stable


# ---- the slider crank that rubs -----------------------------------------------------------
#: Angle of the crank, its acceleration and the guide's force at 0.4 s and 1 s, from Newton's laws
#: for each body with one angle, by a program of its own.
RUBBED = {
    0.3: [[5.01060068326, -33.876007951, 2.02441539861],
          [5.370399903, 20.5277513818, 2.67741167845]],
    0.1: [[5.38924195568, 22.6419225242, 2.89055984979],
          [11.6069429061, 8.70639278743, 2.64866054766]],
}  # fmt: skip


@pytest.mark.parametrize("mu", [0.3, *long(0.1)])
def test_the_slider_that_rubs_moves_as_by_newtons_laws_for_one_angle(mu):
    scene = SliderCrankFriction(mu=mu)
    z = reference(scene, 1.0)(np.array([0.4, 1.0]))
    guide = scene.m3 * scene.g - z["lam"][:, 5]
    found = np.column_stack([z["q"][:, 2], z["a"][:, 2], guide])
    assert found == pytest.approx(np.array(RUBBED[mu]), abs=1e-7)
