"""A hanging chain of any number of links in Cartesian coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, State, jax, jnp, parameter


@dataclass(frozen=True)
class Chain(MechatronicSystem):
    """Point masses on massless links, one after the other from a fixed pivot: 2N coordinates, N
    constraints, index 3.

    Tests how the cost of a step grows with the size of a system whose equations each know their
    neighbours only. One link is the pendulum, two are the double pendulum. The chain starts
    straight and turns as a whole, so that velocity and jerk are not zero. Left out: inertia of
    the links, which would add coordinates and constraints and no new coupling. The motion of a
    chain is chaotic: the interval is short, so that errors show the method and not the chaos.

    The blocks are array operations without loops over links, so that the time to compile does not
    grow with them.
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

    def mass(self, q: jax.Array) -> jax.Array:
        return self.m * jnp.eye(2 * self.links)

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
