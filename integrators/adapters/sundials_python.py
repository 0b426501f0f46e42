"""IDA and CVODE with equations called through Python, by scikit-sundae's own solvers."""

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


class Callbacks:
    """Residual and Jacobian of a solver, counted; one object for each run."""

    def __init__(
        self, residual: Callable[..., Any], jacobian: Callable[..., Any], max_calls: int
    ) -> None:
        self._residual, self._jacobian, self._max_calls = residual, jacobian, max_calls
        self.residuals = self.jacobians = 0

    def fill(self, out: np.ndarray, *state: Any) -> None:
        """Write the residual."""
        if self.residuals == self._max_calls:
            raise EarlyEnd("budget_exceeded", f"{self._max_calls} calls were used up")
        self.residuals += 1
        out[:] = self._residual(*state)
        # After a NaN IDA would repeat the step without end.
        if not all_finite(out):
            raise EarlyEnd("diverged", NOT_FINITE)

    def fill_jacobian(self, out: np.ndarray, *state: Any) -> None:
        """Write the Jacobian."""
        out.T[:] = self._jacobian(*state)  # a vector of entries is its own transpose
        self.jacobians += 1


def new_ida(callbacks: Callbacks, **options: Any) -> Any:
    """IDA of scikit-sundae, which checks the signatures of what it calls."""
    from sksundae import ida

    def residual(t: float, w: np.ndarray, wdot: np.ndarray, res: np.ndarray) -> None:
        callbacks.fill(res, t, w, wdot)

    def jacobian(
        t: float, w: np.ndarray, wdot: np.ndarray, res: np.ndarray, cj: float, jac: np.ndarray
    ) -> None:
        callbacks.fill_jacobian(jac, t, w, wdot, cj)

    return ida.IDA(residual, jacfn=jacobian, **options)


def new_cvode(callbacks: Callbacks, **options: Any) -> Any:
    """CVODE of scikit-sundae, which checks the signatures of what it calls."""
    from sksundae import cvode

    def rate(t: float, s: np.ndarray, value: np.ndarray) -> None:
        callbacks.fill(value, t, s)

    def jacobian(t: float, s: np.ndarray, value: np.ndarray, jac: np.ndarray) -> None:
        callbacks.fill_jacobian(jac, t, s)

    return cvode.CVODE(rate, jacfn=jacobian, **options)


class PythonSolver:
    """A solver of scikit-sundae's at the start of a run."""

    def __init__(self, solver: Any, callbacks: Callbacks, t_end: float) -> None:
        self._solver, self._callbacks, self._t_end = solver, callbacks, t_end

    def whole(self) -> Any:
        """Solve to the end; the solver stops exactly there, so that nothing is interpolated."""
        return self._solver.step(self._t_end, "normal", self._t_end)

    def step(self) -> tuple[int, float, Float[np.ndarray, " n"]]:
        """Take one step of the solver's own; return its flag, the time and the unknowns.

        Raises
        ------
        EarlyEnd
            If the calls are used up, the residual is not finite, or the solver gives up.
        """
        try:
            step = self._solver.step(self._t_end, "onestep", self._t_end)
        except RuntimeError as error:
            raise EarlyEnd("crashed", f"the solver gave up: {error}") from None
        return step.status, float(step.t), step.y

    def work(self, steps: int) -> Work:
        """The counts of the run that callbacks see."""
        callbacks = self._callbacks
        return Work(steps=steps, residuals=callbacks.residuals, jacobians=callbacks.jacobians)


@contextlib.contextmanager
def python_solver(
    new: Callable[..., Any],
    functions: tuple[Callable, Callable],
    start: tuple[Any, ...],
    t_end: float,
    options: dict[str, Any],
    max_calls: int,
) -> Iterator[PythonSolver]:
    """A new solver at the start: a used one keeps counters and history.

    Parameters
    ----------
    new
        `new_ida` or `new_cvode`.
    """
    callbacks = Callbacks(*functions, max_calls)
    # SUNDIALS writes its warnings to standard output; the status says the same.
    with contextlib.redirect_stdout(io.StringIO()), np.errstate(all="ignore"):
        with warnings.catch_warnings():
            # IDA warns that the sparse Jacobian comes from our function, as intended.
            warnings.simplefilter("ignore")
            solver = new(callbacks, **options)
        solver.init_step(*start)
        try:
            yield PythonSolver(solver, callbacks, t_end)
        finally:
            if "sparsity" in options and not callbacks.jacobians:
                # SuperLU_MT's memory cannot be freed before its first factorisation: the
                # process would crash (scikit-sundae 1.2.0).
                ctypes.pythonapi.Py_IncRef(ctypes.py_object(solver))
