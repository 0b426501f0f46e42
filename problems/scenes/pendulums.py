"""Pendulums, a chain, and a bar: masses that turn about a fixed point in a plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, State, Variables, jax, jnp, parameter
from problems.mechanics import drawing
from problems.mechanics.points import PointMasses


def _hung(length: float, *places: np.ndarray) -> list[np.ndarray]:
    """Rods from the pivot from place to place, and masses there."""
    masses = [drawing.circle(at, 0.06 * length) for at in places]
    return [np.array([[0.0, 0.0], *places]), *masses]


@dataclass(frozen=True)
class Pendulum(PointMasses):
    """A point mass on a massless rod: a small index-3 system with an exact solution.

    Released at rest at angle th0 from the downward vertical; by default the run starts 0.35 s
    later, so that velocity and jerk are not zero and the start-up error of the multiplier
    shows. Tests order in q, v, a and lambda on a constraint of its own. Left out: damping,
    for which the closed form by elliptic functions would be lost, and the inertia of the rod. Other
    values of copies and radial make the scene faulty on purpose, to test the messages of methods.
    """

    interval = (0.35, 1.35)
    nominal_step = 0.02
    tags = ("constrained", "index 3", "closed form", "conservative", "conformance")
    difficulties = (
        "index 3: undamped methods leave a and lam oscillating",
        "the plain start leaves a first-order transient in a and lam",
        "near the upright position (th0 close to pi) small errors grow exponentially",
    )
    coordinates = ("X [m]", "Y [m]")
    multipliers = ("rod [N/m]",)
    source = "Closed form by Jacobi elliptic functions, e.g. Landau & Lifshitz, Mechanics, par. 11"

    m: float = parameter(1.0, "kg", "mass", low=1e-12)
    length: float = parameter(1.0, "m", "length of the rod", low=1e-12)
    g: float = parameter(9.81, "m/s^2", "gravity", low=1e-12)
    th0: float = parameter(
        np.pi / 2, "rad", "amplitude: angle at rest at t=0", low=1e-6, high=np.pi - 1e-9
    )

    copies: int = parameter(
        1, "-", "how often the constraint is stated; more than once is redundant", low=1
    )
    radial: float = parameter(
        0.0, "m/s", "velocity along the rod at the start; all but zero contradicts the constraint"
    )

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return jnp.stack([0.0 * self.m, -self.m * self.g])

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        return jnp.tile(0.5 * (q @ q - self.length**2), self.copies)

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return 0.5 * self.m * (v @ v) + self.m * self.g * q[1]

    def initial_state(self) -> State:
        q, v, x = super().initial_state()
        return State(q, v + self.radial / self.length * q, x)

    def exact(self, t: np.ndarray) -> dict[str, np.ndarray]:
        """th(t) = 2 asin(k sn(K - w t, k^2)) with k = sin(th0/2), w = sqrt(g/length)."""
        from scipy.special import ellipj, ellipk

        t = np.asarray(t, dtype=float)
        k, w = np.sin(self.th0 / 2), np.sqrt(self.g / self.length)
        sn, cn, dn, _ = ellipj(ellipk(k * k) - w * t, k * k)
        rate = -2 * k * w * cn
        sin, cos = 2 * k * sn * dn, 1 - 2 * (k * sn) ** 2  # of th, without forming th itself
        bend = -w * w * sin
        lam = self.m * (rate**2 + w * w * cos) / self.copies
        e_r, e_t = np.column_stack([sin, -cos]), np.column_stack([cos, sin])
        return {
            "q": self.length * e_r,
            "v": self.length * rate[:, None] * e_t,
            "a": self.length * (bend[:, None] * e_t - (rate**2)[:, None] * e_r),
            "lam": np.tile(lam[:, None], self.copies),
        }

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        return _hung(self.length, q)


@dataclass(frozen=True)
class TwoRods(MechatronicSystem):
    interval = (0.0, 1.0)
    nominal_step = 0.02

    m1: float = parameter(1.0, "kg", "first mass", low=1e-12)
    m2: float = parameter(0.5, "kg", "second mass", low=1e-12)
    l1: float = parameter(1.0, "m", "length of the first rod", low=1e-12)
    l2: float = parameter(0.8, "m", "length of the second rod", low=1e-12)
    g: float = parameter(9.81, "m/s^2", "gravity")
    angle1: float = parameter(1.0, "rad", "angle of the first rod from the downward vertical")
    angle2: float = parameter(0.3, "rad", "angle of the second rod from the downward vertical")
    rate1: float = parameter(1.0, "rad/s", "rate of the first angle at the start")
    rate2: float = parameter(-2.0, "rad/s", "rate of the second angle at the start")


@dataclass(frozen=True)
class DoublePendulum(TwoRods):
    """Two masses on two rods, thrown against each other: a scene that hides no loss of order.

    A velocity along the first rod changes both multipliers in proportion. On a single pendulum it
    changes them by its square, so that an order that velocities lose does not show in them. Left
    out: the inertia of the rods.
    """

    tags = ("constrained", "index 3", "conservative", "orders")
    difficulties = (
        "two multipliers that change in proportion to velocities along the rods",
        "the plain start leaves a first-order transient in a and lam",
    )
    coordinates = ("X1 [m]", "Y1 [m]", "X2 [m]", "Y2 [m]")
    multipliers = ("first rod [N/m]", "second rod [N/m]")
    source = "Standard planar mechanism; data chosen for this bench"

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.diag(jnp.stack([self.m1, self.m1, self.m2, self.m2]))

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return -self.g * jnp.stack([0.0 * self.m1, self.m1, 0.0 * self.m2, self.m2])

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        rods = jnp.stack([q[:2], q[2:] - q[:2]])
        return 0.5 * ((rods**2).sum(axis=1) - jnp.stack([self.l1**2, self.l2**2]))

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        squares = v**2
        kinetic = self.m1 * (squares[0] + squares[1]) + self.m2 * (squares[2] + squares[3])
        return kinetic / 2 + self.g * (self.m1 * q[1] + self.m2 * q[3])

    def initial_state(self) -> State:
        lengths = np.array([self.l1, self.l2])[:, None]
        angles, rates = np.array([self.angle1, self.angle2]), np.array([self.rate1, self.rate2])
        along = lengths * np.stack([np.sin(angles), -np.cos(angles)], axis=1)
        across = lengths * np.stack([np.cos(angles), np.sin(angles)], axis=1) * rates[:, None]
        return State(q=np.cumsum(along, axis=0).ravel(), v=np.cumsum(across, axis=0).ravel())

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        return _hung(self.l1, q[:2], q[2:])


@dataclass(frozen=True)
class DoublePendulumControlled(TwoRods):
    """The double pendulum with an acceleration sensor and a motor that lags behind its demand.

    M depends on q, as the second rod is given by its angle from the downward vertical. The
    multiplier changes in proportion to velocities along the first rod, because these turn the
    second one. The horizontal acceleration of the first mass drives a filter, and the filter's
    state, saturated, is a force on the same mass. Left out: the inertia of the rods.
    """

    tags = ("constrained", "index 3", "mechatronic", "orders")
    difficulties = (
        "M(q), a constraint and a controller at once: no part of a method hides its order",
        "the plain start leaves a first-order transient in a and lam",
        "the acceleration is fed back in the step: a first-order one spoils everything",
    )
    coordinates = ("X1 [m]", "Y1 [m]", "second rod [rad]")
    multipliers = ("first rod [N/m]",)
    states = ("filter [N]",)
    outputs = ("force [N]",)
    source = "Standard planar mechanism with the control law of Bruels & Arnold (2008), section 6"

    sigma: float = parameter(4.0, "1/s", "leak of the filter")
    b: float = parameter(1.0, "N s/m", "feedback gain on the acceleration")
    f_max: float = parameter(4.0, "N", "saturation of the motor", low=1e-12)

    def mass(self, q: jax.Array) -> jax.Array:
        both, arm = self.m1 + self.m2, self.m2 * self.l2
        x, y = arm * jnp.cos(q[2]), arm * jnp.sin(q[2])
        rows = [[both, 0.0 * x, x], [0.0 * y, both, y], [x, y, arm * self.l2]]
        return jnp.stack([jnp.stack(row) for row in rows])

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        both, arm = self.m1 + self.m2, self.m2 * self.l2
        x, y = arm * jnp.cos(q[2]), arm * jnp.sin(q[2])
        return jnp.stack([v[2] ** 2 * y, -(v[2] ** 2) * x - both * self.g, -self.g * y])

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        return 0.5 * (q[0] ** 2 + q[1] ** 2 - self.l1**2)[None]

    def state_rate(self, z: Variables) -> jax.Array:
        return -self.sigma * z.x - self.b * z.a[:1]

    def output(self, z: Variables) -> jax.Array:
        return self.f_max * jnp.tanh(z.x / self.f_max)

    def actuation(self) -> np.ndarray:
        return np.array([[1.0], [0.0], [0.0]])

    def initial_state(self) -> State:
        angle, length = self.angle1, self.l1
        place = length * np.array([np.sin(angle), -np.cos(angle)])
        moving = length * self.rate1 * np.array([np.cos(angle), np.sin(angle)])
        return State(np.append(place, self.angle2), np.append(moving, self.rate2), np.zeros(1))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        return _hung(self.l1, q[:2], q[:2] + self.l2 * np.array([np.sin(q[2]), -np.cos(q[2])]))


@dataclass(frozen=True)
class Chain(PointMasses):
    """Point masses on massless links, one after the other from a fixed pivot: 2N coordinates, N
    constraints, index 3.

    Tests how the cost of a step grows with the size of a system whose equations each know their
    neighbours only. One link is the pendulum, two are the double pendulum. The chain starts
    straight and turns as a whole, so that velocity and jerk are not zero. Left out: inertia of
    the links, which would add coordinates and constraints and no new coupling. The interval is
    short, so that errors show the method and not the chaos. The blocks have no loop over links, so
    that the time to compile does not grow with them.
    """

    interval = (0.0, 0.5)
    nominal_step = 0.01
    tags = ("constrained", "index 3", "conservative", "chaotic", "scalable")
    difficulties = (
        "the motion is chaotic: errors grow with the interval and with the number of links",
        "cost of a step with dense matrices grows with the cube of the number of links, that of a "
        "sparse one with the number",
    )
    source = "Standard multiple pendulum"

    links: int = parameter(8, "-", "number of links", low=1)
    m: float = parameter(0.1, "kg", "mass at the end of each link", low=1e-12)
    length: float = parameter(0.1, "m", "length of a link", low=1e-12)
    g: float = parameter(9.81, "m/s^2", "gravity, along -y")
    th0: float = parameter(np.pi / 4, "rad", "initial angle from the downward vertical")
    w0: float = parameter(1.0, "rad/s", "initial angular velocity of the whole chain")

    @property
    def multipliers(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return tuple(f"link {k} [N/m]" for k in range(1, self.links + 1))

    def mass_product(self, q: jax.Array, a: jax.Array) -> jax.Array:
        return self.m * a

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return jnp.tile(jnp.stack([0.0 * self.m, -self.m * self.g]), self.links)

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        link = jnp.diff(q.reshape(-1, 2), axis=0, prepend=jnp.zeros((1, 2)))
        return 0.5 * ((link**2).sum(axis=1) - self.length**2)

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return 0.5 * self.m * (v @ v) + self.m * self.g * q[1::2].sum()

    def initial_state(self) -> State:
        reach = self.length * np.arange(1, self.links + 1)[:, None]
        direction = np.array([np.sin(self.th0), -np.cos(self.th0)])
        across = np.array([np.cos(self.th0), np.sin(self.th0)])
        return State(q=(reach * direction).ravel(), v=(self.w0 * reach * across).ravel())

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        return [np.concatenate([[[0.0, 0.0]], np.reshape(q, (-1, 2))])]


@dataclass(frozen=True)
class StiffBar(PointMasses):
    """A mass on a pinned, nearly rigid elastic bar that rotates without gravity.

    Tests stability in a nonlinear stiff system, whose axial vibration no useful step resolves;
    damped methods go on. One mass and the Green strain of one bar are the smallest system that
    shows it. Left out: gravity and the bar's own mass.

    The published start, the default, has the bar unstretched. The vibration that follows is as
    large as the whole acceleration and 1.4e-4 of the velocity: with steps that do not resolve it
    errors stall there, and no order of v and a is seen. ``stretch=1`` starts with the stretch of
    steady rotation (2e-8 of the length); nothing vibrates, and all orders are seen, but undamped
    methods keep their energy for long. Both are known in closed form.
    """

    interval = (0.0, 10.0)
    nominal_step = 0.02
    tags = ("stiff", "nonlinear", "conservative", "closed form")
    difficulties = (
        "an axial frequency of 18124 rad/s beside a period of 2.5 s",
        "the trapezoidal rule gains energy until Newton's method fails",
        "accelerations are not controlled by tolerances of q and v: they err by half or more until "
        "the vibration is resolved",
    )
    coordinates = ("x [m]", "y [m]")
    source = "Kuhl & Crisfield (1999), Int. J. Numer. Meth. Engng 45, 569-599"

    length: float = parameter(3.0443, "m", "length of the bar at rest", low=1e-9)
    ea: float = parameter(1e10, "N", "axial stiffness EA", low=1e-9)
    m: float = parameter(10.0005, "kg", "mass at the tip", low=1e-12)
    v0: float = parameter(7.72, "m/s", "initial speed of the tip", low=1e-9)
    stretch: float = parameter(
        0.0, "-", "initial stretch: 0 none, 1 that of steady rotation", low=0.0, high=1.0
    )

    def _strain(self, q: jax.Array) -> jax.Array:
        return 0.5 * (q @ q - self.length**2) / self.length**2

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return -self.ea / self.length * self._strain(q) * q

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return 0.5 * self.m * (v @ v) + 0.5 * self.ea * self.length * self._strain(q) ** 2

    def momentum(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return self.m * (q[0] * v[1] - q[1] * v[0])[None]

    def exact(self, t: np.ndarray) -> dict[str, np.ndarray]:
        """Motion under a central force, by elliptic functions of s = r^2/L^2 - 1.

        Energy and angular momentum give s'^2 = EA/(m L) (s - s0)(s1 - s)(s - s2), hence
        s = s0 + (s1 - s0)(1 - k^2) sd(x, k)^2 with k^2 = (s1 - s0)/(s1 - s2) and
        x = t/2 sqrt(EA (s1 - s2)/(m L)). The angle follows from r^2 p' = r0 v0 by an elliptic
        integral of the third kind in Carlson's form. Nothing is computed as a difference of r,
        whose rounding alone would be 1e-9 of the strain.
        """
        from scipy.special import ellipj, elliprj

        t, length, stiffness = np.asarray(t, dtype=float), self.length, self.ea / self.m
        pull = 2 * self.v0**2 / (stiffness * length)
        s0 = self.stretch * 2 * pull / (1 + np.sqrt(1 + 4 * pull))  # steady: s (1 + s) = pull
        root = np.sqrt((1 - s0) ** 2 + 8 * pull)
        s1, s2 = 2 * (2 * pull - s0) / (1 + s0 + root), -(1 + s0 + root) / 2
        k2 = max(s1 - s0, 0.0) / (s1 - s2)
        rate = 0.5 * np.sqrt(stiffness / length * (s1 - s2))
        sn, cn, dn, am = ellipj(rate * t, k2)
        size = k2 * (s1 - s2) * (1 - k2)
        s = s0 + size * (sn / dn) ** 2
        s_rate = 2 * size * sn * cn / dn**3 * rate

        # p = v0/r0 (t - size/(1 + s0) I/rate), I the integral of sn^2/(1 - n sn^2) up to x.
        r0, n = length * np.sqrt(1 + s0), k2 - size / (1 + s0)
        turns = np.round(am / np.pi)
        y = np.sin(am - turns * np.pi)
        part = y**3 / 3 * elliprj(1 - y**2, 1 - k2 * y**2, 1.0, 1 - n * y**2)
        whole = elliprj(0.0, 1 - k2, 1.0, 1 - n) / 3
        p = self.v0 / r0 * (t - size / (1 + s0) * (2 * turns * whole + part) / rate)

        r = (length * np.sqrt(1 + s))[:, None]
        e_r, e_t = np.column_stack([np.cos(p), np.sin(p)]), np.column_stack([-np.sin(p), np.cos(p)])
        radial = length**2 * s_rate[:, None] / (2 * r)
        return {
            "q": r * e_r,
            "v": radial * e_r + r0 * self.v0 / r * e_t,
            "a": -stiffness / (2 * length) * s[:, None] * r * e_r,
        }

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        return _hung(self.length, q)
