"""A02 of the IFToMM benchmark library: a row of four-bar linkages with singular positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from problems import MechatronicSystem, Published, jax, jnp, parameter


@dataclass(frozen=True)
class NFourBar(MechatronicSystem):
    """Uprights on pivots one length apart, joined by couplers: the benchmark A02 of the library.

    All uprights turn by one angle th, with B0 at length (sin th, cos th), and all couplers
    translate. Tests singular positions: when the uprights lie in line with the couplers, the
    constraints lose as many ranks as there are loops, reaction forces are indeterminate, and a
    method may go on in another branch. The coordinates are those of the uprights' tips.
    """

    name = "n_four_bar"
    interval = (0.0, 10.0)
    nominal_step = 0.01
    tags = ("constrained", "index 3", "closed form", "conservative", "singular", "benchmark")
    difficulties = (
        "at th = pi/2 + k pi the Jacobian of the constraints loses `loops` ranks: methods that "
        "solve with it may fail there, or take another branch",
        "through all positions of 10 s with 40 loops at h=0.005 s or rtol=1e-5 come rattle, "
        "energy_momentum, lobatto_iiia_iiib, bdf_adaptive, radau_iia, ida, hht_i3, "
        "generalized_alpha on index 3 and projected dopri8; phem56 and dopri8 take another branch "
        "without a word; ali3p, generalized_alpha_adaptive and the forms stabilised_index2 of "
        "generalized_alpha, bathe and bdf2 stop in Newton's method",
        "multipliers are indeterminate in these positions, and lose digits near them",
    )
    source = (
        "IFToMM benchmark library, A02; Gonzalez et al. (2006), doi:10.1007/s11044-006-9013-y; "
        "digits at t=10 s by EXUDYN at h=1.25e-4 s, from its published refinement"
    )
    published = (
        Published("B0", 1.0, (-0.1950203019494351, -0.9807992056621738), 1e-13),
        Published("v", 1.0, (-6.676678036881158, 1.327578325160487) * 3, 1e-12),
        Published("B0", 10.0, (0.3284573768, 0.9445187937), 1e-6),
    )

    m: float = parameter(1.0, "kg", "mass of each bar", low=1e-12)
    length: float = parameter(1.0, "m", "length of each bar", low=1e-12)
    g: float = parameter(9.81, "m/s^2", "gravity", low=1e-12)
    v0: float = parameter(1.0, "m/s", "velocity of the couplers in the upright position", low=1e-3)

    loops: int = parameter(2, "-", "number of four-bar loops", low=1, high=1000)

    @property
    def coordinates(self) -> Any:  # pyright: ignore[reportIncompatibleVariableOverride]
        return tuple(f"B{k} {axis} [m]" for k in range(self.loops + 1) for axis in "xy")

    @property
    def multipliers(self) -> Any:  # pyright: ignore[reportIncompatibleVariableOverride]
        uprights = tuple(f"upright {k} [N/m]" for k in range(self.loops + 1))
        return uprights + tuple(f"coupler {k} [N/m]" for k in range(1, self.loops + 1))

    def _bars(self, q: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Uprights and couplers as vectors in m."""
        tips = q.reshape(-1, 2)
        pivots = jnp.stack([self.length * jnp.arange(self.loops + 1), jnp.zeros(len(tips))], axis=1)
        return tips - pivots, jnp.diff(tips, axis=0)

    def mass(self, q: jax.Array) -> jax.Array:
        # A uniform bar between two points: a third of its mass at each, a sixth between them.
        n = self.loops + 1
        joined = np.full(n, 3.0)
        joined[[0, -1]] = 2.0
        row = np.diag(joined / 3) + (np.eye(n, k=1) + np.eye(n, k=-1)) / 6
        return self.m * jnp.asarray(np.kron(row, np.eye(2)))

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        bars = np.full(self.loops + 1, 1.5)
        bars[[0, -1]] = 1.0
        return -self.m * self.g * jnp.asarray(np.kron(bars, [0.0, 1.0]))

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        bars = jnp.concatenate(self._bars(q))
        return 0.5 * (jnp.sum(bars * bars, axis=1) - self.length**2)

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return 0.5 * v @ self.mass(q) @ v - self.force(q, v, jnp.zeros(())) @ q

    def points(self, q: jax.Array) -> dict[str, jax.Array]:
        return {"B0": q[:2]}

    def exact(self, t: np.ndarray) -> dict[str, np.ndarray]:
        """th = pi - 2 am(K - w t, k^2), from I th'' = G sin th with th = 0, th' = v0/length."""
        from scipy.special import ellipj, ellipk

        n, size = self.loops, self.length
        # Torque of the weights and inertia of all bars about the pivots, divided by m length^2.
        torque, inertia = (0.5 * (n + 1) + n) * self.g / size, (n + 1) / 3 + n
        bend, quarter = torque / inertia, (self.v0 / size) ** 2 / 4
        w, k2 = np.sqrt(quarter + bend), bend / (quarter + bend)
        _, _, dn, phase = ellipj(ellipk(k2) - w * np.asarray(t, dtype=float), k2)
        th = np.pi - 2 * phase
        rate, rate2 = 2 * w * dn, bend * np.sin(th)
        along, across = np.stack([np.sin(th), np.cos(th)]), np.stack([np.cos(th), -np.sin(th)])
        tip = size * along.T
        v = size * (rate * across).T
        a = size * (rate2 * across - rate**2 * along).T
        pivots = np.kron(size * np.arange(n + 1), [1.0, 0.0])
        q, v, a = pivots + np.tile(tip, n + 1), np.tile(v, n + 1), np.tile(a, n + 1)
        return {"q": q, "v": v, "a": a, "lam": self._multipliers(tip, a)}

    def _multipliers(self, tip: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Multipliers (k, nl) at the accelerations a, of least norm in singular positions.

        Elsewhere the force along y at each tip gives that of its upright, the one along x those of
        the couplers, from one tip to the next.
        """
        n, size = self.loops, self.length
        zero = jnp.zeros(2 * (n + 1))
        mass, force = map(np.asarray, (self.mass(zero), self.force(zero, zero, jnp.zeros(()))))
        load = (force - a @ mass).reshape(-1, n + 1, 2)
        singular = np.abs(tip[:, 1]) <= 1e-12 * size
        along = np.where(singular[:, None], [0.0, size], tip)
        uprights = load[..., 1] / along[:, 1:]
        couplers = -np.cumsum(load[..., 0] - along[:, :1] * uprights, axis=1)[:, :-1] / size
        found = np.hstack([uprights, couplers])
        for k in np.flatnonzero(singular):
            gradient = np.zeros((2 * n + 1, n + 1, 2))
            gradient[np.arange(n + 1), np.arange(n + 1)] = tip[k]
            gradient[np.arange(n + 1, 2 * n + 1), np.arange(1, n + 1)] = [size, 0.0]
            gradient[np.arange(n + 1, 2 * n + 1), np.arange(n)] = [-size, 0.0]
            rows = gradient.reshape(2 * n + 1, -1)
            found[k] = np.linalg.lstsq(rows.T, load[k].ravel(), rcond=1e-12)[0]
        return found

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        tips = q.reshape(-1, 2)
        pivots = np.column_stack([self.length * np.arange(len(tips)), np.zeros(len(tips))])
        return [tips, *np.stack([pivots, tips], axis=1)]
