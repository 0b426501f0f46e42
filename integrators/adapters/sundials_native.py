"""IDA and CVODE with their equations in C: nothing of a solve runs in Python.

Between them and a scene's equations stands a little C that puts all arguments side by side, counts
the calls, ends the run at the limit of calls, and at a value that is not finite.
"""

from __future__ import annotations

import contextlib
import ctypes
from abc import ABC, abstractmethod
from ctypes import byref, c_double, c_int, c_int64, c_long, c_void_p
from typing import Any, ClassVar, NamedTuple

import numpy as np

from integrators.adapters.callbacks import in_c
from integrators.adapters.library_runs import NOT_FINITE, EarlyEnd, GivenEquations
from integrators.adapters.sundials import check_step, library
from integrators.contract import Work
from integrators.lowering.native import load_c
from problems.base.runtime import Float

_NORMAL, _ONE_STEP = 1, 2
_TOO_MUCH_WORK = -1
_CSC = 0
#: After so many steps in one call Python looks for signals.
_STEPS_IN_A_CALL = 10_000
_USED_UP, _NOT_FINITE = 1, 2
_CALLED = """
#include <stdint.h>
#include <string.h>

typedef struct {
    void (*residual)(const double *, double *), (*jacobian)(const double *, double *);
    double *numbers, *(*vector)(void *), *(*entries)(void *);
    void *(*rows)(void *), *(*starts)(void *);
    const void *row_numbers, *start_numbers;
    int64_t parameters, size, row_bytes, start_bytes, most, residuals, jacobians, ending;
} run_t;

/* Parameters, t, vectors and cj side by side. */
static const double *packed(run_t *run, double t, void *w, void *wdot, double cj)
{
    double *at = run->numbers + run->parameters;
    *at++ = t;
    memcpy(at, run->vector(w), run->size * sizeof(double));
    at += run->size;
    if (wdot) {
        memcpy(at, run->vector(wdot), run->size * sizeof(double));
        at[run->size] = cj;
    }
    return run->numbers;
}

static int residual(run_t *run, double t, void *w, void *wdot, void *r)
{
    if (run->residuals == run->most) {
        run->ending = 1;
        return -1;
    }
    run->residuals++;
    double *out = run->vector(r), sum = 0.0;
    run->residual(packed(run, t, w, wdot, 0.0), out);
    for (int64_t k = 0; k < run->size; k++)
        sum += 0.0 * out[k]; /* NaN if an entry is not finite */
    run->ending = sum == 0.0 ? 0 : 2;
    return sum == 0.0 ? 0 : -1;
}

static int jacobian(run_t *run, double t, void *w, void *wdot, double cj, void *matrix)
{
    run->jacobians++;
    if (run->row_bytes) {
        memcpy(run->rows(matrix), run->row_numbers, run->row_bytes);
        memcpy(run->starts(matrix), run->start_numbers, run->start_bytes);
    }
    run->jacobian(packed(run, t, w, wdot, cj), run->entries(matrix));
    return 0;
}

int IDA_residual(double t, void *w, void *wdot, void *r, void *run)
{
    return residual(run, t, w, wdot, r);
}

int IDA_jacobian(double t, double cj, void *w, void *wdot, void *r, void *matrix, void *run,
                 void *x, void *y, void *z)
{
    return jacobian(run, t, w, wdot, cj, matrix);
}

int CVode_residual(double t, void *s, void *rate, void *run)
{
    return residual(run, t, s, 0, rate);
}

int CVode_jacobian(double t, void *s, void *rate, void *matrix, void *run, void *x, void *y,
                   void *z)
{
    return jacobian(run, t, s, 0, 0.0, matrix);
}
"""


class NativeEquations(ctypes.Structure):
    """run_t of the C: equations that have a form in C, and counts of their calls.

    Parameters
    ----------
    given
        The equations.
    max_calls
        After so many residual calls a run ends as budget_exceeded.
    """

    _fields_ = [
        *((name, c_void_p) for name in ("residual", "jacobian", "numbers", "vector", "entries")),
        *((name, c_void_p) for name in ("rows", "starts", "row_numbers", "start_numbers")),
        *((name, c_int64) for name in ("parameters", "size", "row_bytes", "start_bytes")),
        *((name, c_int64) for name in ("most", "residuals", "jacobians", "ending")),
    ]

    def __init__(self, given: GivenEquations, max_calls: int) -> None:
        it, self.given = library(), given
        self._numbers = np.zeros(given.value.size + 1)
        self._numbers[: len(given.p)] = given.p
        kind = "Sparse" if given.sparsity else "Dense"
        self._indices = [np.ascontiguousarray(k, it.index) for k in given.sparsity or ([], [])]
        super().__init__(
            *(_address(in_c(packed)[0]) for packed in (given.value, given.jacobian)),
            self._numbers.ctypes.data,
            it.address("N_VGetArrayPointer"),
            it.address(f"SUN{kind}Matrix_Data"),
            it.address("SUNSparseMatrix_IndexValues"),
            it.address("SUNSparseMatrix_IndexPointers"),
            *(numbers.ctypes.data for numbers in self._indices),
            len(given.p),
            given.size,
            *(numbers.nbytes for numbers in self._indices),
            max_calls,
        )


class NativeSolution(NamedTuple):
    """The end of a whole solve: time, unknowns, and the solver's counts of calls."""

    t: float
    y: Float[np.ndarray, " n"]
    nfev: int
    njev: int


class NativeSolver(ABC):
    """A solver of SUNDIALS at the start of a run; its memory is freed by `close`.

    Parameters
    ----------
    equations
        Equations, of which one solver at a time makes use.
    options
        ``rtol``, ``atol`` for each unknown, and ``max_order``.

    Raises
    ------
    EarlyEnd
        If SUNDIALS refuses one of them, or has no memory.
    """

    #: How the names of its functions begin, and the name of its count of residual calls.
    _name: ClassVar[str]
    _calls: ClassVar[str]

    def __init__(self, equations: NativeEquations, t_end: float, options: dict[str, Any]) -> None:
        self._library, self._equations, self._given = library(), equations, equations.given
        self._t, self._t_end = c_double(self._given.start[0]), t_end
        self._context, self._memory = c_void_p(), c_void_p()
        equations.residuals = equations.jacobians = equations.ending = 0
        #: Functions that free all memory, the last one first.
        self._memories = contextlib.ExitStack()
        try:
            self._set_up(options)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Free all memory of the solver."""
        self._memories.close()

    def _set_up(self, options: dict[str, Any]) -> None:
        it, (t0, *vectors) = self._library, self._given.start
        _look("SUNContext_Create", it.SUNContext_Create(0, byref(self._context)))
        self._memories.callback(lambda: it.SUNContext_Free(byref(self._context)))
        # Flags say the same as its messages.
        _look("SUNContext_ClearErrHandlers", it.SUNContext_ClearErrHandlers(self._context))
        self._state = [self._vector(values) for values in vectors]
        unknowns = it.N_VGetArrayPointer(self._state[0])
        self._values = np.ctypeslib.as_array(unknowns, vectors[0].shape)
        matrix, solver = self._linear_algebra(len(vectors[0]))
        self._memory.value = _made(f"{self._name}Create", self._create(options))
        self._memories.callback(lambda: getattr(it, f"{self._name}Free")(byref(self._memory)))
        functions = load_c(_CALLED)
        self._do("SetUserData", c_void_p(ctypes.addressof(self._equations)))
        self._do("Init", _address(getattr(functions, f"{self._name}_residual")), t0, *self._state)
        self._do("SVtolerances", options["rtol"], self._vector(options["atol"]))
        self._do("SetLinearSolver", solver, matrix)
        self._do("SetJacFn", _address(getattr(functions, f"{self._name}_jacobian")))
        self._do("SetMaxOrd", options["max_order"])
        self._do("SetMaxNumSteps", _STEPS_IN_A_CALL)
        self._do("SetStopTime", self._t_end)

    @abstractmethod
    def _create(self, options: dict[str, Any]) -> int:
        """New memory of the solver."""

    @abstractmethod
    def _go_on(self, task: int) -> int:
        """Call the solver; return its flag."""

    def whole(self) -> NativeSolution:
        """Solve to the end; the solver stops exactly there, so that nothing is interpolated."""
        while self._solve(_NORMAL) == _TOO_MUCH_WORK:
            pass
        counts = (self._count(name) for name in (self._calls, "JacEvals"))
        return NativeSolution(self._t.value, self._values.copy(), *counts)

    def step(self) -> tuple[float, np.ndarray]:
        """Take one step of the solver's own; return the time and the unknowns."""
        self._solve(_ONE_STEP)
        return self._t.value, self._values.copy()

    @property
    def order(self) -> int:
        """The order of the last step."""
        number = c_int()
        self._do("GetLastOrder", byref(number))
        return number.value

    def work(self, steps: int) -> Work:
        """The counts of the run: steps, residuals and Jacobians by us, the others by SUNDIALS."""
        newton = self._count("NonlinSolvIters")
        return Work(
            steps=steps,
            rejected=self._count("ErrTestFails") + self._count("StepSolveFails"),
            newton=newton,
            residuals=self._equations.residuals,
            jacobians=self._equations.jacobians,
            factorisations=self._count("LinSolvSetups"),
            solves=newton,
        )

    def _vector(self, values: np.ndarray) -> int:
        """A new vector, whose memory is freed with that of the solver."""
        it = self._library
        new = _made("N_VNew_Serial", it.N_VNew_Serial(len(values), self._context))
        self._memories.callback(lambda: it.N_VDestroy(new))
        np.ctypeslib.as_array(it.N_VGetArrayPointer(new), values.shape)[:] = values
        return new

    def _linear_algebra(self, n: int) -> tuple[int, int]:
        """A new matrix and a new linear solver."""
        it, context, sparsity = self._library, self._context, self._given.sparsity
        if sparsity:
            entries = len(sparsity[0])
            matrix = _made("SUNSparseMatrix", it.SUNSparseMatrix(n, n, entries, _CSC, context))
        else:
            matrix = _made("SUNDenseMatrix", it.SUNDenseMatrix(n, n, context))
        self._memories.callback(lambda: it.SUNMatDestroy(matrix))
        if sparsity:
            solver = it.SUNLinSol_SuperLUMT(self._state[0], matrix, 1, context)
        else:
            solver = it.SUNLinSol_Dense(self._state[0], matrix, context)
        solver = _made("SUNLinSol_SuperLUMT" if sparsity else "SUNLinSol_Dense", solver)

        @self._memories.callback
        def free() -> None:
            # SuperLU_MT's memory cannot be freed before its first factorisation (SUNDIALS 7.9).
            if not sparsity or self._equations.jacobians:
                it.SUNLinSolFree(solver)

        return matrix, solver

    def _solve(self, task: int) -> int:
        flag = self._go_on(task)
        if self._equations.ending == _USED_UP:
            raise EarlyEnd("budget_exceeded", f"{self._equations.most} calls were used up")
        if self._equations.ending == _NOT_FINITE:
            raise EarlyEnd("diverged", NOT_FINITE)
        if task == _ONE_STEP or flag != _TOO_MUCH_WORK:
            check_step(self._name.upper(), flag)
        return flag

    def _do(self, name: str, *arguments: Any) -> None:
        name = self._name + name
        _look(name, getattr(self._library, name)(self._memory, *arguments))

    def _count(self, name: str) -> int:
        number = c_long()
        self._do(f"GetNum{name}", byref(number))
        return number.value


def _address(function: Any) -> int:
    """The address of a function in C."""
    return ctypes.cast(function, c_void_p).value or 0


def _look(name: str, flag: int) -> None:
    """End the run if a function of SUNDIALS failed."""
    if flag < 0:
        raise EarlyEnd("crashed", f"{name} of SUNDIALS failed", "use callbacks=python")


def _made(name: str, address: int | None) -> int:
    """Return the address of a thing that SUNDIALS made; the run ends if there is none."""
    if not address:
        raise EarlyEnd("crashed", f"{name} of SUNDIALS made nothing", "use callbacks=python")
    return address


class NativeIDA(NativeSolver):
    """IDA at the start of a run.

    Further options are ``differential``, 1 for unknowns whose derivatives are in the equations and
    else 0, and ``suppress_algebraic``: whether the error test leaves the others out.
    """

    _name, _calls = "IDA", "ResEvals"

    def _set_up(self, options: dict[str, Any]) -> None:
        super()._set_up(options)
        self._do("SetId", self._vector(options["differential"]))
        self._do("SetSuppressAlg", int(options["suppress_algebraic"]))

    def _create(self, options: dict[str, Any]) -> int:
        return self._library.IDACreate(self._context)

    def _go_on(self, task: int) -> int:
        at = byref(self._t)
        return self._library.IDASolve(self._memory, self._t_end, at, *self._state, task)


class NativeCVODE(NativeSolver):
    """CVODE at the start of a run, with the formulas of the option ``method``: adams or bdf."""

    _name, _calls = "CVode", "RhsEvals"

    def _create(self, options: dict[str, Any]) -> int:
        formulas = {"adams": 1, "bdf": 2}[options["method"]]
        return self._library.CVodeCreate(formulas, self._context)

    def _go_on(self, task: int) -> int:
        (s,) = self._state
        return self._library.CVode(self._memory, self._t_end, s, byref(self._t), task)
