"""IDA with residual and Jacobian in C: nothing of a solve runs in Python."""

from __future__ import annotations

import ctypes
from ctypes import byref, c_double, c_int64, c_long, c_void_p
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from integrators.adapters.callbacks import NOT_FINITE, EarlyEnd
from integrators.adapters.ida_equations import Compiled
from integrators.adapters.sundials import library
from integrators.contract import Work

if TYPE_CHECKING:
    from jaxtyping import Float

_NORMAL, _ONE_STEP = 1, 2
_TOO_MUCH_WORK = -1
_CSC = 0
#: After so many steps in one call Python looks for signals.
_STEPS_IN_A_CALL = 10_000


class _Run(ctypes.Structure):
    """run_t of the C in `integrators.adapters.ida_equations`."""

    _fields_ = [
        ("p", c_void_p),
        *((name, c_void_p) for name in ("vector", "entries", "rows", "starts")),
        *((name, c_int64) for name in ("most", "residuals", "jacobians", "ending")),
    ]


class Solution(NamedTuple):
    """Where a whole solve ended: time, unknowns, IDA's flag and its counts of calls."""

    t: float
    y: Float[np.ndarray, " n"]
    status: int
    nfev: int
    njev: int


class NativeIDA:
    """A solver of IDA at the start of a run; its memory is freed by `close`.

    Parameters
    ----------
    compiled, p, start
        The equations, values of their parameters, and t0, w, wdot.
    options
        ``rtol``, ``atol`` for each unknown, and ``max_order``.
    max_calls
        After so many residual calls the run ends as budget_exceeded.
    differential
        1 for unknowns whose derivatives are in the equations, else 0.
    suppress_algebraic
        Whether the error test leaves the others out.
    """

    def __init__(
        self,
        compiled: Compiled,
        p: Float[np.ndarray, " parameters"],
        start: tuple[float, np.ndarray, np.ndarray],
        t_end: float,
        options: dict[str, Any],
        max_calls: int,
        differential: Float[np.ndarray, " n"],
        suppress_algebraic: bool,
    ) -> None:
        it = self._library = library()
        t0, w, wdot = start
        n, self._entries, self._t_end, self._p = len(w), compiled.entries, t_end, p
        self._context, self._t = c_void_p(), c_double(t0)
        it.SUNContext_Create(0, byref(self._context))
        it.SUNContext_ClearErrHandlers(self._context)  # flags say the same as its messages
        self._vectors = [
            it.vector(values, self._context) for values in (w, wdot, options["atol"], differential)
        ]
        (self._w, self._values), (self._wdot, _), (atol, _), (kinds, _) = self._vectors
        self._matrix, self._solver = self._linear_algebra(n)
        self._memory = c_void_p(it.IDACreate(self._context))
        kind = "Dense" if self._entries is None else "Sparse"
        self._run = _Run(
            p.ctypes.data,
            it.address("N_VGetArrayPointer"),
            it.address(f"SUN{kind}Matrix_Data"),
            it.address("SUNSparseMatrix_IndexValues"),
            it.address("SUNSparseMatrix_IndexPointers"),
            max_calls,
        )
        residual, jacobian = (
            ctypes.cast(function, c_void_p)
            for function in (compiled.c.ida_residual, compiled.c.ida_jacobian)
        )
        self._do("IDASetUserData", c_void_p(ctypes.addressof(self._run)))
        self._do("IDAInit", residual, t0, self._w, self._wdot)
        self._do("IDASVtolerances", options["rtol"], atol)
        self._do("IDASetLinearSolver", self._solver, self._matrix)
        self._do("IDASetJacFn", jacobian)
        self._do("IDASetId", kinds)
        self._do("IDASetSuppressAlg", int(suppress_algebraic))
        self._do("IDASetMaxOrd", options["max_order"])
        self._do("IDASetMaxNumSteps", _STEPS_IN_A_CALL)
        self._do("IDASetStopTime", t_end)

    def whole(self) -> Solution:
        """Solve to the end; IDA stops exactly there, so that nothing is interpolated.

        Raises
        ------
        EarlyEnd
            If the calls are used up, or the residual is not finite.
        """
        flag = _TOO_MUCH_WORK
        while flag == _TOO_MUCH_WORK:
            flag = self._solve(_NORMAL)
        counts = (self._count(name) for name in ("ResEvals", "JacEvals"))
        return Solution(self._t.value, self._values.copy(), flag, *counts)

    def step(self) -> tuple[int, float, np.ndarray]:
        """Take one step of IDA's own; return its flag, the time and the unknowns.

        Raises
        ------
        EarlyEnd
            If the calls are used up, or the residual is not finite.
        """
        return self._solve(_ONE_STEP), self._t.value, self._values.copy()

    def work(self, steps: int) -> Work:
        """The counts of the run; all but the first two and the steps are IDA's own."""
        newton = self._count("NonlinSolvIters")
        return Work(
            steps=steps,
            rejected=self._count("ErrTestFails") + self._count("StepSolveFails"),
            newton=newton,
            residuals=self._run.residuals,
            jacobians=self._run.jacobians,
            factorisations=self._count("LinSolvSetups"),
            solves=newton,
        )

    def close(self) -> None:
        """Free all memory of the solver."""
        it = self._library
        it.IDAFree(byref(self._memory))
        # SuperLU_MT's memory cannot be freed before its first factorisation (SUNDIALS 7.9).
        if self._entries is None or self._run.jacobians:
            it.SUNLinSolFree(self._solver)
        it.SUNMatDestroy(self._matrix)
        for vector, _ in self._vectors:
            it.N_VDestroy(vector)
        it.SUNContext_Free(byref(self._context))

    def _linear_algebra(self, n: int) -> tuple[int, int]:
        it = self._library
        if self._entries is None:
            matrix = it.SUNDenseMatrix(n, n, self._context)
            return matrix, it.SUNLinSol_Dense(self._w, matrix, self._context)
        matrix = it.SUNSparseMatrix(n, n, self._entries, _CSC, self._context)
        return matrix, it.SUNLinSol_SuperLUMT(self._w, matrix, 1, self._context)

    def _solve(self, task: int) -> int:
        at = byref(self._t)
        flag = self._library.IDASolve(self._memory, self._t_end, at, self._w, self._wdot, task)
        if self._run.ending == 1:
            raise EarlyEnd("budget_exceeded", f"{self._run.most} residual calls were used up")
        if self._run.ending == 2:
            raise EarlyEnd("diverged", NOT_FINITE)
        return flag

    def _do(self, name: str, *arguments: Any) -> None:
        flag = getattr(self._library, name)(self._memory, *arguments)
        if flag < 0:
            raise EarlyEnd("crashed", f"{name} of SUNDIALS returned the flag {flag}")

    def _count(self, name: str) -> int:
        number = c_long()
        self._do(f"IDAGetNum{name}", byref(number))
        return number.value
