"""IDA with residual and Jacobian in C: nothing of a solve runs in Python.

The equations are lowered to C (`integrators.lowering`), compiled, and called by IDA itself. Around
them stands a little C that counts the calls, ends the run at the limit of calls, and at a residual
that is not finite.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import byref, c_double, c_int64, c_long, c_void_p
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from integrators.adapters import dae
from integrators.adapters.callbacks import NOT_FINITE, EarlyEnd
from integrators.adapters.sundials import library
from integrators.contract import Work
from integrators.lowering.c_source import HEADER, c_function
from integrators.lowering.graph import NotLowered
from integrators.lowering.native import load
from integrators.lowering.programs import lowered
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    from jaxtyping import Float

_NORMAL, _ONE_STEP = 1, 2
_TOO_MUCH_WORK, _TSTOP_RETURN = -1, 1
_CSC = 0
#: After so many steps in one call Python looks for signals.
_STEPS_IN_A_CALL = 10_000
#: C and JAX differ by the rounding of sums: so much of the largest entry, times the length of sums.
_ROUNDING = 1e-12

_CALLED = """
typedef struct {
    const double *p;
    double *(*vector)(void *), *(*entries)(void *);
    index_t *(*rows)(void *), *(*starts)(void *);
    int64_t most, residuals, jacobians, ending;
} run_t;

int ida_residual(double t, void *w, void *wdot, void *r, void *user)
{
    run_t *run = user;
    if (run->residuals == run->most) {
        run->ending = 1;
        return -1;
    }
    run->residuals++;
    double *out = run->vector(r), sum = 0.0;
    residual(run->p, &t, run->vector(w), run->vector(wdot), out);
    for (int k = 0; k < SIZE; k++)
        sum += 0.0 * out[k]; /* NaN if an entry is not finite */
    run->ending = sum == 0.0 ? 0 : 2;
    return sum == 0.0 ? 0 : -1;
}

int ida_jacobian(double t, double cj, void *w, void *wdot, void *r, void *matrix, void *user,
                 void *x, void *y, void *z)
{
    run_t *run = user;
    run->jacobians++;
    jacobian(run->p, &t, run->vector(w), run->vector(wdot), &cj, run->entries(matrix));
#ifdef ENTRIES
    memcpy(run->rows(matrix), rows, sizeof rows);
    memcpy(run->starts(matrix), starts, sizeof starts);
#endif
    return 0;
}
"""


class _Run(ctypes.Structure):
    """run_t of the C above."""

    _fields_ = [
        ("p", c_void_p),
        *((name, c_void_p) for name in ("vector", "entries", "rows", "starts")),
        *((name, c_int64) for name in ("most", "residuals", "jacobians", "ending")),
    ]


class Compiled(NamedTuple):
    """Residual and Jacobian of a kind of scene in C.

    ``c`` has the functions; ``entries`` is the number of entries of a sparse Jacobian, else None.
    """

    c: ctypes.CDLL
    entries: int | None


class Solution(NamedTuple):
    """Where a whole solve ended: time, unknowns, IDA's flag and its counts of calls."""

    t: float
    y: Float[np.ndarray, " n"]
    status: int
    nfev: int
    njev: int


@cache
def compiled_equations(
    template: MechatronicSystem, formulation: str, sparse: bool
) -> Compiled | NotLowered:
    """Lower and compile residual and Jacobian, once for each kind of scene.

    Returns
    -------
    Compiled or NotLowered
        The reason if they have no form in C, there is no compiler, or SUNDIALS is not as known.
    """
    try:
        return _compiled_equations(template, formulation, sparse)
    except NotLowered as reason:
        return reason


def _compiled_equations(template: MechatronicSystem, formulation: str, sparse: bool) -> Compiled:
    _, lengths = dae.equations(template, formulation)
    residual = lowered(dae.packed_residual(template, formulation).program, lengths)
    n, about = lengths[-1], [f"typedef {library().index} index_t;"]
    if sparse:
        values, rows, starts = dae.sparse_jacobian(template, formulation)
        about.append(f"#define ENTRIES {len(rows)}")
        for name, numbers in (("rows", rows), ("starts", starts)):
            about.append(f"static const index_t {name}[] = {{{', '.join(map(str, numbers))}}};")
    else:
        values = dae.packed_jacobian(template, formulation)
    jacobian = lowered(values.program, (*lengths, None))
    source = "\n".join(
        [
            HEADER,
            f"#define SIZE {n}",
            *about,
            c_function("residual", residual, len(lengths)),
            c_function("jacobian", jacobian, len(lengths) + 1),
            _CALLED,
        ]
    )
    return Compiled(load(source), jacobian.results.size if sparse else None)


def check(
    compiled: Compiled, functions: tuple[Callable, Callable], p: np.ndarray, start: tuple
) -> None:
    """Compare the functions in C with those of JAX, near the start of a run.

    Parameters
    ----------
    functions
        Residual and Jacobian of JAX, bound to the parameters p.
    start
        t, w and wdot.

    Raises
    ------
    NotLowered
        If they differ.
    """
    t, *vectors = start
    shift = np.random.default_rng(0).uniform(-0.1, 0.1, (2, len(vectors[0])))
    for name, function, last in zip(("residual", "jacobian"), functions, ((), (3.0,)), strict=True):
        state = (t, *(v + d * (1 + abs(v)) for v, d in zip(vectors, shift, strict=True)), *last)
        right = np.asarray(function(*state))
        found = np.empty(right.size)
        evaluate(compiled, name, p, *state, out=found)
        scale = np.abs(right).max(initial=0.0)
        close = np.abs(found - right.ravel()) <= _ROUNDING * scale
        same = (found == right.ravel()) | (np.isnan(found) & np.isnan(right.ravel()))
        if not (close | same | ~np.isfinite(scale)).all():
            raise NotLowered(f"its {name} in C is not the one of JAX")


def evaluate(compiled: Compiled, name: str, *arguments: Any, out: np.ndarray) -> None:
    """Call the residual or the Jacobian of C: (p, t, w, wdot) or (p, t, w, wdot, cj)."""
    arrays = [np.ascontiguousarray(value, float) for value in (*arguments, out)]
    getattr(compiled.c, name)(*(c_void_p(array.ctypes.data) for array in arrays))


class NativeIDA:
    """A solver of IDA at the start of a run; its memory is freed by `close`.

    Attributes
    ----------
    w
        The unknowns where the solver is.
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
        (self._w, self.w), (self._wdot, _), (atol, _), (kinds, _) = self._vectors
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
        return Solution(self._t.value, self.w.copy(), flag, *counts)

    def step(self) -> tuple[int, float, np.ndarray]:
        """Take one step of IDA's own; return its flag, the time and the unknowns.

        Raises
        ------
        EarlyEnd
            If the calls are used up, or the residual is not finite.
        """
        return self._solve(_ONE_STEP), self._t.value, self.w.copy()

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
