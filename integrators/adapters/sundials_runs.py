"""Runs of IDA and CVODE: by SUNDIALS itself on equations in C, or by scikit-sundae on Python's."""

from __future__ import annotations

import contextlib
import ctypes
import io
import warnings
from abc import abstractmethod
from collections.abc import Iterator
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from integrators.adapters.library_runs import (
    CountedEquations,
    EarlyEnd,
    GivenEquations,
    LibraryRun,
    LibrarySolver,
)
from integrators.adapters.sundials import check_step, library
from integrators.adapters.sundials_native import NativeEquations, NativeSolver
from integrators.contract import Work
from integrators.program_costs import Algebra
from problems.base.runtime import Float

#: SUNDIALS' own limit of steps is never reached: calls are limited here.
_NO_LIMIT = 2**31 - 1


class SundialsRun(LibraryRun):
    """A run of a solver of SUNDIALS.

    Parameters
    ----------
    options
        Those of scikit-sundae's solver.
    more
        Further options of the library's own solver.
    """

    #: The library's own solver, and whether it factorises each Jacobian once.
    native: ClassVar[type[NativeSolver]]
    keeps_no_jacobian: ClassVar[bool] = False

    def __init__(
        self,
        method: LibrarySolver,
        given: GivenEquations,
        t_end: float,
        algebra: Algebra,
        options: dict[str, Any],
        **more: Any,
    ) -> None:
        self.options, self._more = {**options, "max_num_steps": _NO_LIMIT}, more
        super().__init__(method, given, t_end, algebra)

    @abstractmethod
    def _python_solver(self, equations: CountedEquations) -> Any:
        """A new solver of scikit-sundae, which checks the signatures of what it calls."""

    def _check_library(self) -> None:
        library()

    @contextlib.contextmanager
    def _solver(self, counts: bool) -> Iterator[Any]:
        if not self.why:
            solver = self.native(self._native_equations, self._t_end, self.options | self._more)
            try:
                yield solver
            finally:
                solver.close()
            return
        limit = self._method.max_calls
        # After a NaN IDA would repeat the step without end.
        equations = CountedEquations(*self.functions, limit, ends_at_not_finite=True)
        # SUNDIALS writes its warnings to standard output; the status says the same.
        with contextlib.redirect_stdout(io.StringIO()), np.errstate(all="ignore"):
            with warnings.catch_warnings():
                # IDA warns that the sparse Jacobian comes from our function, as intended.
                warnings.simplefilter("ignore")
                solver = self._python_solver(equations)
            solver.init_step(*self.given.start)
            try:
                yield _PythonSolver(self, solver, equations, self._t_end)
            finally:
                if "sparsity" in self.options and not equations.jacobians:
                    # SuperLU_MT's memory cannot be freed before its first factorisation: the
                    # process would crash (scikit-sundae 1.2.0).
                    ctypes.pythonapi.Py_IncRef(ctypes.py_object(solver))

    @cached_property
    def _native_equations(self) -> NativeEquations:
        return NativeEquations(self.given, self._method.max_calls)

    def _collapsed(self, status: str, work: Work) -> bool:
        # More than a Jacobian in each step.
        return status == "budget_exceeded" and (work.jacobians or 0) > (work.steps or 0)


class _PythonSolver:
    """A solver of scikit-sundae's at the start of a run."""

    def __init__(
        self, run: SundialsRun, solver: Any, equations: CountedEquations, t_end: float
    ) -> None:
        self._run, self._solver, self._equations, self._t_end = run, solver, equations, t_end
        #: The highest one: scikit-sundae does not tell that of a step.
        self.order = run.options["max_order"]

    def whole(self) -> Any:
        # It stops exactly at the end, so that nothing is interpolated.
        return self._solved("normal")

    def step(self) -> tuple[float, Float[np.ndarray, " n"]]:
        step = self._solved("onestep")
        return float(step.t), step.y

    def work(self, steps: int) -> Work:
        counts = self._equations
        work = Work(steps, residuals=counts.residuals, jacobians=counts.jacobians)
        if self._run.keeps_no_jacobian:
            work.factorisations = work.jacobians
        return work

    def _solved(self, task: str) -> Any:
        name = type(self._solver).__name__
        try:
            found = self._solver.step(self._t_end, task, self._t_end)
        except RuntimeError as error:
            raise EarlyEnd("crashed", f"the solver gave up: {error}") from None
        except KeyError as unknown:  # scikit-sundae has no words for some flags
            if isinstance(unknown.args[0], int):
                check_step(name, unknown.args[0])
            raise
        check_step(name, found.status)
        return found
