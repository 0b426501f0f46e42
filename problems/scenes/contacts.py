"""Impacts and lasting contact: bodies that bounce, strike, rock, slide and roll."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import (
    ContactSystem,
    MechatronicSystem,
    Published,
    State,
    Variables,
    held,
    jax,
    jnp,
    parameter,
)
from problems.mechanics import drawing
from problems.mechanics.points import PointMasses


@dataclass(frozen=True)
class BouncingBall(ContactSystem, PointMasses):
    """A point mass above the ground, which it leaves with a part of the velocity of its impact.

    Tests how methods locate events: between impacts every method of second order is exact, so that
    all errors come from the times of impact. The impacts accumulate at t = 4.0637 s (Zeno): no
    method that goes from event to event comes beyond that time. Left out: friction, rotation, and
    the state of rest.
    """

    interval = (0.0, 2.0)
    nominal_step = 0.05
    tags = ("events", "impact")
    difficulties = ("the velocity jumps at times that the motion decides",)
    coordinates = ("height [m]",)
    source = "closed form; digits of t = 2 s by it"
    published = (
        Published("q", 2.0, (0.260741728327057197,), 1e-14),
        Published("v", 2.0, (-0.165869135836471402,), 1e-13),
    )

    height: float = parameter(1.0, "m", "height at the start", low=1e-9)
    g: float = parameter(9.81, "m/s^2", "gravity", low=1e-9)
    e: float = parameter(0.8, "1", "part of the velocity that is left", low=0.0, high=1.0)

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return -self.g * jnp.ones(1)

    @property
    def restitution(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.e

    def gaps(self, q: jax.Array, t: jax.Array) -> jax.Array:
        return q

    def initial_state(self) -> State:
        return State(q=np.array([self.height]), v=np.zeros(1))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        ground = np.array([[-0.5, -0.1], [0.5, -0.1]])
        return [ground, drawing.circle(np.array([0.0, float(q[0])]), 0.1)]


@dataclass(frozen=True)
class ImpactStop(ContactSystem, PointMasses):
    """A mass on a spring, driven by a harmonic force, strikes a rigid stop with restitution.

    Between impacts the motion is the closed form of a linear oscillator, so that times of impact
    are roots of known functions: they test how contact is located or passed, at velocities that
    differ from impact to impact. Left out: damping, friction, and impacts that accumulate.
    """

    interval = (0.0, 4.0)
    nominal_step = 0.02
    tags = ("events", "impact")
    difficulties = (
        "the velocity jumps at times that the motion decides",
        "an error in the time of an impact is an error in the phase of the force behind it",
    )
    coordinates = ("distance from the stop [m]",)
    source = "linear oscillator in closed form, with Newton's law of impact"

    m: float = parameter(1.0, "kg", "mass", low=1e-9)
    k: float = parameter(40.0, "N/m", "stiffness of the spring", low=1e-9)
    rest: float = parameter(0.05, "m", "distance at which the spring is not stretched")
    amplitude: float = parameter(6.0, "N", "amplitude of the force")
    omega: float = parameter(8.0, "rad/s", "frequency of the force", low=0.0)
    restitution: float = parameter(
        0.7, "1", "part of the velocity that an impact leaves", low=0.0, high=1.0
    )

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return self.k * (self.rest - q) + self.amplitude * jnp.cos(self.omega * t)

    def gaps(self, q: jax.Array, t: jax.Array) -> jax.Array:
        return q

    def initial_state(self) -> State:
        return State(q=np.array([0.1]), v=np.zeros(1))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        at, half = float(q[0]), 0.04
        stop = np.array([[0.0, -2 * half], [0.0, 2 * half]])
        wall = np.array([[0.8, -2 * half], [0.8, 2 * half]])
        spring = drawing.spring(at + 2 * half, 0.8, half / 2)
        return [stop, wall, drawing.box(at + half, half), spring]


@dataclass(frozen=True)
class SoftImpact(PointMasses):
    """A mass in free flight is thrown back by a wall whose force grows as exp(-q/d).

    Tests how steps follow a short event: nothing happens for most of the interval, then the
    velocity is reversed within about d/v0, here a few thousandths of it. Left out: losses in the
    contact, a second dimension, and the corner of a real contact law, so that the solution is
    smooth and known in closed form: v = v0 tanh(v0 (t - t_c)/(2 d)).
    """

    interval = (0.0, 1.0)
    nominal_step = 2e-3
    tags = ("smooth", "fast and slow phases", "conservative")
    difficulties = (
        "equal steps have to be as short as the impact everywhere",
        "an error in the time of the impact is an error of the size of v",
    )
    coordinates = ("distance from the wall [m]",)
    source = "one-dimensional motion in an exponential (Toda) potential; textbook closed form"

    m: float = parameter(1.0, "kg", "mass", low=1e-12)
    v0: float = parameter(1.0, "m/s", "speed of the free flight", low=1e-12)
    d: float = parameter(1e-3, "m", "distance over which the force grows by e", low=1e-12)
    t_c: float = parameter(0.4, "s", "time of the turn")

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        # The deepest point is q = 0: there the wall has taken all of the kinetic energy.
        return self.m * self.v0**2 / (2 * self.d) * jnp.exp(-q / self.d)

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return 0.5 * self.m * (v @ v + self.v0**2 * jnp.exp(-q[0] / self.d))

    def exact(self, t: np.ndarray) -> dict[str, np.ndarray]:
        """q = 2 d ln cosh s with s = v0 (t - t_c)/(2 d)."""
        s = self.v0 * (np.asarray(t, dtype=float) - self.t_c) / (2 * self.d)
        far = np.abs(s)
        decay = np.exp(-2 * far)
        q = 2 * self.d * (far + np.log1p(decay) - np.log(2))  # ln cosh s without overflow
        sech_squared = 4 * decay / (1 + decay) ** 2
        a = self.v0**2 / (2 * self.d) * sech_squared
        return {"q": q[:, None], "v": self.v0 * np.tanh(s)[:, None], "a": a[:, None]}

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        half = 0.02
        wall = np.array([[0.0, -4 * half], [0.0, 4 * half]])
        return [wall, drawing.box(q[0] + half, half)]


@dataclass(frozen=True)
class RockingBlock(PointMasses):
    """A slender block on rigid ground, free to rock from one corner to the other (Housner 1963).

    Between impacts theta'' = p^2 (theta - alpha s), with the side s = 1 or -1 that the block leans
    to; at each impact its rate is reduced by a factor and the side changes. Tests events that
    switch an equation: the side is a held value. The impacts accumulate. Left out: sliding,
    bouncing, and the sine and cosine of large angles.
    """

    interval = (0.0, 3.0)
    nominal_step = 0.05
    tags = ("events", "impact")
    difficulties = ("the equations change at times that the motion decides",)
    coordinates = ("angle [rad]",)
    source = "Housner (1963), slender block; first impact in closed form"

    p: float = parameter(2.0, "1/s", "rate of falling over", low=1e-9)
    alpha: float = parameter(0.2, "rad", "angle at which the block would fall", low=1e-9)
    r: float = parameter(0.9, "1", "part of the rate that an impact leaves", low=0.0, high=1.0)
    lean: float = parameter(0.7, "1", "first angle, in parts of alpha", low=1e-6, high=1.0)
    side: float = held(1.0, "1", "side to which the block leans: 1 or -1")

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return self.p**2 * (q - self.alpha * self.side)

    def events(self, z: Variables) -> jax.Array:
        return self.side * z.q

    def jump(self, z: Variables, event: int) -> dict[str, jax.Array | float]:
        return {"v": self.r * z.v, "side": -self.side}

    def initial_state(self) -> State:
        return State(q=np.array([self.lean * self.alpha]), v=np.zeros(1))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        angle, wide, high = float(q[0]), 0.2, 1.0
        corner = np.array([-wide if angle < 0 else wide, 0.0])
        box = drawing.rectangle(-wide, wide, 0.0, high)
        ground = np.array([[-0.6, 0.0], [0.6, 0.0]])
        return [ground, drawing.placed(box - corner, -angle, corner)]


@dataclass(frozen=True)
class SlidingRolling(MechatronicSystem):
    """A ball is set on the ground with a speed and no spin: it slides, then rolls.

    It rolls from t = k v0/((1 + k) mu g) on at the speed v0/(1 + k), with the moment of inertia
    k m r^2: 2 v0/(7 mu g) and 5 v0/7 for a sphere, v0/(3 mu g) and 2 v0/3 for a disc (k = 1/2).
    Tests an event without an impact, at which a force jumps, and contact that lasts: the ground's
    forces set in at the start by an event of the scene, and are in ``force`` where a held value
    says so. Time stepping methods (`moreau_jean`) find them by ``gaps`` and ``sliding``. Left out:
    rolling friction, and friction that depends on the speed.
    """

    interval = (0.0, 1.0)
    nominal_step = 0.05
    tags = ("events", "friction")
    difficulties = ("friction vanishes at a time that the motion decides",)
    coordinates = ("way [m]", "height [m]", "angle [rad]")
    source = "closed form, as in textbooks of mechanics"
    published = (
        Published("v", 1.0, (10 / 7, 0.0, 10 / 7 / 0.1), 1e-12),
        Published("q", 1.0, (1.51178514219143315, 0.1, 12.2053714452141713), 1e-12),
    )

    m: float = parameter(1.0, "kg", "mass", low=1e-9)
    r: float = parameter(0.1, "m", "radius", low=1e-9)
    k: float = parameter(0.4, "1", "moment of inertia by m r^2", low=1e-9)
    friction: float = parameter(0.2, "1", "Coulomb's coefficient", low=0.0)
    g: float = parameter(9.81, "m/s^2", "gravity", low=1e-9)
    v0: float = parameter(2.0, "m/s", "speed at the start", low=1e-9)
    contact: float = held(0.0, "1", "0: free, 1: sliding, 2: rolling")

    def mass(self, q: jax.Array) -> jax.Array:
        return self.m * jnp.diag(jnp.stack([1.0, 1.0, self.k * self.r**2]))

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        weight = self.m * self.g
        touches, slides = self.contact > 0, self.contact == 1
        rub = jnp.where(slides, self.friction * weight, 0.0)
        return jnp.stack([-rub, jnp.where(touches, 0.0, -weight), rub * self.r])

    def gaps(self, q: jax.Array, t: jax.Array) -> jax.Array:
        return q[1:2] - self.r

    def sliding(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return v[:1] - self.r * v[2:]

    def events(self, z: Variables) -> jax.Array:
        falls = jnp.where(self.contact == 0, self.gaps(z.q, z.t)[0], 1.0)
        slides = jnp.where(self.contact == 1, self.sliding(z.q, z.v, z.t)[0], 1.0)
        return jnp.stack([falls, slides])

    def jump(self, z: Variables, event: int) -> dict[str, float]:
        return {"contact": 1.0 + event}

    def initial_state(self) -> State:
        return State(q=np.array([0.0, self.r, 0.0]), v=np.array([self.v0, 0.0, 0.0]))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        x, y, angle = q
        rim = self.r * np.array([np.sin(angle), np.cos(angle)])
        ground = np.array([[-0.2, 0.0], [1.8, 0.0]])
        centre = np.array([x, y])
        return [ground, drawing.circle(centre, self.r), np.array([centre, centre + rim])]


@dataclass(frozen=True)
class PainleveRod(MechatronicSystem):
    """A rod slides on its tip with Coulomb friction, which tips it towards Painleve's paradox.

    The normal force is (m g - m s sin(phi) w^2)/(1 + 3 cos(phi) (cos(phi) - mu sin(phi))); the
    divisor, 1.00 at the start and 0.14 at the end, vanishes at tan(phi) = 1: no force keeps the
    contact then, and rigid bodies have no unique motion. Tests how long a method follows. Left out:
    the motion behind that point, and a tip that comes to rest or lifts off; the default does not.
    """

    interval = (0.0, 0.8)
    nominal_step = 0.02
    tags = ("constrained", "index 3", "friction", "dissipative")
    difficulties = (
        "a force depends on lam: methods that know lam only after the step cannot take it",
        "the matrix for a and lam is nearly singular at the end, and lam grows",
    )
    coordinates = ("x [m]", "y [m]", "angle [rad]")
    multipliers = ("minus the normal force [N]",)
    source = "Painleve (1895); data of Glocker (1995), section 5.3.4"

    m: float = parameter(1.0, "kg", "mass", low=1e-9)
    s: float = parameter(1.0, "m", "half of the length", low=1e-9)
    mu: float = parameter(5 / 3, "1", "coefficient of friction", low=0.0)
    g: float = parameter(10.0, "m/s^2", "gravity", low=0.0)
    phi0: float = parameter(np.radians(31.0), "rad", "angle at the start, from the ground")
    speed: float = parameter(30.0, "m/s", "speed at the start")

    def mass(self, q: jax.Array) -> jax.Array:
        return self.m * jnp.diag(jnp.stack([1.0, 1.0, self.s**2 / 3]))

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return jnp.stack([0.0, -self.m * self.g, 0.0])

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        return (q[1] - self.s * jnp.sin(q[2]))[None]

    def coupled_force(self, z: Variables) -> jax.Array:
        rub = -self.mu * z.lam[0]
        return rub * jnp.stack([-1.0, 0.0, self.s * jnp.sin(z.q[2])])

    def initial_state(self) -> State:
        q = np.array([0.0, self.s * np.sin(self.phi0), self.phi0])
        return State(q=q, v=np.array([self.speed, 0.0, 0.0]))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        half = self.s * np.array([np.cos(q[2]), -np.sin(q[2])])
        centre = np.array([0.0, q[1]])  # it would leave the picture
        ground = np.array([[-1.5, 0.0], [1.5, 0.0]]) * self.s
        return [ground, np.array([centre - half, centre + half])]
