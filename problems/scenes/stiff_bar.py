"""The stiff rotating bar of Kuhl & Crisfield: unconditional stability is linear only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, jax, jnp, parameter
from problems.mechanics import drawing


@dataclass(frozen=True)
class StiffBar(MechatronicSystem):
    """A mass on a pinned, nearly rigid elastic bar that rotates without gravity.

    Tests stability in a nonlinear stiff system: slow rotation (2.4777 s a turn) beside an axial
    vibration at 18124 rad/s that no useful step resolves. Methods without numerical damping, the
    trapezoidal rule first of all, gain energy until Newton's method fails; damped ones go on.
    One mass and the Green strain of one bar are the smallest system that shows it. Left out:
    gravity and the bar's own mass.

    The published start, the default, has the bar unstretched. The vibration that follows is as
    large as the whole acceleration and 1.4e-4 of the velocity: with steps that do not resolve it
    errors stall there, and no order of v and a is seen. ``stretch=1`` starts with the stretch of
    steady rotation (2e-8 of the length); nothing vibrates, and all orders are seen, but undamped
    methods keep their energy for long. Both are known in closed form.
    """

    interval = (0.0, 10.0)
    nominal_step = 0.02
    tags = ("stiff", "nonlinear", "conservative", "closed form")
    difficulties = (
        "an axial frequency of 18124 rad/s beside a period of 2.5 s",
        "the trapezoidal rule gains energy until Newton's method fails",
        "accelerations are not controlled by tolerances of q and v: they err by half or more until "
        "the vibration is resolved",
    )
    coordinates = ("x [m]", "y [m]")
    source = "Kuhl & Crisfield (1999), Int. J. Numer. Meth. Engng 45, 569-599"

    length: float = parameter(3.0443, "m", "length of the bar at rest", low=1e-9)
    ea: float = parameter(1e10, "N", "axial stiffness EA", low=1e-9)
    m: float = parameter(10.0005, "kg", "mass at the tip", low=1e-12)
    v0: float = parameter(7.72, "m/s", "initial speed of the tip", low=1e-9)
    stretch: float = parameter(
        0.0, "-", "initial stretch: 0 none, 1 that of steady rotation", low=0.0, high=1.0
    )

    def _strain(self, q: jax.Array) -> jax.Array:
        return 0.5 * (q @ q - self.length**2) / self.length**2

    def mass(self, q: jax.Array) -> jax.Array:
        return self.m * jnp.eye(2)

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return -self.ea / self.length * self._strain(q) * q

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return 0.5 * self.m * (v @ v) + 0.5 * self.ea * self.length * self._strain(q) ** 2

    def momentum(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return self.m * (q[0] * v[1] - q[1] * v[0])[None]

    def exact(self, t: np.ndarray) -> dict[str, np.ndarray]:
        """Motion under a central force, by elliptic functions of s = r^2/L^2 - 1.

        Energy and angular momentum give s'^2 = EA/(m L) (s - s0)(s1 - s)(s - s2), hence
        s = s0 + (s1 - s0)(1 - k^2) sd(x, k)^2 with k^2 = (s1 - s0)/(s1 - s2) and
        x = t/2 sqrt(EA (s1 - s2)/(m L)). The angle follows from r^2 p' = r0 v0 by an elliptic
        integral of the third kind in Carlson's form. Nothing is computed as a difference of r,
        whose rounding alone would be 1e-9 of the strain.
        """
        from scipy.special import ellipj, elliprj

        t, length, stiffness = np.asarray(t, dtype=float), self.length, self.ea / self.m
        pull = 2 * self.v0**2 / (stiffness * length)
        s0 = self.stretch * 2 * pull / (1 + np.sqrt(1 + 4 * pull))  # steady: s (1 + s) = pull
        root = np.sqrt((1 - s0) ** 2 + 8 * pull)
        s1, s2 = 2 * (2 * pull - s0) / (1 + s0 + root), -(1 + s0 + root) / 2
        k2 = max(s1 - s0, 0.0) / (s1 - s2)
        rate = 0.5 * np.sqrt(stiffness / length * (s1 - s2))
        sn, cn, dn, am = ellipj(rate * t, k2)
        size = k2 * (s1 - s2) * (1 - k2)
        s = s0 + size * (sn / dn) ** 2
        s_rate = 2 * size * sn * cn / dn**3 * rate

        # p = v0/r0 (t - size/(1 + s0) I/rate), I the integral of sn^2/(1 - n sn^2) up to x.
        r0, n = length * np.sqrt(1 + s0), k2 - size / (1 + s0)
        turns = np.round(am / np.pi)
        y = np.sin(am - turns * np.pi)
        part = y**3 / 3 * elliprj(1 - y**2, 1 - k2 * y**2, 1.0, 1 - n * y**2)
        whole = elliprj(0.0, 1 - k2, 1.0, 1 - n) / 3
        p = self.v0 / r0 * (t - size / (1 + s0) * (2 * turns * whole + part) / rate)

        r = (length * np.sqrt(1 + s))[:, None]
        e_r, e_t = np.column_stack([np.cos(p), np.sin(p)]), np.column_stack([-np.sin(p), np.cos(p)])
        radial = length**2 * s_rate[:, None] / (2 * r)
        return {
            "q": r * e_r,
            "v": radial * e_r + r0 * self.v0 / r * e_t,
            "a": -stiffness / (2 * length) * s[:, None] * r * e_r,
        }

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        return [np.array([[0.0, 0.0], q]), drawing.circle(q, 0.06 * self.length)]
