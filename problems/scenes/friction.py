"""A mass on a spring with dry friction: a force that jumps where the velocity turns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, State, jax, jnp, parameter
from problems.mechanics import drawing


@dataclass(frozen=True)
class Friction(MechatronicSystem):
    """An oscillator that slides on a rough plane; friction changes its sign within ``eps``.

    Tests the order and step-size control under a force that jumps: friction is Coulomb's law
    with its sign smoothed to tanh(v/eps). Steps much shorter than eps/(acceleration) resolve the
    jump; for all others it is a discontinuity. The mass never comes to rest in the interval. Left
    out: sticking, which is another problem (complementarity), and a larger friction at rest.
    """

    interval = (0.0, 10.0)
    nominal_step = 0.05
    tags = ("smooth", "nearly discontinuous", "dissipative")
    difficulties = (
        "the force jumps at every turn: with equal steps longer than the jump the order is 1",
    )
    coordinates = ("position [m]",)
    source = "Coulomb friction with a smoothed sign; the amplitude falls by 2 mu/k at every turn"

    m: float = parameter(1.0, "kg", "mass", low=1e-12)
    k: float = parameter(1.0, "N/m", "stiffness of the spring", low=0.0)
    mu: float = parameter(1.0, "N", "friction force", low=0.0)
    eps: float = parameter(0.1, "m/s", "velocity over which friction changes sign", low=1e-12)
    q0: float = parameter(10.0, "m", "initial position")

    def mass(self, q: jax.Array) -> jax.Array:
        return self.m * jnp.eye(1)

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return -self.k * q - self.mu * jnp.tanh(v / self.eps)

    def initial_state(self) -> State:
        return State(q=np.array([self.q0]), v=np.zeros(1))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        x, wall, half = float(q[0]), -14.0, 0.8
        floor = np.array([[wall, half], [wall, -half], [14.0, -half]])
        return [floor, drawing.spring(wall, x - half, reach=0.5), drawing.box(x, half)]
