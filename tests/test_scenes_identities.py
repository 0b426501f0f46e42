"""Identities of scenes at random states, and scenes of rolling, friction and spatial mechanisms."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers import long, reference
from scipy.optimize import brentq

from problems import MechatronicSystem, jax, jnp
from problems.base.spec import SpecError
from problems.equations.formulations import ode_rate
from problems.equations.kinematics import constraint_acceleration, constraint_velocity
from problems.scenes.heavy_top import HeavyTop
from problems.scenes.ivp_test_set import CarAxis, SliderCrankFlexible
from problems.scenes.oscillators import Duffing
from problems.scenes.pendulums import Chain
from problems.scenes.rolling import Bicycle, ChaplyginSleigh, RollingDisc
from problems.scenes.slider_crank import (
    SliderCrank,
    SliderCrankDriven,
    SliderCrankFriction,
    SliderCrankMinimal,
)
from problems.scenes.spatial_mechanisms import SpatialFourBar, SpatialSliderCrank
from problems.truth.reference import Reference

#: Scenes, the first with its default parameters, and their check.
CHECKS: list[tuple[tuple, Callable]] = []


def of(*scenes):
    def kept(check):
        CHECKS.append((scenes, check))
        return check

    return kept


def rng():
    return np.random.default_rng(20)


def cross(a, b):
    return a[0] * b[1] - a[1] * b[0]


@cache
def _program(template: MechatronicSystem) -> Any:
    def values(p, q, v, t):
        scene = template.with_parameters(p)
        found = {"mass": scene.mass(q), "force": scene.force(q, v, t)}
        if scene.has("constraint"):
            found["jacobian"] = jax.jacfwd(scene.constraint)(q, t)
            found["rest"] = constraint_acceleration(scene, q, v, 0 * q, t)
            found["constraint"] = scene.constraint(q, t)
            found["velocity"] = constraint_velocity(scene, q, v, t)
        if scene.has("energy"):
            found["energy"], found["slopes"] = jax.value_and_grad(scene.energy, (0, 1))(q, v)
        return found

    return jax.jit(values)


def at(scene: MechatronicSystem, q: Any, v: Any, t: float = 0.0) -> dict[str, Any]:
    """Values of a scene's blocks at a state, by one compiled program."""
    state = np.asarray(q, dtype=float), np.asarray(v, dtype=float), float(t)
    found = _program(scene.template())(scene.parameters(), *state)
    return jax.tree.map(np.asarray, found)


def solved(scene: MechatronicSystem, q: Any, v: Any, t: float = 0.0) -> tuple:
    """a and lam of the equations of motion at one state."""
    found = at(scene, q, v, t)
    if "jacobian" not in found:
        return np.linalg.solve(found["mass"], found["force"]), np.zeros(0)
    jacobian, rest = found["jacobian"], found["rest"]
    augmented = np.block([[found["mass"], jacobian.T], [jacobian, np.zeros((len(rest),) * 2)]])
    right = np.concatenate([found["force"], -rest])
    return tuple(np.split(np.linalg.solve(augmented, right), [len(q)]))


@of(Duffing(), Duffing(m=2.0, c=-0.4, k=3.0, k3=-0.2, amplitude=1.7, w=0.6))
def check_duffing(scene):
    random = rng()
    for q, v, t in random.normal(size=(3, 3, 1)):
        a, _ = solved(scene, q, v, t[0])
        drive = scene.amplitude * np.cos(scene.w * t)
        wanted = drive - scene.c * v - scene.k * q - scene.k3 * q**3
        assert scene.m * a == pytest.approx(wanted, rel=1e-13)


def crank_bodies(scene, th, w):
    """Absolute coordinates and velocities, from positions."""

    def at(th):
        ph = -np.arcsin(scene.l1 * np.sin(th) / scene.l2)
        pin = scene.l1 * np.array([np.cos(th), np.sin(th)])
        rod = scene.l2 * np.array([np.cos(ph), np.sin(ph)])
        return np.array([*(pin / 2), th, *(pin + rod / 2), ph, (pin + rod)[0]])

    eps = 1e-20j  # a complex step has no cancellation
    return at(th), np.imag(at(th + eps)) / eps.imag * w


@of(SliderCrank(), SliderCrank(l1=0.2, l2=0.5, m1=1.0, m2=0.7, m3=0.4, g=3.0))
def check_slider_crank(scene):
    minimal = SliderCrankMinimal(**scene.parameters())
    for th, w in [(0.9, 8.0), (2.5, -12.0), (4.0, 3.0)]:
        q, v = crank_bodies(scene, th, w)
        assert np.abs(at(scene, q, v)["constraint"]).max() < 1e-14
        a, lam = solved(scene, q, v)
        assert a[2] == pytest.approx(solved(minimal, [th], [w])[0][0], rel=1e-10)
        energy = at(minimal, [th], [w])["energy"]
        assert at(scene, q, v)["energy"] == pytest.approx(energy, rel=1e-12)
        # Newton's and Euler's laws, body by body.
        m1, m2, m3, g = scene.m1, scene.m2, scene.m3, scene.g
        crank = [m1 * a[0], m1 * (a[1] + g)]
        rod = [m2 * a[3], m2 * (a[4] + g)]
        assert -lam[:5] == pytest.approx([*crank, *rod, m3 * a[6]], rel=1e-10)
        end = np.array([-m3 * a[6], -lam[5]])  # on the rod's end, from slider and guide
        arm = scene.l2 / 2 * np.array([np.cos(q[5]), np.sin(q[5])])
        pin = np.array(rod) - end
        moment = cross(arm, end) - cross(arm, pin)
        assert moment == pytest.approx(m2 * scene.l2**2 / 12 * a[5], rel=1e-9)


@of(Chain(), Chain(links=3, m=0.7, length=1.3, g=2.0))
def check_chain(scene):
    th, w = rng().uniform(-2, 2, (2, scene.links))
    link = scene.length * np.column_stack([np.sin(th), -np.cos(th)])
    swing = scene.length * np.column_stack([np.cos(th), np.sin(th)]) * w[:, None]
    q, v = link.cumsum(axis=0), swing.cumsum(axis=0)
    a, lam = solved(scene, q.ravel(), v.ravel())
    by_q, by_v = at(scene, q.ravel(), v.ravel())["slopes"]
    assert by_v @ a == pytest.approx(-by_q @ v.ravel(), rel=1e-11)
    a = a.reshape(-1, 2)
    # Newton's law, mass by mass: lam is a link's tension over its length.
    pull = np.vstack([lam[:, None] * link, np.zeros(2)])
    weight = np.array([0, -scene.m * scene.g])
    assert scene.m * a == pytest.approx(pull[1:] - pull[:-1] + weight, abs=1e-11)
    # Each link turns without stretching: relative accelerations along it are centripetal.
    along = (np.diff(a, axis=0, prepend=np.zeros((1, 2))) * link).sum(axis=1)
    assert along == pytest.approx(-(scene.length**2) * w**2, rel=1e-10)


@pytest.mark.parametrize("others", [False, *long(True)])
def test_scenes_satisfy_their_identities_from_a_consistent_start(others):
    for scenes, check in CHECKS:
        for scene in scenes[1:] if others else scenes[:1]:
            check(scene)
            q, v, _ = scene.initial_state()
            t = scene.interval[0]
            if scene.has("constraint"):
                found = at(scene, q, v, t)
                assert np.abs(found["constraint"]).max() < 1e-13
                assert np.abs(found["velocity"]).max() < 1e-13 * max(1.0, np.abs(v).max())
            for line in scene.draw(q):
                assert line.shape[1:] == (2,)
                assert np.isfinite(line).all()


@pytest.mark.long
def test_a_drawing_shows_where_the_bodies_are():
    def later(scene):
        t = scene.interval[0] + 0.2 * np.ptp(scene.interval)
        q = Reference(scene, t)(np.array([t]))["q"][0]
        return t, q, scene.draw(q)

    t, _, lines = later(CarAxis())  # q does not hold the moving wheel: it is found from the axle
    assert lines[3][1] == pytest.approx(np.asarray(CarAxis()._wheel(t)), abs=1e-10)
    _, q, lines = later(HeavyTop())
    assert lines[0][1] == pytest.approx([q[1] - 0.4 * q[0], q[2] - 0.4 * q[0]], abs=1e-10)
    for scene, slider in ((SliderCrankFlexible(), 2), (SliderCrank(), 6), (SliderCrankDriven(), 1)):
        _, q, lines = later(scene)
        assert lines[1][-1] == pytest.approx([q[slider], 0], abs=1e-10)


def test_parameters_that_cannot_be_assembled_are_refused():
    for cls, given, says in [
        (SliderCrank, {"l2": 0.09}, "does not reach the guide"),
        (SliderCrankDriven, {"l2": 0.1}, "does not reach the guide"),
        (SliderCrankFlexible, {"l2": 0.1}, "must be longer than the crank"),
        (CarAxis, {"r": 1.0}, "must be below the length"),
    ]:
        with pytest.raises(SpecError, match=says):
            cls(**given)


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


@pytest.mark.long
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


@pytest.mark.long
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


@pytest.mark.parametrize("mu", long(0.3, 0.1))
def test_the_slider_that_rubs_moves_as_by_newtons_laws_for_one_angle(mu):
    scene = SliderCrankFriction(mu=mu)
    z = reference(scene, 1.0)(np.array([0.4, 1.0]))
    guide = scene.m3 * scene.g - z["lam"][:, 5]
    found = np.column_stack([z["q"][:, 2], z["a"][:, 2], guide])
    assert found == pytest.approx(np.array(RUBBED[mu]), abs=1e-7)


#: At 0.5 s: the crank's rate and acceleration, and the centres of all bodies in m. They are of
#: a program of its own: bodies follow one angle in closed form, and its equation of Lagrange, with
#: the inertia and weight that follow, is integrated (DOP853, rtol=1e-13).
DIGITS = [
    (SpatialFourBar(), 2, 8.39192583632, 20.7645046932, [
        [0.04200215745, -0.02712597961, 0.0], [0.2232938799, 0.02287402039, 0.14882876184],
        [0.38129172245, 0.1, 0.14882876184]]),
    (SpatialSliderCrank(), 0, 14.4081608102, -105.43676212, [
        [0.0, 0.12575104311, 0.15060855728], [0.09247631489, 0.07575104311, 0.09060855728],
        [0.18495262978, 0.0, 0.0]]),
]  # fmt: skip


@pytest.mark.parametrize(("scene", "axis", "rate", "acceleration", "centres"), long(*DIGITS))
def test_the_mechanism_moves_as_by_its_one_angle(scene, axis, rate, acceleration, centres):
    z = reference(scene, 0.5)(np.linspace(0.0, 0.5, 11))
    q, v, a = (z[g].reshape(11, 3, -1) for g in "qva")
    assert v[-1, 0, 3 + axis] == pytest.approx(rate, abs=1e-9)
    assert a[-1, 0, 3 + axis] == pytest.approx(acceleration, abs=1e-7)
    assert q[-1, :, :3] == pytest.approx(np.array(centres), abs=1e-9)
    energy = [float(scene.energy(*s)) for s in zip(z["q"], z["v"], strict=True)]
    assert energy == pytest.approx(np.full(11, energy[0]), rel=1e-11)


def test_the_start_of_the_slider_crank_is_that_of_its_source():
    """The velocities of all bodies follow from that of the crank (values of the benchmark)."""
    v = SpatialSliderCrank().initial_state().v.reshape(3, 6)
    assert v[1] == pytest.approx([0.12, -0.24, 0.0, 1.92, -0.96, 0.48], abs=1e-13)
    assert v[2] == pytest.approx([0.24, 0.0, 0.0, 0.0, 0.0, 0.0], abs=1e-13)
