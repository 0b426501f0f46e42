"""The mathematical pendulum in Cartesian coordinates, index 3, with its closed-form solution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, State, jax, jnp, parameter
from problems.mechanics import drawing


@dataclass(frozen=True)
class Pendulum(MechatronicSystem):
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

    def mass(self, q: jax.Array) -> jax.Array:
        return self.m * jnp.eye(2)

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
        return [np.array([[0.0, 0.0], q]), drawing.circle(q, 0.06 * self.length)]
