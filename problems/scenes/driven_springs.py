"""Two masses and two springs, one of them nearly rigid, driven at the end: Bathe & Noh (2012)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, State, jax, jnp, parameter
from problems.mechanics import drawing


@dataclass(frozen=True)
class DrivenSprings(MechatronicSystem):
    """A point that is moved as sin(omega t) pulls a mass by a nearly rigid spring, and this mass a
    second one by a soft spring.

    Tests methods on a frequency that their steps cannot resolve: the stiff spring stands for a
    rigid connection, and is hit at the start, when the point moves and the mass is at rest. In
    the exact solution the vibration dies out within milliseconds, because of a weak damper that
    the published model does not have. An undamped method keeps it for ever: its accelerations
    are off by many times their size while its positions look right. Left out: the massless
    driven point, whose motion is given.
    """

    interval = (0.0, 10.0)
    nominal_step = 0.25
    tags = ("linear", "stiff", "closed form", "driven")
    difficulties = (
        "a frequency of 3162 rad/s beside a motion of 1.2 rad/s",
        "the start excites the stiff spring: undamped methods keep a spurious acceleration",
    )
    # The start makes an acceleration of thousands of m/s^2 for milliseconds; errors are relative to
    # the motion of the driven point instead.
    coordinates = ("first mass [m] ~ 1, 1.2, 1.44", "second mass [m]")
    source = (
        "Bathe & Noh (2012), Insight into an implicit time integration scheme for structural "
        "dynamics, doi:10.1016/j.compstruc.2012.01.009, with a weak damper added"
    )

    m1: float = parameter(1.0, "kg", "mass at the stiff spring", low=1e-12)
    m2: float = parameter(1.0, "kg", "mass at the soft spring", low=1e-12)
    k1: float = parameter(1e7, "N/m", "stiff spring", low=0.0)
    k2: float = parameter(1.0, "N/m", "soft spring", low=0.0)
    c1: float = parameter(300.0, "N s/m", "damper beside the stiff spring", low=0.0)
    omega: float = parameter(1.2, "rad/s", "frequency of the driven point", low=1e-9)

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.diag(jnp.stack([self.m1, self.m2]))

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        u, u_dot = jnp.sin(self.omega * t), self.omega * jnp.cos(self.omega * t)
        stiff = self.k1 * (u - q[0]) + self.c1 * (u_dot - v[0])
        soft = self.k2 * (q[0] - q[1])
        return jnp.stack([stiff - soft, soft])

    def initial_state(self) -> State:
        return State(q=np.zeros(2), v=np.zeros(2))

    def exact(self, t: np.ndarray) -> dict[str, np.ndarray]:
        """s = Re(p exp(i omega t)) + sum of c_k w_k exp(r_k t), with the eigenpairs (r, w) of the
        first-order form s' = A s + Re(b exp(i omega t)), s = [q, v]."""
        t = np.asarray(t, dtype=float)
        stiffness = np.array([[self.k1 + self.k2, -self.k2], [-self.k2, self.k2]])
        masses = np.array([[self.m1], [self.m2]])
        a = np.zeros((4, 4))
        a[:2, 2:] = np.eye(2)
        a[2:, :2], a[2, 2] = -stiffness / masses, -self.c1 / self.m1
        # sin = Re(-i exp), cos = Re(exp)
        b = np.array([0, 0, (-1j * self.k1 + self.c1 * self.omega) / self.m1, 0])
        p = np.linalg.solve(1j * self.omega * np.eye(4) - a, b)
        roots, vectors = np.linalg.eig(a)
        weights = vectors * np.linalg.solve(vectors, -p.real.astype(complex))
        homogeneous, driven = np.exp(np.outer(t, roots)), np.exp(1j * self.omega * t)[:, None]
        s = (driven * p).real + (homogeneous @ weights.T).real
        rate = (driven * (1j * self.omega * p)).real + (homogeneous @ (weights * roots).T).real
        return {"q": s[:, :2], "v": s[:, 2:], "a": rate[:, 2:]}

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        half, first, second = 0.3, float(q[0]) + 1.5, float(q[1]) + 4.0
        return [
            np.array([[first - 1.5, 0.0], [first - half, 0.0]]),
            drawing.box(first, half),
            drawing.spring(first + half, second - half, reach=0.2, points=14),
            drawing.box(second, half),
        ]
