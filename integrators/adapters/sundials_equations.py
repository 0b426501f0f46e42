"""The equations of a scene and their Jacobian in C, as IDA and CVODE call them.

They are lowered from the traced equations (`integrators.lowering`). Around them stands a little C
that counts the calls, ends the run at the limit of calls, and at a value that is not finite.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import c_void_p
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from integrators.adapters.callbacks import PackedFunction
from integrators.adapters.called_in_c import compare
from integrators.adapters.sundials import library
from integrators.lowering.c_source import HEADER, c_function
from integrators.lowering.graph import NotLowered
from integrators.lowering.native import load
from integrators.lowering.programs import lowered

if TYPE_CHECKING:
    from jaxtyping import Int32

_CALLED = """
typedef struct {
    const double *p;
    double *(*vector)(void *), *(*entries)(void *);
    index_t *(*rows)(void *), *(*starts)(void *);
    int64_t most, residuals, jacobians, ending;
} run_t;

static int used_up(run_t *run)
{
    if (run->residuals == run->most) {
        run->ending = 1;
        return 1;
    }
    run->residuals++;
    return 0;
}

static int not_finite(run_t *run, const double *out)
{
    double sum = 0.0;
    for (int k = 0; k < SIZE; k++)
        sum += 0.0 * out[k]; /* NaN if an entry is not finite */
    run->ending = sum == 0.0 ? 0 : 2;
    return sum == 0.0 ? 0 : -1;
}

static double *entries(run_t *run, void *matrix)
{
    run->jacobians++;
#ifdef ENTRIES
    memcpy(run->rows(matrix), rows, sizeof rows);
    memcpy(run->starts(matrix), starts, sizeof starts);
#endif
    return run->entries(matrix);
}
"""
#: The functions whose addresses a solver is given.
_CALLED_BY = {
    "IDA": """
int called_residual(double t, void *w, void *wdot, void *r, void *user)
{
    run_t *run = user;
    if (used_up(run))
        return -1;
    double *out = run->vector(r);
    residual(run->p, &t, run->vector(w), run->vector(wdot), out);
    return not_finite(run, out);
}

int called_jacobian(double t, double cj, void *w, void *wdot, void *r, void *matrix, void *user,
                    void *x, void *y, void *z)
{
    run_t *run = user;
    jacobian(run->p, &t, run->vector(w), run->vector(wdot), &cj, entries(run, matrix));
    return 0;
}
""",
    "CVode": """
int called_residual(double t, void *s, void *rate, void *user)
{
    run_t *run = user;
    if (used_up(run))
        return -1;
    double *out = run->vector(rate);
    residual(run->p, &t, run->vector(s), out);
    return not_finite(run, out);
}

int called_jacobian(double t, void *s, void *rate, void *matrix, void *user, void *x, void *y,
                    void *z)
{
    run_t *run = user;
    jacobian(run->p, &t, run->vector(s), entries(run, matrix));
    return 0;
}
""",
}


@dataclass(frozen=True, eq=False)
class Equations:
    """The functions that a solver of SUNDIALS calls; one object for each kind of scene.

    Parameters
    ----------
    solver
        How SUNDIALS begins the names of the solver's functions: IDA or CVode.
    residual
        The residual of IDA or the right-hand side of CVODE, of (p, t, ...).
    jacobian
        The transpose of the Jacobian, or its entries as compressed columns; IDA adds the argument
        cj.
    rows, starts
        Rows of the entries, and the number of the first one of each column; None if dense.
    """

    solver: str
    residual: PackedFunction
    jacobian: PackedFunction
    rows: Int32[np.ndarray, " entries"] | None = None
    starts: Int32[np.ndarray, " n+1"] | None = None

    @property
    def size(self) -> int:
        """The number of equations."""
        return self.residual.lengths[-1] or 0

    @property
    def factors(self) -> tuple[float, ...]:
        """A value for cj, if the Jacobian has this argument."""
        return (3.0,) * (len(self.jacobian.lengths) - len(self.residual.lengths))


class Compiled(NamedTuple):
    """Residual and Jacobian of a kind of scene in C.

    ``c`` has the functions; ``entries`` is the number of entries of a sparse Jacobian, else None.
    """

    c: ctypes.CDLL
    entries: int | None


@cache
def compiled_equations(equations: Equations) -> Compiled | NotLowered:
    """Lower and compile residual and Jacobian, once for each kind of scene.

    Returns
    -------
    Compiled or NotLowered
        The reason if they have no form in C, there is no compiler, or SUNDIALS is not as known.
    """
    try:
        return _compiled_equations(equations)
    except NotLowered as reason:
        return NotLowered(str(reason))  # without what the first one holds in memory


def _compiled_equations(equations: Equations) -> Compiled:
    about, functions = [f"typedef {library().index} index_t;"], []
    for name in ("rows", "starts"):
        numbers = getattr(equations, name)
        if numbers is not None:
            about.append(f"static const index_t {name}[] = {{{', '.join(map(str, numbers))}}};")
    for name in ("residual", "jacobian"):
        packed = getattr(equations, name)
        program = lowered(packed.program, packed.lengths)
        functions.append(c_function(name, program, len(packed.lengths)))
    entries = None if equations.rows is None else len(equations.rows)
    if entries is not None:
        about.append(f"#define ENTRIES {entries}")
    called = _CALLED, _CALLED_BY[equations.solver]
    source = [HEADER, f"#define SIZE {equations.size}", *about, *functions, *called]
    return Compiled(load("\n".join(source)), entries)


def check(
    compiled: Compiled,
    equations: Equations,
    functions: tuple[Callable, Callable],
    p: np.ndarray,
    start: tuple,
) -> None:
    """Compare the functions in C with those of JAX.

    Parameters
    ----------
    functions
        Residual and Jacobian of JAX, bound to the parameters p.
    start
        t and the vectors.

    Raises
    ------
    NotLowered
        If they differ.
    """
    each = np.arange(equations.size)
    rows = np.tile(each, len(each)) if equations.rows is None else equations.rows
    for name, theirs, of, factors in (
        ("residual", functions[0], each, ()),
        ("jacobian", functions[1], rows, equations.factors),
    ):

        def ours(*state: Any, name: str = name, size: int = len(of)) -> np.ndarray:
            found = np.empty(size)
            evaluate(compiled, name, p, *state, out=found)
            return found

        if not compare(ours, theirs, start, of, *factors):
            raise NotLowered(f"its {name} in C is not the one of JAX")


def evaluate(compiled: Compiled, name: str, *arguments: Any, out: np.ndarray) -> None:
    """Call the residual or the Jacobian of C with the arguments of those of JAX."""
    arrays = [np.ascontiguousarray(value, float) for value in (*arguments, out)]
    getattr(compiled.c, name)(*(c_void_p(array.ctypes.data) for array in arrays))
