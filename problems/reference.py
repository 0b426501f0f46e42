"""Reference solutions: a closed form where the scene has one, else a tight integration.

The integration is scipy's DOP853 (Hairer, Norsett & Wanner, explicit, order 8) on the ODE form at
a tolerance near round-off; no integrator of the bench uses it. Its error is estimated by a second
integration at a different tolerance and with half the largest step. Where a small component is not
known well enough, both are made again with tolerances relative to its size.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from problems import answers
from problems.compiled import compiled
from problems.initial_values import consistent_start
from problems.runtime import jnp
from problems.system import GROUPS, MechatronicSystem

if TYPE_CHECKING:
    from jaxtyping import Float
    from scipy.integrate import OdeSolution

_RTOL = 3e-14
#: The two integrations may differ by this, relative to the size of each component: some are small,
#: as the elongation of a rod, 1e-5 m, beside the angle of its crank, 15 rad. One that stays below
#: the second part of its group's size counts as that part.
_AGREEMENT, _SMALL_PART = 1e-9, 1e-6
#: A scene with more coordinates and multipliers has no reference: each of its many evaluations is
#: a dense solve.
_MOST_UNKNOWNS = 300


class ReferenceFailed(RuntimeError):
    """The reference could not be computed; the message says why."""


@dataclass(frozen=True)
class Reference:
    """Solution of a scene that is more accurate than any run compared with it.

    Parameters
    ----------
    scene
        The scene; the solution begins at ``scene.interval[0]``.
    t_end
        Last time in s.
    """

    scene: MechatronicSystem
    t_end: float

    @property
    def method(self) -> str:
        """Method of its computation, in words for a report."""
        if self.scene.has("exact"):
            return "closed form"
        return f"DOP853 (scipy), rtol {_RTOL:g}, on the explicit ODE"

    @property
    def missing(self) -> str:
        """Reason why the scene has no reference; empty if it has one."""
        sizes = self.scene.sizes
        if self.scene.has("exact") or sizes.nq + sizes.nl <= _MOST_UNKNOWNS:
            return ""
        return (
            f"No reference is made of {self.scene.spec}: it has {sizes.nq + sizes.nl} unknowns, "
            f"more than {_MOST_UNKNOWNS}."
        )

    def __call__(self, t: Float[np.ndarray, " k"]) -> dict[str, Float[np.ndarray, "k n"]]:
        """Compute the solution at times t in s.

        Returns
        -------
        dict
            q, v, a, lam, x, xdot and y, in the units of the scene.

        Raises
        ------
        ReferenceFailed
            If the scene is too large or the integration stops.
        FalseAnswer
            If the closed form lacks groups, or is not finite.
        """
        t = np.asarray(t, dtype=float)
        if self.scene.has("exact"):
            return self._closed_form(t)
        return self._evaluate(self._pair[0], t)

    @cached_property
    def error(self) -> dict[str, Float[np.ndarray, " n"]]:
        """Estimated absolute error of each component by group: the largest at `times`, in its unit.

        For a closed form it is the change under one unit of rounding of the time and of every
        value, for an integration the difference between the two integrations.
        """
        t, ours = self.times, self._values
        if self.scene.has("exact"):
            other = self._closed_form(np.nextafter(t, np.inf))
        else:
            other = self._evaluate(self._pair[1], t)
        eps = np.finfo(float).eps
        return {
            g: np.max(np.abs(ours[g] - other[g]) + eps * np.abs(ours[g]), axis=0) for g in GROUPS
        }

    @cached_property
    def times(self) -> Float[np.ndarray, " k"]:
        """Equally spaced times in s, 500 or more, and the ends of the integration's own steps."""
        t0 = self.scene.interval[0]
        count = np.clip(4 * (self.t_end - t0) / self.scene.nominal_step, 500, 4000)
        even = np.linspace(t0, self.t_end, int(count))
        return even if self.scene.has("exact") else np.union1d(even, self._pair[0].ts)

    @cached_property
    def _values(self) -> dict[str, Float[np.ndarray, "k n"]]:
        return self(self.times)

    @cached_property
    def largest(self) -> dict[str, tuple[Float[np.ndarray, " n"], float]]:
        """By group, the largest absolute value of each component, and the largest Euclidean norm.

        They are taken at `times`, in the units of the scene.
        """
        return {
            g: (np.abs(rows).max(axis=0), float(np.linalg.norm(rows, axis=1).max()))
            for g, rows in ((g, self._values[g]) for g in GROUPS)
        }

    def _closed_form(self, t: np.ndarray) -> dict[str, np.ndarray]:
        sizes = {g: self.scene.sizes.of(g) for g in (*GROUPS, "xdot")}
        values = {g: np.zeros((len(t), 0)) for g in ("x", "xdot", "y", "lam")}
        return values | answers.closed_form(self.scene.exact(t), len(t), sizes)

    def _evaluate(
        self, dense: Callable[[np.ndarray], np.ndarray], t: np.ndarray
    ) -> dict[str, np.ndarray]:
        s = dense(t).T
        nq = self.scene.sizes.nq
        q, v, x = s[:, :nq], s[:, nq : 2 * nq], s[:, 2 * nq :]
        z, xdot = compiled(self.scene).complete(self.scene.parameters(), q, v, x, t)
        values = {g: np.asarray(getattr(z, g)) for g in GROUPS}
        return values | {"xdot": np.asarray(xdot)}

    @cached_property
    def _pair(self) -> tuple[OdeSolution, OdeSolution]:
        """The integration, and the one that tells its error."""
        tight, check = self._integrate(_RTOL, 1.0), self._integrate(4 * _RTOL, 0.5)
        ours, nq = tight(tight.ts), self.scene.sizes.nq
        sizes, apart = (np.abs(rows).max(axis=1) for rows in (ours, ours - check(tight.ts)))
        for group in (slice(nq), slice(nq, 2 * nq), slice(2 * nq, None)):
            largest = sizes[group].max(initial=0.0) or 1.0
            sizes[group] = np.maximum(sizes[group], _SMALL_PART * largest)
        # Controllers may forget their errors, and need not be known as well as the motion.
        if np.all(apart[: 2 * nq] <= _AGREEMENT * sizes[: 2 * nq]):
            return tight, check
        return self._integrate(_RTOL, 1.0, sizes), self._integrate(4 * _RTOL, 0.5, sizes)

    def _integrate(
        self, rtol: float, cap: float, sizes: Float[np.ndarray, " n"] | None = None
    ) -> OdeSolution:
        from scipy.integrate import solve_ivp

        if self.missing:
            raise ReferenceFailed(self.missing)

        t0 = self.scene.interval[0]
        start = consistent_start(self.scene).z
        s0 = np.concatenate([start.q, start.v, start.x])
        rate, p = compiled(self.scene).rate, jnp.asarray(list(self.scene.parameters().values()))
        # Between steps the solution is of one order less than at them. Steps that are shorter than
        # the tolerance asks for make it as accurate.
        solution = solve_ivp(
            lambda t, s: np.asarray(rate(p, t, s)),
            (t0, self.t_end),
            s0,
            method="DOP853",
            rtol=rtol,
            atol=rtol * (max(1.0, np.abs(s0).max()) if sizes is None else sizes),
            max_step=cap * self.scene.nominal_step,
            dense_output=True,
        )
        if not solution.success:
            raise ReferenceFailed(f"No reference for {self.scene.spec}: {solution.message}")
        return solution.sol
