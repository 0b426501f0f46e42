"""Residual and Jacobian of a scene in C, as IDA calls them.

They are lowered from the traced equations (`integrators.lowering`). Around them stands a little C
that counts the calls, ends the run at the limit of calls, and at a residual that is not finite.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import c_void_p
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from integrators.adapters import dae
from integrators.adapters.sundials import library
from integrators.lowering.c_source import HEADER, c_function
from integrators.lowering.graph import NotLowered
from integrators.lowering.native import load
from integrators.lowering.programs import lowered
from problems.system import MechatronicSystem

#: C and JAX may differ by so much of the largest entry, as both round.
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


class Compiled(NamedTuple):
    """Residual and Jacobian of a kind of scene in C.

    ``c`` has the functions; ``entries`` is the number of entries of a sparse Jacobian, else None.
    """

    c: ctypes.CDLL
    entries: int | None


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
