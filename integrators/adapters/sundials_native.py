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

    Raises
    ------
    EarlyEnd
        If SUNDIALS refuses one of them, or has no memory.
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
        self._library, self._entries, self._t_end, self._p = library(), compiled.entries, t_end, p
        self._context, self._memory, self._t = c_void_p(), c_void_p(), c_double(start[0])
        self._vectors: list[int] = []
        self._matrix = self._solver = None
        self._run = _Run()
        try:
            self._set_up(compiled, start, options, max_calls)
        except BaseException:
            self.close()
            raise

    def _set_up(
        self, compiled: Compiled, start: tuple[Any, ...], options: dict[str, Any], max_calls: int
    ) -> None:
        it, (t0, *vectors) = self._library, start
        _look("SUNContext_Create", it.SUNContext_Create(0, byref(self._context)))
        # Flags say the same as its messages.
        _look("SUNContext_ClearErrHandlers", it.SUNContext_ClearErrHandlers(self._context))
        self._state = [self._vector(values) for values in vectors]
        unknowns = it.N_VGetArrayPointer(self._state[0])
        self._values = np.ctypeslib.as_array(unknowns, vectors[0].shape)
        self._linear_algebra(len(vectors[0]))
        self._memory.value = _made(f"{self._name}Create", self._create())
        kind = "Dense" if self._entries is None else "Sparse"
        self._run = _Run(
            self._p.ctypes.data,
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
        self._do("SetStopTime", self._t_end)

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
        it = self._library
        new = _made("N_VNew_Serial", it.N_VNew_Serial(len(values), self._context))
        self._vectors.append(new)
        np.ctypeslib.as_array(it.N_VGetArrayPointer(new), values.shape)[:] = values
        return new

    def _linear_algebra(self, n: int) -> None:
        it, context = self._library, self._context
        if self._entries is None:
            self._matrix = _made("SUNDenseMatrix", it.SUNDenseMatrix(n, n, context))
            solver = it.SUNLinSol_Dense(self._state[0], self._matrix, context)
            self._solver = _made("SUNLinSol_Dense", solver)
        else:
            matrix = it.SUNSparseMatrix(n, n, self._entries, _CSC, context)
            self._matrix = _made("SUNSparseMatrix", matrix)
            solver = it.SUNLinSol_SuperLUMT(self._state[0], self._matrix, 1, context)
            self._solver = _made("SUNLinSol_SuperLUMT", solver)

    def _solve(self, task: int) -> int:
        flag = self._go_on(task)
        if self._run.ending == 1:
            raise EarlyEnd("budget_exceeded", f"{self._run.most} calls were used up")
        if self._run.ending == 2:
            raise EarlyEnd("diverged", NOT_FINITE)
        return flag

    def _do(self, name: str, *arguments: Any) -> None:
        name = self._name + name
        _look(name, getattr(self._library, name)(self._memory, *arguments))

    def _count(self, name: str) -> int:
        number = c_long()
        self._do(f"GetNum{name}", byref(number))
        return number.value


def _look(name: str, flag: int) -> None:
    """End the run if a function of SUNDIALS failed."""
    if flag < 0:
        raise EarlyEnd("crashed", f"{name} of SUNDIALS returned the flag {flag}")


def _made(name: str, address: int | None) -> int:
    """Return the address of a thing that SUNDIALS made; the run ends if there is none."""
    if not address:
        raise EarlyEnd("crashed", f"{name} of SUNDIALS made nothing")
    return address


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
        self._differential, self._suppressed = differential, int(suppress_algebraic)
        super().__init__(*given)

    def _set_up(
        self, compiled: Compiled, start: tuple[Any, ...], options: dict[str, Any], max_calls: int
    ) -> None:
        super()._set_up(compiled, start, options, max_calls)
        self._do("SetId", self._vector(self._differential))
        self._do("SetSuppressAlg", self._suppressed)

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
