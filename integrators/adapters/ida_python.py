"""IDA with residual and Jacobian called through Python, by scikit-sundae's own solver."""

from __future__ import annotations

import contextlib
import ctypes
import io
import warnings
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from integrators.adapters.callbacks import NOT_FINITE, EarlyEnd, all_finite
from integrators.contract import Work

if TYPE_CHECKING:
    from jaxtyping import Float


class IDAEquations:
    """Residual and Jacobian as IDA calls them, counted; one object for each run.

    IDA checks the signatures. The last argument is an array that the method fills.
    """

    def __init__(
        self, residual: Callable[..., Any], jacobian: Callable[..., Any], max_calls: int
    ) -> None:
        self._residual, self._jacobian, self._max_calls = residual, jacobian, max_calls
        self.residuals = self.jacobians = 0

    def residual(self, t: float, w: np.ndarray, wdot: np.ndarray, res: np.ndarray) -> None:
        if self.residuals == self._max_calls:
            raise EarlyEnd("budget_exceeded", f"{self._max_calls} residual calls were used up")
        self.residuals += 1
        res[:] = self._residual(t, w, wdot)
        # After a NaN IDA would repeat the step without end.
        if not all_finite(res):
            raise EarlyEnd("diverged", NOT_FINITE)

    def jacobian(
        self, t: float, w: np.ndarray, wdot: np.ndarray, res: np.ndarray, cj: float, jac: np.ndarray
    ) -> None:
        jac.T[:] = self._jacobian(t, w, wdot, cj)  # a vector of entries is its own transpose
        self.jacobians += 1


class PythonIDA:
    """A solver of scikit-sundae's at the start of a run."""

    def __init__(self, solver: Any, equations: IDAEquations, t_end: float) -> None:
        self._solver, self._equations, self._t_end = solver, equations, t_end

    def whole(self) -> Any:
        """Solve to the end; IDA stops exactly there, so that nothing is interpolated."""
        return self._solver.step(self._t_end, "normal", self._t_end)

    def step(self) -> tuple[int, float, Float[np.ndarray, " n"]]:
        """Take one step of IDA's own; return its flag, the time and the unknowns.

        Raises
        ------
        EarlyEnd
            If the calls are used up, the residual is not finite, or IDA gives up.
        """
        try:
            step = self._solver.step(self._t_end, "onestep", self._t_end)
        except RuntimeError as error:
            raise EarlyEnd("crashed", f"IDA gave up: {error}") from None
        return step.status, float(step.t), step.y

    def work(self, steps: int) -> Work:
        """The counts of the run."""
        jacobians = self._equations.jacobians
        return Work(
            steps=steps,
            residuals=self._equations.residuals,
            jacobians=jacobians,
            factorisations=jacobians,  # IDA factorises each Jacobian once
        )


@contextlib.contextmanager
def python_ida(
    functions: tuple[Callable, Callable],
    start: tuple[float, np.ndarray, np.ndarray],
    t_end: float,
    options: dict[str, Any],
    max_calls: int,
) -> Iterator[PythonIDA]:
    """A new solver at the start: a used one keeps counters and history."""
    from sksundae import ida

    equations = IDAEquations(*functions, max_calls)
    # SUNDIALS writes its warnings to standard output; the status says the same.
    with contextlib.redirect_stdout(io.StringIO()), np.errstate(all="ignore"):
        with warnings.catch_warnings():
            # IDA warns that the sparse Jacobian comes from our function, as intended.
            warnings.simplefilter("ignore")
            solver = ida.IDA(equations.residual, jacfn=equations.jacobian, **options)
        solver.init_step(*start)
        try:
            yield PythonIDA(solver, equations, t_end)
        finally:
            if "sparsity" in options and not equations.jacobians:
                # SuperLU_MT's memory cannot be freed before its first factorisation: the
                # process would crash (scikit-sundae 1.2.0).
                ctypes.pythonapi.Py_IncRef(ctypes.py_object(solver))
