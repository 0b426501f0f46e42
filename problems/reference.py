"""Reference solutions: a closed form where the scene has one, else a tight integration.

The integration is scipy's DOP853 (Hairer, Norsett & Wanner, explicit, order 8) on the ODE form at
a tolerance near round-off; no contestant of the bench uses it. Its error is estimated by a
second integration at a different tolerance and with half the largest step.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from problems.compiled import compiled
from problems.initial_values import consistent_start
from problems.runtime import jnp
from problems.system import GROUPS, MechatronicSystem

_RTOL = 3e-14
#: Coordinates and multipliers beyond which no reference is made: each of its many evaluations is a
#: dense solve.
_MOST_UNKNOWNS = 300


class ReferenceFailed(RuntimeError):
    """No reference could be made; the message says why."""


@dataclass(frozen=True)
class Reference:
    """Solution of a scene up to t_end that is more accurate than any run compared with it."""

    scene: MechatronicSystem
    t_end: float

    @property
    def method(self) -> str:
        """How it is made, for the reader of a report."""
        if self.scene.has("exact"):
            return "closed form"
        return f"DOP853 (scipy), rtol {_RTOL:g}, on the explicit ODE"

    @property
    def missing(self) -> str:
        """Why there is none; empty if there is one."""
        sizes = self.scene.sizes
        if self.scene.has("exact") or sizes.nq + sizes.nl <= _MOST_UNKNOWNS:
            return ""
        return (
            f"No reference is made of {self.scene.spec}: it has {sizes.nq + sizes.nl} unknowns, "
            f"more than {_MOST_UNKNOWNS}."
        )

    def __call__(self, t: np.ndarray) -> dict[str, np.ndarray]:
        """Return q, v, a, lam, x, xdot, y at times t, each of shape ``(len(t), n)``."""
        t = np.asarray(t, dtype=float)
        if self.scene.has("exact"):
            return self._closed_form(t)
        return self._evaluate(self._tight, t)

    @cached_property
    def error(self) -> dict[str, float]:
        """Estimated absolute error per group: the largest over 500 times.

        For a closed form it is the change under one unit of rounding of the time and of every
        value; for an integration the difference between the two integrations.
        """
        t = np.linspace(self.scene.interval[0], self.t_end, 500)
        ours = self(t)
        if self.scene.has("exact"):
            other = self._closed_form(np.nextafter(t, np.inf))
        else:
            other = self._evaluate(self._check, t)
        eps = np.finfo(float).eps
        return {
            g: float(np.max(np.abs(ours[g] - other[g]) + eps * np.abs(ours[g]), initial=0.0))
            for g in GROUPS
        }

    def _closed_form(self, t: np.ndarray) -> dict[str, np.ndarray]:
        values = {g: np.zeros((len(t), 0)) for g in ("x", "xdot", "y", "lam")}
        return values | {k: np.asarray(v) for k, v in self.scene.exact(t).items()}

    def _evaluate(self, dense: Any, t: np.ndarray) -> dict[str, np.ndarray]:
        s = dense(t).T
        nq = self.scene.sizes.nq
        q, v, x = s[:, :nq], s[:, nq : 2 * nq], s[:, 2 * nq :]
        z, xdot = compiled(self.scene).complete(self.scene.parameters(), q, v, x, t)
        values = {g: np.asarray(getattr(z, g)) for g in GROUPS}
        return values | {"xdot": np.asarray(xdot)}

    @cached_property
    def _tight(self) -> Any:
        return self._integrate(_RTOL, 1.0)

    @cached_property
    def _check(self) -> Any:
        return self._integrate(4 * _RTOL, 0.5)

    def _integrate(self, rtol: float, cap: float) -> Any:
        from scipy.integrate import solve_ivp

        if self.missing:
            raise ReferenceFailed(self.missing)

        t0 = self.scene.interval[0]
        start = consistent_start(self.scene).z
        s0 = np.concatenate([start.q, start.v, start.x])
        rate, p = compiled(self.scene).rate, jnp.asarray(list(self.scene.parameters().values()))
        # The continuous output is one order below the steps; steps well below the free choice
        # at this tolerance keep it at their accuracy.
        solution = solve_ivp(
            lambda t, s: np.asarray(rate(p, t, s)),
            (t0, self.t_end),
            s0,
            method="DOP853",
            rtol=rtol,
            atol=rtol * max(1.0, np.abs(s0).max()),
            max_step=cap * self.scene.nominal_step,
            dense_output=True,
        )
        if not solution.success:
            raise ReferenceFailed(f"No reference for {self.scene.spec}: {solution.message}")
        return solution.sol
