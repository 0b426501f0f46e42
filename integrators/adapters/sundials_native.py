"""IDA and CVODE with their equations in C: nothing of a solve runs in Python."""

from __future__ import annotations

import ctypes
from abc import ABC, abstractmethod
from ctypes import byref, c_double, c_int64, c_long, c_void_p
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from integrators.adapters.callbacks import NOT_FINITE, EarlyEnd
from integrators.adapters.sundials import library
from integrators.adapters.sundials_equations import Compiled
from integrators.contract import Work

if TYPE_CHECKING:
    from jaxtyping import Float

_NORMAL, _ONE_STEP = 1, 2
_TOO_MUCH_WORK = -1
_CSC = 0
#: After so many steps in one call Python looks for signals.
_STEPS_IN_A_CALL = 10_000


class _Run(ctypes.Structure):
    """run_t of the C in `integrators.adapters.sundials_equations`."""

    _fields_ = [
        ("p", c_void_p),
        *((name, c_void_p) for name in ("vector", "entries", "rows", "starts")),
        *((name, c_int64) for name in ("most", "residuals", "jacobians", "ending")),
    ]


class Solution(NamedTuple):
    """The end of a whole solve: time, unknowns, the solver's flag and its counts of calls."""

    t: float
    y: Float[np.ndarray, " n"]
    status: int
    nfev: int
    njev: int


class NativeSolver(ABC):
    """A solver of SUNDIALS at the start of a run; its memory is freed by `close`.

    Parameters
    ----------
    compiled, p, start
        The equations, values of their parameters, t0 and the vectors there.
    options
        ``rtol``, ``atol`` for each unknown, and ``max_order``.
    max_calls
        After so many residual calls the run ends as budget_exceeded.
    """

    #: How the names of its functions begin, and the name of its count of residual calls.
    _name: ClassVar[str]
    _calls: ClassVar[str]

    def __init__(
        self,
        compiled: Compiled,
        p: Float[np.ndarray, " parameters"],
        start: tuple[Any, ...],
        t_end: float,
        options: dict[str, Any],
        max_calls: int,
    ) -> None:
        it = self._library = library()
        t0, *vectors = start
        self._entries, self._t_end, self._p = compiled.entries, t_end, p
        self._context, self._t = c_void_p(), c_double(t0)
        it.SUNContext_Create(0, byref(self._context))
        it.SUNContext_ClearErrHandlers(self._context)  # flags say the same as its messages
        self._vectors: list[int] = []
        self._state = [self._vector(values) for values in vectors]
        unknowns = it.N_VGetArrayPointer(self._state[0])
        self._values = np.ctypeslib.as_array(unknowns, vectors[0].shape)
        self._matrix, self._solver = self._linear_algebra(len(vectors[0]))
        self._memory = c_void_p(self._create())
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
            for function in (compiled.c.called_residual, compiled.c.called_jacobian)
        )
        self._do("SetUserData", c_void_p(ctypes.addressof(self._run)))
        self._do("Init", residual, t0, *self._state)
        self._do("SVtolerances", options["rtol"], self._vector(options["atol"]))
        self._do("SetLinearSolver", self._solver, self._matrix)
        self._do("SetJacFn", jacobian)
        self._do("SetMaxOrd", options["max_order"])
        self._do("SetMaxNumSteps", _STEPS_IN_A_CALL)
        self._do("SetStopTime", t_end)

    @abstractmethod
    def _create(self) -> int:
        """New memory of the solver."""

    @abstractmethod
    def _go_on(self, task: int) -> int:
        """Call the solver; return its flag."""

    def whole(self) -> Solution:
        """Solve to the end; the solver stops exactly there, so that nothing is interpolated.

        Raises
        ------
        EarlyEnd
            If the calls are used up, or the residual is not finite.
        """
        flag = _TOO_MUCH_WORK
        while flag == _TOO_MUCH_WORK:
            flag = self._solve(_NORMAL)
        counts = (self._count(name) for name in (self._calls, "JacEvals"))
        return Solution(self._t.value, self._values.copy(), flag, *counts)

    def step(self) -> tuple[int, float, np.ndarray]:
        """Take one step of the solver's own; return its flag, the time and the unknowns.

        Raises
        ------
        EarlyEnd
            If the calls are used up, or the residual is not finite.
        """
        return self._solve(_ONE_STEP), self._t.value, self._values.copy()

    def work(self, steps: int) -> Work:
        """The counts of the run: steps, residuals and Jacobians by us, the others by SUNDIALS."""
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
        getattr(it, f"{self._name}Free")(byref(self._memory))
        # SuperLU_MT's memory cannot be freed before its first factorisation (SUNDIALS 7.9).
        if self._entries is None or self._run.jacobians:
            it.SUNLinSolFree(self._solver)
        it.SUNMatDestroy(self._matrix)
        for vector in self._vectors:
            it.N_VDestroy(vector)
        it.SUNContext_Free(byref(self._context))

    def _vector(self, values: np.ndarray) -> int:
        """A new vector, whose memory is freed with that of the solver."""
        self._vectors.append(self._library.vector(values, self._context))
        return self._vectors[-1]

    def _linear_algebra(self, n: int) -> tuple[int, int]:
        it = self._library
        if self._entries is None:
            matrix = it.SUNDenseMatrix(n, n, self._context)
            return matrix, it.SUNLinSol_Dense(self._state[0], matrix, self._context)
        matrix = it.SUNSparseMatrix(n, n, self._entries, _CSC, self._context)
        return matrix, it.SUNLinSol_SuperLUMT(self._state[0], matrix, 1, self._context)

    def _solve(self, task: int) -> int:
        flag = self._go_on(task)
        if self._run.ending == 1:
            raise EarlyEnd("budget_exceeded", f"{self._run.most} calls were used up")
        if self._run.ending == 2:
            raise EarlyEnd("diverged", NOT_FINITE)
        return flag

    def _do(self, name: str, *arguments: Any) -> None:
        name = self._name + name
        flag = getattr(self._library, name)(self._memory, *arguments)
        if flag < 0:
            raise EarlyEnd("crashed", f"{name} of SUNDIALS returned the flag {flag}")

    def _count(self, name: str) -> int:
        number = c_long()
        self._do(f"GetNum{name}", byref(number))
        return number.value


class NativeIDA(NativeSolver):
    """IDA at the start of a run.

    Parameters
    ----------
    given
        Those of `NativeSolver`.
    differential
        1 for unknowns whose derivatives are in the equations, else 0.
    suppress_algebraic
        Whether the error test leaves the others out.
    """

    _name, _calls = "IDA", "ResEvals"

    def __init__(
        self, *given: Any, differential: Float[np.ndarray, " n"], suppress_algebraic: bool
    ) -> None:
        super().__init__(*given)
        self._do("SetId", self._vector(differential))
        self._do("SetSuppressAlg", int(suppress_algebraic))

    def _create(self) -> int:
        return self._library.IDACreate(self._context)

    def _go_on(self, task: int) -> int:
        at = byref(self._t)
        return self._library.IDASolve(self._memory, self._t_end, at, *self._state, task)


class NativeCVODE(NativeSolver):
    """CVODE at the start of a run, with the formulas of ``method``: adams or bdf."""

    _name, _calls = "CVode", "RhsEvals"
    _FORMULAS: ClassVar = {"adams": 1, "bdf": 2}

    def __init__(self, *given: Any, method: str) -> None:
        self._method = self._FORMULAS[method]
        super().__init__(*given)

    def _create(self) -> int:
        return self._library.CVodeCreate(self._method, self._context)

    def _go_on(self, task: int) -> int:
        (s,) = self._state
        return self._library.CVode(self._memory, self._t_end, s, byref(self._t), task)
