"""A run of IDA or CVODE, whose equations are in C or called through Python."""

from __future__ import annotations

import contextlib
from abc import abstractmethod
from dataclasses import replace
from typing import Any

import numpy as np

from integrators.adapters.callbacks import EarlyEnd
from integrators.adapters.sundials_equations import (
    Compiled,
    Equations,
    check,
    compiled_equations,
)
from integrators.adapters.sundials_native import NativeSolver
from integrators.adapters.sundials_python import PythonSolver, python_solver
from integrators.adapters.trajectories import early_end_message
from integrators.contract import PreparedRun, Trajectory, Work
from integrators.kept_rows import RowKeeper, width_of
from integrators.lowering.graph import NotLowered
from integrators.operations import Algebra, bill
from problems.runtime import slower
from problems.system import MechatronicSystem

#: SUNDIALS' own limit of steps is never reached: calls are limited here.
_NO_LIMIT = 2**31 - 1

#: Status and reason of the flags of IDA and CVODE; any other negative flag is a crash.
_ENDINGS = {
    -1: ("budget_exceeded", "SUNDIALS' own limit of steps was reached"),
    -2: ("step_too_small", "the tolerances ask for more than round-off allows"),
    -3: ("step_too_small", "the error test kept failing down to the smallest step"),
    -4: ("newton_failed", "Newton's method kept failing down to the smallest step"),
    -5: ("newton_failed", "the linear solver failed"),
    -6: ("newton_failed", "the Jacobian could not be factorised"),
    -7: ("newton_failed", "the linear solver failed"),
    -8: ("diverged", "the equations could not be evaluated"),
}


class SundialsRun(PreparedRun):
    """A run of a solver of SUNDIALS.

    Parameters
    ----------
    name
        The solver as a person reads it.
    callbacks, max_calls
        Options of the method.
    equations, p
        What the solver calls, and values of the parameters.
    start
        Arguments of the residual at the start: t0 and vectors.
    options
        Those of scikit-sundae's solver.
    algebra
        Operations of the solver's linear algebra.
    """

    def __init__(
        self,
        name: str,
        callbacks: str,
        max_calls: int,
        scene: MechatronicSystem,
        t_end: float,
        equations: Equations,
        p: np.ndarray,
        start: tuple[Any, ...],
        options: dict[str, Any],
        algebra: Algebra,
    ) -> None:
        self._name, self._scene, self._t_end, self._p = name, scene, float(t_end), p
        self._equations, self.start, self._algebra = equations, start, algebra
        self._max_calls, self.options = max_calls, {**options, "max_num_steps": _NO_LIMIT}
        self.functions = equations.residual.bind(p), equations.jacobian.bind(p)
        self.functions[0](*start)  # compiles
        self.functions[1](*start, *equations.factors)
        found: Any = "callbacks=python was asked for"
        if callbacks == "compiled":
            found = self._compiled()
        #: Residual and Jacobian in C, if the solver calls those, or why it does not.
        self.native, self.why = (found, "") if isinstance(found, Compiled) else (None, str(found))

    @abstractmethod
    def _native_solver(self, compiled: Compiled, *given: Any) -> NativeSolver:
        """A new solver; ``given`` are the further arguments of `NativeSolver`."""

    @abstractmethod
    def _new(self, callbacks: Any, **options: Any) -> Any:
        """A new solver of scikit-sundae's."""

    @abstractmethod
    def _trajectory(self, t: np.ndarray, w: np.ndarray) -> Trajectory:
        """The trajectory of the solver's vectors w at times t."""

    @abstractmethod
    def _completed(self, work: Work) -> Work:
        """The counts, with those that follow from others."""

    @abstractmethod
    def _linear_algebra(self, work: Work) -> tuple[int, int] | None:
        """The numbers of factorisations and solves; None if they are not known."""

    @abstractmethod
    def _advice(self, cause: str) -> str:
        """Advice after an early end of this status, or with the step too small."""

    def _compiled(self) -> Compiled | NotLowered:
        """The equations in C, compared with those of JAX, or why they are called through Python."""
        found = compiled_equations(self._equations)
        try:
            if isinstance(found, Compiled):
                check(found, self._equations, self.functions, self._p, self.start)
                return found
        except NotLowered as difference:
            found = difference
        slower(
            f"{self._name} calls {self._scene.name} through Python, which takes longer: {found}."
        )
        return found

    def _solver(self) -> contextlib.AbstractContextManager[NativeSolver | PythonSolver]:
        """A new solver at the start of the run."""
        given = self.start, self._t_end, self.options, self._max_calls
        if self.native is None:
            return python_solver(self._new, self.functions, *given)
        return contextlib.closing(self._native_solver(self.native, self._p, *given))

    def execute(self) -> Any:
        with contextlib.suppress(EarlyEnd, RuntimeError), self._solver() as solver:
            return solver.whole()

    def measure(self) -> Trajectory:
        # The steps of ``execute``, one by one: a failure loses none of them.
        kept = RowKeeper(width_of(self._scene.sizes), self.start[:2], self._t_end)
        flag, early_end, work, h = 0, None, Work(steps=0), 0.0
        try:
            with self._solver() as solver:
                try:
                    while kept.last[0] < self._t_end and flag >= 0:
                        flag, time, unknowns = solver.step()
                        if flag >= 0:
                            h = time - kept.last[0]
                            kept.add((time, unknowns))
                finally:
                    work = self._completed(solver.work(kept.steps))
        except EarlyEnd as end:
            early_end = end.with_traceback(None)  # whose frames would keep the solver alive
        if flag < 0:
            unknown = "crashed", f"{self._name} returned the flag {flag}"
            early_end = EarlyEnd(*_ENDINGS.get(flag, unknown))
        t, w = map(np.array, zip(*kept.rows(), strict=True))
        trajectory = replace(self._trajectory(t, w), work=work)
        if early_end is None:
            return trajectory
        status, cause, reason = early_end.status, early_end.status, early_end.reason
        # More than a Jacobian in each step: the steps that were tried failed, one after the other.
        if status == "budget_exceeded" and (work.jacobians or 0) > (work.steps or 0):
            cause, reason = "step_too_small", f"the step has collapsed to {h:.2g} s, and {reason}"
        message = early_end_message(t[-1], self._t_end, reason, self._advice(cause))
        return replace(trajectory, status=status, message=message)

    def bill(self, run: Trajectory) -> dict[str, float]:
        algebra = self._linear_algebra(run.work)
        if algebra is None:
            return {}
        factorisations, solves = algebra
        return bill(
            self._scene,
            run,
            self._equations.residual.operations.times(run.work.residuals or 0),
            self._equations.jacobian.operations.times(run.work.jacobians or 0),
            factorisations * self._algebra.factorisation,
            solves * self._algebra.solve,
        )
