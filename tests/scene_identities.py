"""Identities of scenes at random states, one function for each.

Each is written down independently of the scene's blocks: from a power balance, an invariant, the
published equations, or another form of the same system.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scene_mechanics import Measured, assembled, cross, keeps_energy, options, rng, solved
from scipy.spatial.transform import Rotation

from problems.scenes.bricard import Bricard
from problems.scenes.car_axis import CarAxis
from problems.scenes.chain import Chain
from problems.scenes.double_pendulum import DoublePendulumControlled
from problems.scenes.duffing import Duffing
from problems.scenes.flyball_governor import FlyballGovernor
from problems.scenes.heavy_top import HeavyTop
from problems.scenes.slider_crank import SliderCrank, SliderCrankDriven, SliderCrankMinimal
from problems.scenes.slider_crank_flexible import SliderCrankFlexible
from problems.scenes.stiff_bar import StiffBar

#: Scenes, the first with its default parameters, and their check.
CHECKS: list[tuple[tuple, Callable]] = []


def of(*scenes):
    def kept(check):
        CHECKS.append((scenes, check))
        return check

    return kept


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
    assembled(scene)
    minimal = Measured(SliderCrankMinimal(**options(scene)))
    for th, w in [(0.9, 8.0), (2.5, -12.0), (4.0, 3.0)]:
        q, v = crank_bodies(scene, th, w)
        assert np.abs(scene.constraint(q, 0.0)).max() < 1e-14
        a, lam = solved(scene, q, v)
        assert a[2] == pytest.approx(solved(minimal, [th], [w])[0][0], rel=1e-10)
        energy = float(minimal.energy(np.array([th]), np.array([w])))
        assert float(scene.energy(q, v)) == pytest.approx(energy, rel=1e-12)
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
        at = np.array([th]), np.array([w])
        assert float(scene.energy(*at)) == pytest.approx(energy, rel=1e-13)
        a, _ = solved(scene, *at)
        by_q, by_v = scene.slopes(*at)
        assert float(by_v @ a) == pytest.approx(-float(by_q @ at[1]), rel=1e-12)


@of(SliderCrankDriven(), SliderCrankDriven(l1=0.2, l2=0.23, omega=31.0, m3=2.0))
def check_slider_crank_driven(scene):
    t = rng().uniform(0.0, 0.05, 5)
    z = scene.exact(t)
    p = scene.omega * t
    pin = scene.l1 * np.column_stack([np.cos(p), np.sin(p)])
    rod = np.column_stack([z["q"][:, 1], 0 * t]) - pin
    assert np.linalg.norm(rod, axis=1) == pytest.approx(scene.l2, rel=1e-14)
    for k in range(len(t)):
        a, lam = solved(scene, z["q"][k], z["v"][k], t[k])
        assert a == pytest.approx(z["a"][k], rel=1e-11, abs=1e-8)
        assert lam == pytest.approx(z["lam"][k], rel=1e-11)
        # The rod pulls at slider and pin; the drive balances its moment.
        pull = scene.m3 * a[1] / rod[k, 0] * rod[k]
        assert lam[0] * rod[k] == pytest.approx(-pull, rel=1e-11)
        assert lam[1] == pytest.approx(-cross(pin[k], pull), rel=1e-11)
        assert np.abs(scene.constraint(z["q"][k], t[k])).max() < 1e-14


def rod_energies(scene, q, v):
    """Kinetic and strain energy of the elastic rod from its field of displacements."""
    # Rotary inertia m2 h^2/12 is counted at the rod's angle only, and the longitudinal elastic mass
    # 15 times, both as the test set does.
    nodes, weights = np.polynomial.legendre.leggauss(30)
    s, weights = (nodes + 1) / 2, weights / 2
    l1, l2 = scene.l1, scene.l2
    m2 = scene.density * scene.width * scene.height * l2

    def place(q):
        along = l2 * s + 4 * s * (1 - s) * q[5] + s * (2 * s - 1) * q[6]
        across = np.sin(np.pi * s) * q[3] + np.sin(2 * np.pi * s) * q[4]
        c, n = np.cos(q[1]), np.sin(q[1])
        tip = l1 * np.array([[np.cos(q[0])], [np.sin(q[0])]])
        return tip + np.array([c * along - n * across, n * along + c * across])

    eps = 1e-20
    speed = np.imag(place(q + 1j * eps * v)) / eps
    again = np.array([[8, 1], [1, 2]]) / 15 * 14
    kinetic = 0.5 * m2 * ((speed**2).sum(axis=0) @ weights + scene.height**2 / 12 * v[1] ** 2)
    kinetic += 0.5 * m2 * (v[5:] @ again @ v[5:] + v[1] ** 2 * (q[5:] @ again @ q[5:]))
    kinetic += 0.5 * (scene.j1 * v[0] ** 2 + scene.m3 * v[2] ** 2)
    bent = -(np.pi**2) * (np.sin(np.pi * s) * q[3] + 4 * np.sin(2 * np.pi * s) * q[4]) / l2**2
    strain = ((4 - 8 * s) * q[5] + (4 * s - 1) * q[6]) / l2
    area = scene.width * scene.height
    density = area * strain**2 + area * scene.height**2 / 12 * bent**2
    return kinetic, 0.5 * scene.young * l2 * density @ weights


@of(SliderCrankFlexible(), SliderCrankFlexible(l1=0.1, width=0.01, young=1e9, omega=70.0))
def check_slider_crank_flexible(scene):
    random, _ = rng(), assembled(scene)
    amplitude = np.array([0, 0, 0, 1e-2, 1e-2, 1e-2, 1e-2])
    for p in (0.4, 2.0):
        q, v = amplitude * random.normal(size=(2, 7))
        length = scene.l2 + q[6]
        q[0], q[1] = p, -np.arcsin(scene.l1 * np.sin(p) / length)
        q[2] = scene.l1 * np.cos(p) + length * np.cos(q[1])
        pin = scene.l1 * np.exp(1j * p)
        tip = length * np.exp(1j * q[1])
        assert pin + tip == pytest.approx(q[2], rel=1e-14)
        v = 1e2 * v
        v[0] = scene.omega
        v[1] = -(pin.real * v[0] + v[6] * np.sin(q[1])) / tip.real
        v[2] = -pin.imag * v[0] - tip.imag * v[1] + v[6] * np.cos(q[1])
        kinetic, strain = rod_energies(scene, q, v)
        assert float(scene._kinetic_energy(q, v)) == pytest.approx(kinetic, rel=1e-12)
        assert float(scene._potential_energy(q)) == pytest.approx(strain, rel=1e-12)
        keeps_energy(scene, q, v, p / scene.omega, tolerance=1e-10)


@of(CarAxis(), CarAxis(eps=0.2, m=3.0, length=1.5, spring=0.7, r=0.3, w=4.0, g=2.0))
def check_car_axis(scene):
    """The equations as the test set prints them."""
    random, _ = rng(), assembled(scene)
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
        found = scene.at(q, 0 * q, t)
        residual = found["mass"] @ a - found["force"] + found["jacobian"].T @ lam
        assert residual == pytest.approx(mass * a - wanted, abs=1e-13)
        phi = [xb * xl + yb * yl, (xl - xr) ** 2 + (yl - yr) ** 2 - scene.length**2]
        assert np.abs(scene.constraint(q, t)) == pytest.approx(np.abs(phi), abs=1e-13)


@of(StiffBar(), StiffBar(length=1.0, ea=1e3, m=2.0, v0=3.0, stretch=0.6))
def check_stiff_bar(scene):
    random = rng()
    t = random.uniform(0.0, 10.0, 5)
    z = scene.exact(t)
    for k in range(len(t)):
        a, _ = solved(scene, z["q"][k], z["v"][k])
        assert a == pytest.approx(z["a"][k], rel=1e-6, abs=1e-6)  # q's rounding, a stiff force
        q, v = random.normal(size=(2, 2))
        a, _ = solved(scene, q, v)
        by_q, by_v = scene.slopes(q, v)
        assert float(by_v @ a) == pytest.approx(-float(by_q @ v), rel=1e-12)
        assert cross(q, a) == pytest.approx(0.0, abs=1e-12 * np.abs(a).max())
        assert np.asarray(scene.momentum(q, v)) == pytest.approx([scene.m * cross(q, v)])


@of(HeavyTop(), HeavyTop(m=2.0, length=0.3, j=0.05, j_axis=0.02, g=4.0))
def check_heavy_top(scene):
    """Energy, vertical and axial angular momentum stay: three conditions for three freedoms."""
    random, _ = rng(), assembled(scene)

    def turned(p):  # scipy has the scalar last
        return Rotation.from_quat(np.roll(p, -1)).as_matrix()

    inertia = np.diag([scene.j, scene.j_axis, scene.j])
    rotations = Rotation.from_rotvec([[0.3, -0.8, 0.5], [-2.0, 0.4, 1.1]])
    for p, w in zip(
        np.roll(rotations.as_quat(), 1, axis=1), random.normal(size=(2, 3)), strict=True
    ):
        arm = np.array([0, scene.length, 0])
        matrix = turned(p)
        eps = 1e-6
        rate = [0.5 * -(p[1:] @ w), *(0.5 * (p[0] * w + np.cross(p[1:], w)))]  # w: body's axes
        q = np.concatenate([matrix @ arm, p])
        v = np.concatenate([matrix @ np.cross(w, arm), rate])
        slope = (turned(p + eps * v[3:]) - turned(p - eps * v[3:])) / (2 * eps)
        assert matrix.T @ slope @ arm == pytest.approx(np.cross(w, arm), abs=1e-9)

        a, lam = solved(scene, q, v)
        # v in the body's axes, and its rate, from what a means for w.
        w_rate = 2 * (p[0] * a[4:] - a[3] * p[1:] - np.cross(p[1:], a[4:]))
        momentum = inertia @ w
        turning = matrix @ (inertia @ w_rate + np.cross(w, momentum))
        moment = turning + scene.m * np.cross(q[:3], a[:3])
        assert moment[2] == pytest.approx(0.0, abs=1e-11)
        assert w_rate[1] == pytest.approx(0.0, abs=1e-11)
        power = w @ inertia @ w_rate + scene.m * v[:3] @ a[:3] + scene.m * scene.g * v[2]
        assert power == pytest.approx(0.0, abs=1e-10)
        law = np.cross(q[:3], [0, 0, -scene.m * scene.g])  # of moments about the joint
        assert moment == pytest.approx(law, abs=1e-10)
        # Joint force, and the multiplier of the norm from homogeneity in p.
        weight = np.array([0, 0, -scene.m * scene.g])
        assert -lam[:3] == pytest.approx(scene.m * a[:3] - weight, rel=1e-11)
        spinning = 0.5 * w @ momentum
        assert lam[3] == pytest.approx(4 * spinning + 2 * q[:3] @ lam[:3], rel=1e-11)
        keeps_energy(scene, q, v, 0.0)
        about = matrix @ momentum + scene.m * np.cross(q[:3], v[:3])
        assert np.asarray(scene.momentum(q, v)) == pytest.approx([about[2], momentum[1]], rel=1e-12)


@of(Chain(), Chain(links=3, m=0.7, length=1.3, g=2.0))
def check_chain(scene):
    assembled(scene)
    th, w = rng().uniform(-2, 2, (2, scene.links))
    link = scene.length * np.column_stack([np.sin(th), -np.cos(th)])
    swing = scene.length * np.column_stack([np.cos(th), np.sin(th)]) * w[:, None]
    q, v = link.cumsum(axis=0), swing.cumsum(axis=0)
    keeps_energy(scene, q.ravel(), v.ravel(), 0.0)
    a, lam = solved(scene, q.ravel(), v.ravel())
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
    random, _ = rng(), assembled(scene)
    q, v, a = random.normal(size=(3, 3))
    along, across = (np.array([np.sin(p), -np.cos(p)]) for p in (q[2], q[2] + np.pi / 2))
    swung = scene.l2 * (a[2] * across - v[2] ** 2 * along)
    weight = np.array([0.0, -scene.g])
    second = scene.m2 * (a[:2] + swung - weight)
    first = scene.m1 * (a[:2] - weight)
    found, lam, y = scene.at(q, v), random.normal(size=1), random.normal(size=1)
    residual = found["mass"] @ a - found["force"] + found["jacobian"].T @ lam
    wanted = [*(first + second + lam * q[:2] - [y[0], 0.0]), scene.l2 * across @ second]
    assert residual - scene.actuation() @ y == pytest.approx(wanted, rel=1e-12)


@of(FlyballGovernor(), FlyballGovernor(k=3e2, c=20.0, rest=0.3, g=3.0))
def check_flyball_governor(scene):
    """The equations as the source prints them, with differences of lengths and inertia."""
    random, eps = rng(), 1e-20j
    for _ in range(3):
        q, v = np.array([0.3, 0.5, 0.4]) + 0.2 * random.normal(size=(2, 3))

        def inertia(alpha):
            reach, cos, sin = 0.05 + 0.5 * np.cos(alpha), np.cos(alpha), np.sin(alpha)
            rod = 5e-6 * sin**2 + 0.0250025 * cos**2 + 0.3 * reach**2
            return 5e-6 + 0.005 + 2 * (rod + 5 * (0.05 + cos) ** 2)

        def length(alpha, s):
            return np.sqrt((0.5 * np.cos(alpha)) ** 2 + (1 - 0.5 * np.sin(alpha) - s) ** 2)

        slope = np.imag(inertia(q[1] + eps)) / eps.imag
        by = np.imag([length(q[1] + eps, q[2]), length(q[1], q[2] + eps)]) / eps.imag
        pull = scene.k * (length(*q[1:]) - scene.rest) + scene.c * by @ v[1:]
        weight = scene.g * (0.5 * 0.3 + 5.0) * np.cos(q[1])
        wanted = [
            -slope * v[1] * v[0] / inertia(q[1]),
            (0.5 * slope * v[0] ** 2 - 2 * pull * by[0] + 2 * weight) / (2 * 5.1000025),
            -2 * pull * by[1] / 3 - scene.g,
        ]
        assert solved(scene, q, v)[0] == pytest.approx(wanted, rel=1e-12)
        assert scene.momentum(q, v) == pytest.approx([inertia(q[1]) * v[0]], rel=1e-12)


@of(Bricard(), Bricard(m=2.0, length=0.7, side=0.3, g=3.0))
def check_bricard(scene):
    """Energies and closure of the chain by rotations of scipy, forces by the balance of power."""
    random, axes = rng(), np.eye(3)[[1, 2, 0, 1, 2]]
    rods = scene.length * np.array([[1, 0, 0], [0, -1, 0], [0, 0, 1], [-1, 0, 0], [0, 1, 0]])
    principal = scene.m / 12 * np.where(rods, 2 * scene.side**2, scene.length**2 + scene.side**2)

    def chain(q):
        turned, joints = [Rotation.identity()], [np.zeros(3)]
        for axis, angle, rod in zip(axes, q, rods, strict=True):
            turned.append(turned[-1] * Rotation.from_rotvec(angle * axis))
            joints.append(joints[-1] + turned[-1].apply(rod))
        return turned[1:], np.array(joints)

    assembled(scene)
    eps = 1e-5
    for q, v in random.normal(size=(2, 2, 5)):
        (before, first), (turned, joints), (after, last) = (
            chain(q + k * v) for k in (-eps, 0, eps)
        )
        centres = (last - first)[:-1] + (last - first)[1:]
        kinetic = 0.5 * scene.m * (centres**2).sum() / (4 * eps) ** 2
        for a, b, now, inertia in zip(before, after, turned, principal, strict=True):
            turning = now.apply((b * a.inv()).as_rotvec() / (2 * eps), inverse=True)
            kinetic += 0.5 * inertia @ turning**2
        assert float(scene._kinetic_energy(q, v)) == pytest.approx(kinetic, rel=1e-8)
        weights = scene.m * scene.g * (joints[:-1] + joints[1:])[:, 1].sum() / 2
        assert float(scene._potential_energy(q)) == pytest.approx(weights, rel=1e-12)
        gap = joints[-1] - [0.0, 0.0, scene.length]
        axis = turned[-1].apply([1.0, 0.0, 0.0])[1:]
        assert scene.constraint(q, 0.0) == pytest.approx([*gap, *axis], abs=1e-13)
        found = scene.at(q, v)
        by_q, by_v = found["slopes"]
        free = np.linalg.solve(found["mass"], found["force"])
        assert by_v @ free == pytest.approx(-by_q @ v, rel=1e-11)
