"""The undamped linear oscillator: the test equation of structural dynamics as a scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, State, jax, jnp, parameter
from problems.mechanics import drawing


@dataclass(frozen=True)
class Oscillator(MechatronicSystem):
    """One mass on one spring.

    Tests amplitude and phase over many periods, in which a method's damping and phase error add
    up, and the stability limit in omega h. Left out: damping, which would hide the method's own.
    """

    interval = (0.0, 20.0)
    nominal_step = 0.1
    tags = ("linear", "smooth", "closed form", "conservative")
    difficulties = ("errors of amplitude and phase add up over many periods",)
    coordinates = ("position [m]",)
    source = "q = q0 cos(omega t); e.g. Hughes (1987), The Finite Element Method, ch. 9"

    omega: float = parameter(1.0, "rad/s", "frequency", low=1e-12)
    q0: float = parameter(1.0, "m", "initial position")

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.eye(1)

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return -(self.omega**2) * q

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return 0.5 * (v @ v + self.omega**2 * (q @ q))

    def initial_state(self) -> State:
        return State(q=np.array([self.q0]), v=np.zeros(1))

    def exact(self, t: np.ndarray) -> dict[str, np.ndarray]:
        phase = self.omega * np.asarray(t, dtype=float)[:, None]
        q = self.q0 * np.cos(phase)
        return {"q": q, "v": -self.q0 * self.omega * np.sin(phase), "a": -(self.omega**2) * q}

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        x, wall, half = float(q[0]), -3.0, 0.25
        spring = drawing.spring(wall, x - half, reach=0.15)
        return [np.array([[wall, -0.5], [wall, 0.5]]), spring, drawing.box(x, half)]
