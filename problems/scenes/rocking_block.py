"""A slender block that rocks about its corners: impacts that change the side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, State, Variables, held, jax, jnp, parameter


@dataclass(frozen=True)
class RockingBlock(MechatronicSystem):
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

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.eye(1)

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
        box = np.array([[-wide, 0], [wide, 0], [wide, high], [-wide, high], [-wide, 0]])
        cos, sin = np.cos(angle), np.sin(angle)
        ground = np.array([[-0.6, 0.0], [0.6, 0.0]])
        return [ground, (box - corner) @ np.array([[cos, -sin], [sin, cos]]) + corner]
