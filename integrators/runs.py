"""Prepared runs and their results: rows, a status and work counts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from problems.base.runtime import Float, Int

#: Endings of a run; only "ok" has a complete trajectory.
STATUSES = (
    "ok",  # the run reached t_end
    "newton_failed",  # Newton's method or its linear solver failed
    "step_too_small",  # the step control fell to the rounding of time
    "diverged",  # a value grew beyond all bounds or is not finite
    "budget_exceeded",  # more steps, calls or time than are allowed
    "unsupported",  # the integrator cannot take the scene
    "crashed",  # an exception, or the end of the process
)


@dataclass
class Work:
    """Work counts of a run; None where a count is not known.

    Attributes
    ----------
    steps, rejected
        Accepted steps, and attempts that the step control rejected.
    newton
        Iterations of Newton's method.
    residuals
        Evaluations of the residual, or of an ODE's right-hand side.
    jacobians, factorisations, solves
        Evaluations of the Jacobian, factorisations of matrices, and solves with the factors.
    """

    steps: int | None = None
    rejected: int | None = None
    newton: int | None = None
    residuals: int | None = None
    jacobians: int | None = None
    factorisations: int | None = None
    solves: int | None = None


@dataclass
class Trajectory:
    """Rows of a run at k of its own steps, the start first; `integrators.output_rows` chooses them.

    Errors are measured at these rows: an error "largest over time" is over all steps only if every
    step is a row. A run that failed keeps the rows up to its last good step.

    Attributes
    ----------
    t
        Times in s.
    q, v, a
        Coordinates, velocities and accelerations, in the scene's units.
    lam, x, xdot, y
        Multipliers, controller states, their rates, and outputs; of no columns where the scene
        has none.
    status, message
        One of `STATUSES`; unless it is "ok", one sentence that names the time and a remedy.
    work
        Work counts of the whole run.
    notes
        Further numbers of a method about the step that led to a row, such as its size "h" or its
        weight "gamma".
    xd, phase
        Where values jump at samples or events: the held values, and the number of the phase, of
        each row. A row at a jump belongs to the phase before. Empty elsewhere.
    events
        Times in s and numbers of the events.
    """

    t: Float[np.ndarray, " k"]
    q: Float[np.ndarray, "k nq"]
    v: Float[np.ndarray, "k nq"]
    a: Float[np.ndarray, "k nq"]
    lam: Float[np.ndarray, "k nl"]
    x: Float[np.ndarray, "k nx"]
    xdot: Float[np.ndarray, "k nx"]
    y: Float[np.ndarray, "k ny"]
    status: str = "ok"
    message: str = ""
    work: Work = field(default_factory=Work)
    notes: dict[str, Float[np.ndarray, " k"]] = field(default_factory=dict)
    xd: Float[np.ndarray, "k nd"] = field(default_factory=lambda: np.zeros((0, 0)))
    phase: Int[np.ndarray, " k"] = field(default_factory=lambda: np.zeros(0, dtype=int))
    events: Float[np.ndarray, "n 2"] = field(default_factory=lambda: np.zeros((0, 2)))

    @classmethod
    def failed(cls, status: str, message: str) -> Trajectory:
        """Return the trajectory of a run that did not start: it has no rows."""
        empty = np.zeros((0, 0))
        return cls(np.zeros(0), *[empty] * 7, status=status, message=message)


class PreparedRun(ABC):
    """A run that can be measured and timed, any number of times."""

    @abstractmethod
    def measure(self) -> Trajectory:
        """Solve from t0 to t_end, keep rows and count work; untimed, and a warm-up."""

    @abstractmethod
    def execute(self) -> Any:
        """Solve from t0 to t_end and do nothing else; timed.

        The steps are those of ``measure``. The bench ignores the result. The call returns when
        the result is ready, and does not raise for numerical trouble.
        """

    def bill(self, run: Trajectory) -> dict[str, float]:
        """Return the floating-point operations of a measured run by part; empty if not known.

        They are all that its steps do: evaluations of equations, linear algebra, and arithmetic
        of the method itself (stages, predictors, tests of convergence, step control): numbers that
        were counted in the run, times the operations of one (`integrators.program_costs`).
        """
        return {}


class ChangedRun(PreparedRun):
    """A run whose trajectory is changed by a function after it was measured."""

    def __init__(self, run: PreparedRun, change: Callable[[Trajectory], None]) -> None:
        self._run, self._change = run, change
        self.execute, self.bill = run.execute, run.bill

    def execute(self) -> Any:  # replaced by that of the run
        return self._run.execute()

    def measure(self) -> Trajectory:
        rows = self._run.measure()
        self._change(rows)
        return rows
