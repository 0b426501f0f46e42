"""A mass that flies against a soft wall: long free flight, short impact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, jax, jnp, parameter


@dataclass(frozen=True)
class SoftImpact(MechatronicSystem):
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

    def mass(self, q: jax.Array) -> jax.Array:
        return self.m * jnp.eye(1)

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
        reach = 0.02
        box = np.array([[0, -1], [2, -1], [2, 1], [0, 1], [0, -1]]) * reach
        wall = np.array([[0.0, -4 * reach], [0.0, 4 * reach]])
        return [wall, box + np.array([q[0], 0.0])]
