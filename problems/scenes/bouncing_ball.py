"""A ball that bounces on the ground, the smallest motion with impacts, and its exact motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import ContactSystem, Published, State, jax, jnp, parameter
from problems.mechanics import drawing


@dataclass(frozen=True)
class BouncingBall(ContactSystem):
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

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.eye(1)

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
