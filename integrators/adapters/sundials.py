"""IDA and CVODE of the SUNDIALS libraries inside scikit-sundae, without Python between.

scikit-sundae's own modules are linked to them, so that their functions are found through these,
whatever the files are called. Version, types and every function that is used are checked first.

Nothing of a solve runs in Python where equations have a form in C: a little C puts all arguments
side by side, counts the calls, ends the run at the limit of calls, and at a value that is not
finite. Where there is no compiler, or no form in C, functions of Python do the same.
"""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Callable, Iterator
from ctypes import CFUNCTYPE, POINTER, byref, c_char, c_double, c_int, c_int64, c_long, c_void_p
from functools import cache
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import numpy as np

from integrators.adapters.equations import GivenEquations, in_c
from integrators.adapters.library_runs import NOT_FINITE, EarlyEnd, LibraryRun, LibrarySolver
from integrators.contract import Work
from integrators.lowering.c_source import load_c
from integrators.program_costs import Algebra
from problems.base.spec import SpecError

#: The major release whose interface is written down here.
_MAJOR = 7
#: SUNDIALS' names of its index type.
_INDICES = {"int": ctypes.c_int32, "long int": ctypes.c_int64}
_FLOATS = POINTER(c_double)
_INDEX = "index"  # stands for the index type, which is known when the library is loaded
_SIGNATURES: dict[str, tuple[Any, ...]] = {
    # Result, arguments. Vectors, matrices and solvers are addresses.
    "SUNContext_Create": (c_int, c_int, POINTER(c_void_p)),
    "SUNContext_ClearErrHandlers": (c_int, c_void_p),
    "SUNContext_Free": (c_int, POINTER(c_void_p)),
    "N_VNew_Serial": (c_void_p, _INDEX, c_void_p),
    "N_VGetArrayPointer": (_FLOATS, c_void_p),
    "N_VDestroy": (None, c_void_p),
    "SUNDenseMatrix": (c_void_p, _INDEX, _INDEX, c_void_p),
    "SUNDenseMatrix_Data": (_FLOATS, c_void_p),
    "SUNSparseMatrix": (c_void_p, _INDEX, _INDEX, _INDEX, c_int, c_void_p),
    "SUNSparseMatrix_Data": (_FLOATS, c_void_p),
    "SUNSparseMatrix_IndexValues": (c_void_p, c_void_p),
    "SUNSparseMatrix_IndexPointers": (c_void_p, c_void_p),
    "SUNMatDestroy": (None, c_void_p),
    "SUNLinSol_Dense": (c_void_p, c_void_p, c_void_p, c_void_p),
    "SUNLinSol_SuperLUMT": (c_void_p, c_void_p, c_void_p, c_int, c_void_p),
    "SUNLinSolFree": (c_int, c_void_p),
    "IDACreate": (c_void_p, c_void_p),
    "IDAInit": (c_int, c_void_p, c_void_p, c_double, c_void_p, c_void_p),
    "IDASolve": (c_int, c_void_p, c_double, _FLOATS, c_void_p, c_void_p, c_int),
    "CVodeCreate": (c_void_p, c_int, c_void_p),
    "CVodeInit": (c_int, c_void_p, c_void_p, c_double, c_void_p),
    "CVode": (c_int, c_void_p, c_double, c_void_p, _FLOATS, c_int),
}
#: Functions of numbers of setups, error test failures, failed solves, and iterations.
_COUNTS = tuple(
    f"GetNum{what}"
    for what in ("LinSolvSetups", "ErrTestFails", "StepSolveFails", "NonlinSolvIters")
)
#: Functions that both solvers have, each with its own name before these.
_OF_BOTH: dict[str, tuple[Any, ...]] = {
    "SVtolerances": (c_int, c_void_p, c_double, c_void_p),
    "SetUserData": (c_int, c_void_p, c_void_p),
    "SetLinearSolver": (c_int, c_void_p, c_void_p, c_void_p),
    "SetJacFn": (c_int, c_void_p, c_void_p),
    "SetMaxOrd": (c_int, c_void_p, c_int),
    "SetMaxNumSteps": (c_int, c_void_p, c_long),
    "SetStopTime": (c_int, c_void_p, c_double),
    "GetLastOrder": (c_int, c_void_p, POINTER(c_int)),
    **dict.fromkeys(_COUNTS, (c_int, c_void_p, POINTER(c_long))),
    "Free": (None, POINTER(c_void_p)),
}
_SIGNATURES |= {
    solver + name: kinds for solver in ("IDA", "CVode") for name, kinds in _OF_BOTH.items()
}
_TOO_CLOSE = (
    "step_too_small",
    "the rest of the interval is as short as the rounding of the time",
    "choose another end of the interval, or events and samples farther apart",
)
#: Status, reason and perhaps remedy of the flags of IDA and CVODE; others that are negative crash.
_ENDINGS = {
    -1: ("budget_exceeded", "SUNDIALS' own limit of steps was reached"),
    -2: ("step_too_small", "rtol asks for more than round-off allows", "use a larger one"),
    -3: ("step_too_small", "the error test kept failing down to the smallest step"),
    -4: ("newton_failed", "Newton's method kept failing down to the smallest step"),
    -5: ("newton_failed", "the linear solver failed"),
    -6: ("newton_failed", "the Jacobian could not be factorised"),
    -7: ("newton_failed", "the linear solver failed"),
    -8: ("diverged", "the equations could not be evaluated"),
    -27: _TOO_CLOSE,  # of CVODE
    -60: _TOO_CLOSE,  # of IDA
}


@cache
def library() -> Any:
    """Return functions of SUNDIALS by their own names, and ``index``, its index type.

    A function but those of steps ends the run where it fails, or makes nothing.

    Raises
    ------
    SpecError
        If the libraries are not those that are known here.
    """
    try:
        kinds = dict(import_module("sksundae._cy_common").config)
        modules = (import_module(f"sksundae._cy_{solver}") for solver in ("ida", "cvode"))
        files = [ctypes.CDLL(module.__file__) for module in modules]
    except (ImportError, OSError, AttributeError) as error:
        raise SpecError(f"The libraries of scikit-sundae are not found ({error}).") from error
    number, label = c_int(), (c_char * 64)()
    rest = byref(c_int()), byref(c_int()), label, 64
    _function(files, "SUNDIALSGetVersionNumber")(byref(number), *rest)
    floats, whole = (str(kinds.get(f"SUNDIALS_{kind}_TYPE")) for kind in ("FLOAT", "INT"))
    if (number.value, floats) != (_MAJOR, "double") or whole not in _INDICES:
        raise SpecError(
            f"IDA and CVODE need SUNDIALS {_MAJOR} with 64-bit floats, and scikit-sundae has "
            f"SUNDIALS {number.value} of {floats} and {whole}."
        )
    index = _INDICES[whole]
    found = SimpleNamespace(index=index)
    for name, (result, *arguments) in _SIGNATURES.items():
        function = _function(files, name)
        function.restype = result
        function.argtypes = [index if kind is _INDEX else kind for kind in arguments]
        if name not in ("IDASolve", "CVode"):
            function.errcheck = _succeeded
        setattr(found, name, function)
    return found


def _function(files: list[ctypes.CDLL], name: str) -> Any:
    for one in files:
        if hasattr(one, name):
            return getattr(one, name)
    raise SpecError(f"SUNDIALS has no function {name}.")


def _succeeded(result: Any, function: Any, given: tuple) -> Any:
    """Return what a function of SUNDIALS gave; the run ends if it is a failure, or nothing."""
    failed = function.restype is c_void_p and not result
    if failed or (function.restype is c_int and result < 0):
        reason = f"{function.__name__} of SUNDIALS failed"
        raise EarlyEnd("crashed", reason, "use another method")
    return result


# ---- runs ------------------------------------------------------------------------------
_NORMAL, _ONE_STEP = 1, 2
_TOO_MUCH_WORK = -1
_CSC = 0
#: After so many steps in one call Python looks for signals.
_STEPS_IN_A_CALL = 10_000
_USED_UP, _NOT_FINITE = 1, 2
#: CVODE's numbers of its formulas.
_FORMULAS = {"adams": 1, "bdf": 2}
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
#: Arguments of residual and Jacobian beside t: IDA has w and wdot, and cj.
_TYPES = {
    "IDA": ([c_void_p] * 4, [c_double, *[c_void_p] * 8]),
    "CVode": ([c_void_p] * 3, [c_void_p] * 7),
}


class _Calls(ctypes.Structure):
    """run_t of the C: the equations, and counts of their calls."""

    _fields_ = [
        *((name, c_void_p) for name in ("residual", "jacobian", "numbers", "vector", "entries")),
        *((name, c_void_p) for name in ("rows", "starts", "row_numbers", "start_numbers")),
        *((name, c_int64) for name in ("parameters", "size", "row_bytes", "start_bytes")),
        *((name, c_int64) for name in ("most", "residuals", "jacobians", "ending")),
    ]


class SundialsRun(LibraryRun):
    """A run of a solver of SUNDIALS.

    Parameters
    ----------
    options
        ``rtol``, ``atol`` for each unknown, ``max_order``; of CVODE also ``method``: adams or bdf.

    Raises
    ------
    SpecError
        If the libraries are not those that are known.
    """

    def __init__(
        self,
        method: LibrarySolver,
        given: GivenEquations,
        t_end: float,
        algebra: Algebra,
        options: dict[str, Any],
    ) -> None:
        it, self.options = library(), options
        super().__init__(method, given, t_end, algebra)
        self._numbers = np.zeros(given.value.size + 1)
        self._numbers[: len(given.p)] = given.p
        self._indices = [np.ascontiguousarray(k, it.index) for k in given.sparsity or ([], [])]
        #: The function that gives the memory of a matrix.
        self._entries = it.SUNSparseMatrix_Data if given.sparsity else it.SUNDenseMatrix_Data
        rows, starts = it.SUNSparseMatrix_IndexValues, it.SUNSparseMatrix_IndexPointers
        self.calls = _Calls(
            *(0 if self.why else _address(in_c(of)[0]) for of in (given.value, given.jacobian)),
            self._numbers.ctypes.data,
            *map(_address, (it.N_VGetArrayPointer, self._entries, rows, starts)),
            *(numbers.ctypes.data for numbers in self._indices),
            len(given.p),
            given.size,
            *(numbers.nbytes for numbers in self._indices),
            method.max_calls,
        )

    @contextlib.contextmanager
    def _solver(self, counts: bool) -> Iterator[_Solver]:
        with contextlib.ExitStack() as memories:
            yield _Solver(self, memories)

    def callbacks(self, prefix: str, failed: list[BaseException]) -> list[Any]:
        """Residual and Jacobian as SUNDIALS calls them.

        Those of Python put an exception into the list, and end the solve.
        """
        if not self.why:
            called = load_c(_CALLED)
            return [getattr(called, f"{prefix}_{part}") for part in ("residual", "jacobian")]
        it, calls, given = library(), self.calls, self.given
        value, columns = self.functions
        vectors = len(given.start) - 1

        @cache
        def array(address: int) -> np.ndarray:
            return np.ctypeslib.as_array(it.N_VGetArrayPointer(address), (given.size,))

        def residual(t: float, *rest: int) -> int:
            *at, out, _ = rest
            if calls.residuals == calls.most:
                calls.ending = _USED_UP
                return -1
            calls.residuals += 1
            array(out)[:] = found = np.asarray(value(t, *map(array, at)))
            calls.ending = 0 if np.isfinite(found).all() else _NOT_FINITE
            return -1 if calls.ending else 0

        def jacobian(t: float, *rest: Any) -> int:
            *at, _, matrix, _, _, _, _ = rest
            calls.jacobians += 1
            at, factors = at[len(at) - vectors :], at[: len(at) - vectors]
            found = np.ravel(columns(t, *map(array, at), *factors))
            copied = [(self._entries(matrix), found)]
            if given.sparsity:
                rows, starts = self._indices
                copied += [(it.SUNSparseMatrix_IndexValues(matrix), rows)]
                copied += [(it.SUNSparseMatrix_IndexPointers(matrix), starts)]
            for place, numbers in copied:
                ctypes.memmove(place, numbers.ctypes.data, numbers.nbytes)
            return 0

        def guarded(function: Callable[..., int]) -> Callable[..., int]:
            def call(*arguments: Any) -> int:
                try:
                    return function(*arguments)
                except BaseException as error:  # which a function in C would lose
                    failed.append(error)
                    return -1

            return call

        pairs = zip((residual, jacobian), _TYPES[prefix], strict=True)
        return [CFUNCTYPE(c_int, c_double, *kinds)(guarded(function)) for function, kinds in pairs]

    def _rejected(self, status: str, work: Work) -> bool:
        # More than a Jacobian in each step.
        return status == "budget_exceeded" and (work.jacobians or 0) > (work.steps or 0)


class _Solver:
    """A solver of SUNDIALS at the start of a run, one at a time.

    Functions that free its memory are put into ``memories``.
    """

    complex_ones = 0, 0

    def __init__(self, run: SundialsRun, memories: contextlib.ExitStack) -> None:
        it, self._run, (t0, *vectors), options = library(), run, run.given.start, run.options
        self._library, self._memories, self._calls = it, memories, run.calls
        self._prefix = "CVode" if "method" in options else "IDA"
        self._t, self._t_end = c_double(t0), run.t_end
        self._context, self._memory = c_void_p(), c_void_p()
        self._calls.residuals = self._calls.jacobians = self._calls.ending = 0
        self._failed: list[BaseException] = []
        it.SUNContext_Create(0, byref(self._context))
        memories.callback(lambda: it.SUNContext_Free(byref(self._context)))
        it.SUNContext_ClearErrHandlers(self._context)  # flags say the same as its messages
        self._state = [self._vector(values) for values in vectors]
        self._values = np.ctypeslib.as_array(
            it.N_VGetArrayPointer(self._state[0]), vectors[0].shape
        )
        matrix, solver = self._linear_algebra(len(vectors[0]))
        formulas = [_FORMULAS[options["method"]]] if "method" in options else []
        self._memory.value = getattr(it, f"{self._prefix}Create")(*formulas, self._context)
        memories.callback(lambda: getattr(it, f"{self._prefix}Free")(byref(self._memory)))
        residual, jacobian = self._called = run.callbacks(self._prefix, self._failed)
        self._do("SetUserData", ctypes.addressof(run.calls))
        self._do("Init", _address(residual), t0, *self._state)
        self._do("SVtolerances", options["rtol"], self._vector(options["atol"]))
        self._do("SetLinearSolver", solver, matrix)
        self._do("SetJacFn", _address(jacobian))
        self._do("SetMaxOrd", options["max_order"])
        self._do("SetMaxNumSteps", _STEPS_IN_A_CALL)
        self._do("SetStopTime", self._t_end)

    def whole(self) -> tuple[float, np.ndarray]:
        """Solve to the end; the solver stops exactly there, so that nothing is interpolated."""
        while self._solve(_NORMAL) == _TOO_MUCH_WORK:
            pass
        return self._t.value, self._values.copy()

    def step(self) -> tuple[float, np.ndarray]:
        """Take one step of the solver's own; return the time and the unknowns."""
        self._solve(_ONE_STEP)
        return self._t.value, self._values.copy()

    @property
    def order(self) -> int:
        """The order of the last step."""
        return self._number("GetLastOrder", c_int())

    def work(self, steps: int) -> Work:
        """The counts of the run: steps, residuals and Jacobians by us, the others by SUNDIALS."""
        setups, errors, fails, newton = (self._number(name, c_long()) for name in _COUNTS)
        calls = self._calls.residuals, self._calls.jacobians
        return Work(steps, errors + fails, newton, *calls, setups, newton)

    def _vector(self, values: np.ndarray) -> int:
        """A new vector, whose memory is freed with that of the solver."""
        it = self._library
        new = it.N_VNew_Serial(len(values), self._context)
        self._memories.callback(lambda: it.N_VDestroy(new))
        np.ctypeslib.as_array(it.N_VGetArrayPointer(new), values.shape)[:] = values
        return new

    def _linear_algebra(self, n: int) -> tuple[int, int]:
        it, context, sparsity = self._library, self._context, self._run.given.sparsity
        if sparsity:
            matrix = it.SUNSparseMatrix(n, n, len(sparsity[0]), _CSC, context)
        else:
            matrix = it.SUNDenseMatrix(n, n, context)
        self._memories.callback(lambda: it.SUNMatDestroy(matrix))
        if sparsity:
            solver = it.SUNLinSol_SuperLUMT(self._state[0], matrix, 1, context)
        else:
            solver = it.SUNLinSol_Dense(self._state[0], matrix, context)

        @self._memories.callback
        def free() -> None:
            # SuperLU_MT's memory cannot be freed before its first factorisation (SUNDIALS 7.9).
            if not sparsity or self._calls.jacobians:
                it.SUNLinSolFree(solver)

        return matrix, solver

    def _solve(self, task: int) -> int:
        at, end = byref(self._t), self._t_end
        if self._prefix == "IDA":
            flag = self._library.IDASolve(self._memory, end, at, *self._state, task)
        else:
            flag = self._library.CVode(self._memory, end, *self._state, at, task)
        if self._failed:
            raise self._failed[0]
        if self._calls.ending == _USED_UP:
            raise EarlyEnd("budget_exceeded", f"the budget of {self._calls.most} calls is exceeded")
        if self._calls.ending == _NOT_FINITE:
            raise EarlyEnd("diverged", NOT_FINITE)
        if flag < 0 and (task == _ONE_STEP or flag != _TOO_MUCH_WORK):
            unknown = f"{self._prefix.upper()} gave up, and SUNDIALS does not tell why"
            crashed = "crashed", unknown, "use another rtol or another method"
            raise EarlyEnd(*_ENDINGS.get(flag, crashed))
        return flag

    def _do(self, name: str, *arguments: Any) -> None:
        getattr(self._library, self._prefix + name)(self._memory, *arguments)

    def _number(self, name: str, number: Any) -> int:
        self._do(name, byref(number))
        return number.value


def _address(function: Any) -> int:
    return ctypes.cast(function, c_void_p).value or 0
