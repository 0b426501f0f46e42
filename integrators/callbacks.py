"""What solvers share that call the equations back in Python: counting, budget, ways to end."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from integrators.contract import Work

NOT_FINITE = "the equations gave a value that is not finite"


class Stop(Exception):
    """Ends a run from inside a callback."""

    def __init__(self, status: str, reason: str) -> None:
        super().__init__(reason)
        self.status, self.reason = status, reason


def cure(status: str) -> str:
    """What to try after an ending that has nothing to do with the formulation."""
    if status == "budget_exceeded":
        return "raise max_calls or use a larger rtol"
    if status == "diverged":
        return "check the scene's equations beyond this time or use a smaller rtol"
    return "use a larger rtol, or a smaller one if the solution changes abruptly here"


class Calls:
    """The equations as a stepping solver calls them, counted; one object for each run.

    Iterations and attempts are told by the times of the calls. The first call of every Newton
    iteration is at the earliest time of its attempt, and an attempt that is repeated with a
    smaller step begins earlier than those before it.

    Parameters
    ----------
    value, jacobian
        Compiled functions of (p, t, ...).
    p
        Their parameters.
    max_calls
        After so many calls of ``value`` the run ends as budget_exceeded.
    """

    def __init__(self, value: Callable, jacobian: Callable, p: Any, max_calls: int) -> None:
        self._value, self._jacobian = value, jacobian
        self._p, self._max_calls = p, max_calls
        self._residuals = self._jacobians = self._newton = self._attempts = 0
        self._factorisations = self._solves = 0
        self._now = self._earliest = math.inf
        #: Whether all values since the last accepted step were finite.
        self.finite = True

    def begin_step(self, t: float) -> None:
        """Say that the solver stands at time t."""
        self._now, self._earliest, self.finite = t, math.inf, True

    def value(self, t: float, *at: np.ndarray) -> np.ndarray:
        if self._residuals == self._max_calls:
            raise Stop("budget_exceeded", f"{self._max_calls} calls were used up")
        self._residuals += 1
        if self._now < t <= self._earliest:
            self._newton += 1
            self._attempts += int(t < self._earliest)
            self._earliest = t
        # A float of numpy's own would be compiled for once more.
        value = np.asarray(self._value(self._p, float(t), *at))
        # The sum is finite only if every entry is, and is cheaper to form than the test of each.
        if not math.isfinite(value.sum()):
            self.finite = False
            # Solvers answer to such a value by a smaller step, unless it made the time NaN.
            if not math.isfinite(t):
                raise Stop("diverged", NOT_FINITE)
        return value

    def jacobian(self, t: float, *at: np.ndarray) -> Any:
        self._jacobians += 1
        return self._jacobian(self._p, float(t), *at)

    def watch(self, solver: Any) -> None:
        """Count the factorisations and solves of a solver of scipy's kind."""
        factorise, solve = solver.lu, solver.solve_lu

        def counted_lu(matrix: np.ndarray) -> Any:
            self._factorisations += 1
            return factorise(matrix)

        def counted_solve(factors: Any, b: np.ndarray) -> np.ndarray:
            self._solves += 1
            return solve(factors, b)

        solver.lu, solver.solve_lu = counted_lu, counted_solve

    def work(self, steps: int) -> Work:
        """What was counted, with the number of accepted steps."""
        return Work(
            steps,
            self._attempts - steps,
            self._newton,
            self._residuals,
            self._jacobians,
            self._factorisations,
            self._solves,
        )
