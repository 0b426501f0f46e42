"""Two masses on two rods: free, in Cartesian coordinates, or with a motor, by an angle, too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, State, Variables, jax, jnp, parameter
from problems.mechanics import drawing


@dataclass(frozen=True)
class TwoRods(MechatronicSystem):
    """Data that both scenes share."""

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

    def _picture(self, first: np.ndarray, second: np.ndarray) -> list[np.ndarray]:
        """Lines of both rods and masses, from their places in m."""
        bobs = [drawing.circle(at, 0.06 * self.l1) for at in (first, second)]
        return [np.array([[0.0, 0.0], first, second]), *bobs]


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
        return self._picture(q[:2], q[2:])


@dataclass(frozen=True)
class DoublePendulumControlled(TwoRods):
    """The double pendulum with an acceleration sensor and a motor that lags behind its demand.

    All groups of variables at once, and a mass matrix that depends on q, as the second rod is
    given by its angle from the downward vertical: a scene that hides no loss of order. The
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
        return self._picture(q[:2], q[:2] + self.l2 * np.array([np.sin(q[2]), -np.cos(q[2])]))
