"""Scenes of rolling and of friction by forces of constraints: closed forms, other equations."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from helpers import long, reference
from scipy.integrate import cumulative_simpson, solve_ivp
from scipy.optimize import brentq

from problems import jax, jnp
from problems.equations.constraints import constraint_velocity
from problems.equations.formulations import ode_rate
from problems.scenes.bicycle import Bicycle
from problems.scenes.chaplygin_sleigh import ChaplyginSleigh
from problems.scenes.rolling_disc import RollingDisc
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


@pytest.mark.long
def test_the_bicycle_in_motion_keeps_energy_weight_and_grip():
    scene = Bicycle(speed=4.6, lean_rate=0.5)
    z = reference(scene, 1.0)(np.linspace(0.0, 1.0, 6))
    energy = [float(scene.energy(q, v)) for q, v in zip(z["q"], z["v"], strict=True)]
    assert energy == pytest.approx([energy[0]] * 6, rel=1e-13)
    assert np.abs(z["q"][:, 4]).max() > 0.05
    # Momentum of all bodies changes by weight, loads and grips alone.
    bodies = jax.jit(lambda q: jnp.array([85.0, 4.0, 2.0, 3.0]) @ scene._centres(q))

    def change(q, v, a):
        speed = lambda q, v: jax.jvp(bodies, (q,), (v,))[1]  # noqa: E731
        return jax.jvp(speed, (q, v), (v, a))[1]

    pushes = np.array([change(*row) for row in zip(z["q"], z["v"], z["a"], strict=True)])
    lam = z["lam"]
    grip = -lam[:, 2:4] - lam[:, 4:6]
    loads = 94 * 9.81 - lam[:, :1] - lam[:, 1:2]
    assert pushes == pytest.approx(np.hstack([grip, loads]), abs=1e-9)
    assert np.abs(grip).max() > 10.0


# ---- the slider crank that rubs -----------------------------------------------------------
def rubbing(scene, th, w):
    """Crank's acceleration, guide's force and friction, by Newton's laws for each body."""
    l1, l2, m1, m2, m3, g = (getattr(scene, n) for n in ("l1", "l2", "m1", "m2", "m3", "g"))
    ph = -np.arcsin(l1 / l2 * np.sin(th))
    c1, s1, u, h = np.cos(th), np.sin(th), l2 * np.cos(ph), l2 * np.sin(ph)
    turn = -l1 * c1 / u * w
    speed = -l1 * s1 * w - h * turn

    def bodies(a, friction):
        b = (l1 * (s1 * w**2 - c1 * a) + h * turn**2) / u
        tip = l1 * np.array([-s1 * a - c1 * w**2, c1 * a - s1 * w**2])
        rod = np.array([-h * b - u * turn**2, u * b - h * turn**2])
        middle, along = tip + rod / 2, friction - m3 * (tip + rod)[0]
        moment = m2 * (l2**2 / 12 * b + (u * middle[1] - h * middle[0] + g * u) / 2)
        guide = (moment + h * along) / u
        pin = m2 * middle - [along, guide] + [0.0, m2 * g]
        return m1 * l1 * (l1 * a / 3 + g * c1 / 2) + l1 * (c1 * pin[1] - s1 * pin[0]), guide

    friction = 0.0
    for _ in range(30):
        rest = bodies(0.0, friction)[0]
        a = -rest / (bodies(1.0, friction)[0] - rest)
        normal = bodies(a, friction)[1] + m3 * g
        size = scene.mu * np.hypot(normal, scene.soft)
        friction = -size * np.tanh(speed / scene.eps)
    return a, normal, friction, speed


@pytest.mark.parametrize("cases", [(SliderCrankFriction(mu=0.3),), *long([SliderCrankFriction()])])
def test_the_slider_that_rubs_moves_as_by_newtons_laws_for_one_angle(cases):
    for scene in cases:
        t = np.linspace(0.0, 1.0, 6)
        z = reference(scene, 1.0)(t)
        path = solve_ivp(
            lambda _, s: [s[1], rubbing(scene, *s)[0]],
            (0.0, 1.0),
            [scene.th0, scene.w0],
            "DOP853",
            t,
            rtol=1e-12,
            atol=1e-13,
        )
        assert z["q"][:, 2] == pytest.approx(path.y[0], abs=1e-9)
        found = np.array([rubbing(scene, *s)[:2] for s in path.y.T])
        assert z["a"][:, 2] == pytest.approx(found[:, 0], abs=1e-7)
        assert scene.m3 * scene.g - z["lam"][:, 5] == pytest.approx(found[:, 1], abs=1e-8)


def test_the_energy_that_is_lost_is_the_work_of_friction():
    scene, t = SliderCrankFriction(), np.linspace(0.0, 1.0, 8001)
    z = reference(scene, 1.0)(t)
    q, v = z["q"].T, z["v"].T
    bodies = np.asarray(scene._inertias())
    energy = 0.5 * bodies @ v**2 + scene.g * (scene.m1 * q[1] + scene.m2 * q[4])
    normal = scene.m3 * scene.g - z["lam"][:, 5]
    power = -scene.mu * np.hypot(normal, scene.soft) * np.tanh(v[6] / scene.eps) * v[6]
    assert np.all(power <= 0.0)
    work = cumulative_simpson(power, x=t, initial=0.0)
    assert work[-1] < -0.1
    assert energy - energy[0] == pytest.approx(work, abs=1e-9)
