"""Identities of scenes at random states, and their starts.

Each is written down independently of the scene's blocks: from a power balance, an invariant, the
published equations, or another form of the same system.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers import long

from problems import MechatronicSystem, jax
from problems.base.spec import SpecError
from problems.equations.constraints import constraint_acceleration, constraint_velocity
from problems.scenes.heavy_top import HeavyTop
from problems.scenes.ivp_test_set import CarAxis, SliderCrankFlexible
from problems.scenes.oscillators import DrivenSprings, Duffing, Friction, Oscillator
from problems.scenes.pendulums import Chain, DoublePendulumControlled
from problems.scenes.slider_crank import SliderCrank, SliderCrankDriven, SliderCrankMinimal
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


def options(scene):
    return {field.name: getattr(scene, field.name) for field in fields(scene)}


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
    minimal = SliderCrankMinimal(**options(scene))
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


@of(SliderCrankMinimal())
def check_slider_crank_minimal(scene):
    """Against energy and against the kinetic energy of the bodies."""
    for th, w in [(0.9, 8.0), (2.5, -12.0), (4.0, 3.0)]:
        q, v = crank_bodies(scene, th, w)
        j1, j2 = scene.m1 * scene.l1**2 / 12, scene.m2 * scene.l2**2 / 12
        m = np.array([scene.m1, scene.m1, j1, scene.m2, scene.m2, j2, scene.m3])
        energy = 0.5 * m @ v**2 + scene.g * (scene.m1 * q[1] + scene.m2 * q[4])
        found = at(scene, [th], [w])
        assert found["energy"] == pytest.approx(energy, rel=1e-13)
        (a, _), (by_q, by_v) = solved(scene, [th], [w]), found["slopes"]
        assert by_v @ a == pytest.approx(-by_q[0] * w, rel=1e-12)


@of(CarAxis(), CarAxis(eps=0.2, m=3.0, length=1.5, spring=0.7, r=0.3, w=4.0, g=2.0))
def check_car_axis(scene):
    """The equations as the test set prints them."""
    random = rng()
    for t in (0.1, 0.37):
        q, a = random.normal(size=(2, 4))
        lam = random.normal(size=2)
        yb = scene.r * np.sin(scene.w * t)
        xb = np.sqrt(scene.length**2 - yb**2)
        xl, yl, xr, yr = q
        left, right = np.hypot(xl, yl), np.hypot(xr - xb, yr - yb)
        mass, rest = scene.m * scene.eps**2 / 2, scene.spring
        weight = mass * scene.g
        wanted = [
            (rest - left) * xl / left + lam[0] * xb + 2 * lam[1] * (xl - xr),
            (rest - left) * yl / left + lam[0] * yb + 2 * lam[1] * (yl - yr) - weight,
            (rest - right) * (xr - xb) / right - 2 * lam[1] * (xl - xr),
            (rest - right) * (yr - yb) / right - 2 * lam[1] * (yl - yr) - weight,
        ]
        found = at(scene, q, 0 * q, t)
        residual = found["mass"] @ a - found["force"] + found["jacobian"].T @ lam
        assert residual == pytest.approx(mass * a - wanted, abs=1e-13)
        phi = [xb * xl + yb * yl, (xl - xr) ** 2 + (yl - yr) ** 2 - scene.length**2]
        assert np.abs(found["constraint"]) == pytest.approx(np.abs(phi), abs=1e-13)


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


@of(DoublePendulumControlled(), DoublePendulumControlled(m1=2.0, l1=0.6, g=3.0))
def check_double_pendulum_controlled(scene):
    """Forces that Newton's law leaves for the joints, at any accelerations of both masses."""
    random = rng()
    q, v, a = random.normal(size=(3, 3))
    along, across = (np.array([np.sin(p), -np.cos(p)]) for p in (q[2], q[2] + np.pi / 2))
    swung = scene.l2 * (a[2] * across - v[2] ** 2 * along)
    weight = np.array([0.0, -scene.g])
    second = scene.m2 * (a[:2] + swung - weight)
    first = scene.m1 * (a[:2] - weight)
    found, lam, y = at(scene, q, v), random.normal(size=1), random.normal(size=1)
    residual = found["mass"] @ a - found["force"] + found["jacobian"].T @ lam
    wanted = [*(first + second + lam * q[:2] - [y[0], 0.0]), scene.l2 * across @ second]
    assert residual - scene.actuation() @ y == pytest.approx(wanted, rel=1e-12)


@of(DrivenSprings(), DrivenSprings(m2=2.0))
def check_driven_springs(scene):
    """Power balance: the energy gains what the driven point and the damper give and take."""
    for (q, v), t in zip(rng().normal(size=(3, 2, 2)), (0.0, 0.7, 4.1), strict=True):
        a, _ = solved(scene, q, v, t)
        u, u_dot = np.sin(scene.omega * t), scene.omega * np.cos(scene.omega * t)
        pull = scene.k1 * (u - q[0]) + scene.c1 * (u_dot - v[0])
        power = pull * v[0] + scene.k2 * (q[0] - q[1]) * (v[1] - v[0])
        assert scene.m1 * a[0] * v[0] + scene.m2 * a[1] * v[1] == pytest.approx(power, rel=1e-11)
        # Newton's law for both masses together: the soft spring is an inner force.
        assert scene.m1 * a[0] + scene.m2 * a[1] == pytest.approx(pull, rel=1e-11)


@of(Friction(), Friction(mu=0.7))
def check_friction(scene):
    for q, v in ((2.0, 0.3), (-1.0, -2.0), (0.5, 0.0)):
        total = scene.m * solved(scene, [q], [v])[0][0] + scene.k * q
        assert total == pytest.approx(-scene.mu * np.tanh(v / scene.eps), abs=1e-14)
        assert total * v <= 0  # it takes energy


@of(Oscillator(), Oscillator(omega=3.0))
def check_oscillator(scene):
    a, _ = solved(scene, [0.7], [0.2])
    assert a[0] == pytest.approx(-(scene.omega**2) * 0.7, rel=1e-14)


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
    for cls, options, says in [
        (SliderCrank, {"l2": 0.09}, "does not reach the guide"),
        (SliderCrankDriven, {"l2": 0.1}, "does not reach the guide"),
        (SliderCrankFlexible, {"l2": 0.1}, "must be longer than the crank"),
        (CarAxis, {"r": 1.0}, "must be below the length"),
    ]:
        with pytest.raises(SpecError, match=says):
            cls(**options)
