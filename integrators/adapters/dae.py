"""The fully implicit DAE F(t, w, wdot) = 0 as solvers of other libraries want it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from integrators.adapters.callbacks import Packed
from problems.formulations import Layout, dae_layout, dae_residual
from problems.initial_values import consistent_start
from problems.runtime import jax, jnp
from problems.sparsity import Pattern
from problems.system import MechatronicSystem, Sizes

#: Absolute tolerance that takes a variable out of the error test: IDA's own switch for it
#: (suppressalg) is not reachable through the Python bindings, and others have none.
_NOT_TESTED = 1e6


class SparseJacobian(NamedTuple):
    """The entries of dF/dw + cj dF/dwdot as compressed columns.

    ``values(p, t, w, wdot, cj)``
        values of the entries, column by column
    ``rows``, ``starts``
        their rows, and where each column begins, ``(n + 1,)``; int32
    """

    values: Packed
    rows: np.ndarray
    starts: np.ndarray


@cache
def equations(
    template: MechatronicSystem, formulation: str
) -> tuple[Callable, tuple[int | None, ...]]:
    """F(p, t, w, wdot), traceable, for any parameter values p, an array; and the lengths of its
    arguments (None for the scalar)."""
    names, n = list(template.parameters()), dae_layout(template.sizes, formulation).size

    def residual(p: Any, t: Any, w: Any, wdot: Any) -> Any:
        scene = template.with_parameters(dict(zip(names, p, strict=True)))
        return dae_residual(scene, formulation, t, w, wdot)

    return residual, (len(names), None, n, n)


@cache
def packed_residual(template: MechatronicSystem, formulation: str) -> Packed:
    """F, compiled."""
    residual, lengths = equations(template, formulation)
    return Packed(residual, *lengths)


@cache
def packed_jacobian(template: MechatronicSystem, formulation: str) -> Packed:
    """dF/dw + cj dF/dwdot at (p, t, w, wdot, cj), compiled; transposed: directions give columns,
    and turning them inside costs as much as computing them."""
    residual, lengths = equations(template, formulation)

    def values(p: Any, t: Any, w: Any, wdot: Any, cj: Any) -> Any:
        function = _along(residual, p, t, w, wdot, cj)
        zero = jnp.zeros_like(w)
        return jax.vmap(lambda d: jax.jvp(function, (zero,), (d,))[1])(jnp.eye(len(w)))

    return Packed(values, *lengths, None)


@cache
def pattern(template: MechatronicSystem, formulation: str) -> Pattern:
    """Which entries dF/dw + cj dF/dwdot can have, found by following the program of F.

    Raises
    ------
    problems.sparsity.NoPattern
        If it cannot be followed.
    """
    residual, lengths = equations(template, formulation)
    p, n = jnp.array(list(template.parameters().values())), lengths[-1]
    # Whatever w, wdot and cj are, the pattern is the same; nothing that is known to be zero or
    # one may hide an entry.
    w, wdot = jnp.asarray(np.random.default_rng(0).uniform(0.5, 1.5, (2, n)))
    return Pattern(_along(residual, p, template.interval[0], w, wdot, 0.7), n)


@cache
def sparse_jacobian(template: MechatronicSystem, formulation: str) -> SparseJacobian:
    """dF/dw + cj dF/dwdot on its `pattern`."""
    residual, lengths = equations(template, formulation)
    found = pattern(template, formulation)
    order = np.lexsort((found.rows, found.columns))

    def values(p: Any, t: Any, w: Any, wdot: Any, cj: Any) -> Any:
        return found.values(_along(residual, p, t, w, wdot, cj), jnp.zeros(found.size))[order]

    starts = np.searchsorted(found.columns[order], np.arange(found.size + 1)).astype(np.int32)
    return SparseJacobian(Packed(values, *lengths, None), found.rows[order], starts)


def _along(residual: Callable, p: Any, t: Any, w: Any, wdot: Any, cj: Any) -> Callable:
    """F along w and wdot together: one sweep over n directions instead of two."""
    return lambda d: residual(p, t, w + d, wdot + cj * d)


def start_vectors(scene: MechatronicSystem, at: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Consistent w and wdot; the rates of lam, y and mu do not enter the equations."""
    start = consistent_start(scene)
    w, wdot = np.zeros(at.size), np.zeros(at.size)
    for name in ("q", "v", "x", "lam", "y"):
        w[getattr(at, name)] = getattr(start.z, name)
    wdot[at.q], wdot[at.v], wdot[at.x] = start.z.v, start.z.a, start.xdot
    return w, wdot


def absolute_tolerances(
    sizes: Sizes, formulation: str, atol: float, multipliers_tested: bool
) -> np.ndarray:
    """An atol for each entry of w, with which the multipliers are tested or not."""
    at = dae_layout(sizes, formulation)
    atols = np.full(at.size, atol)
    if not multipliers_tested:
        atols[at.lam] = atols[at.mu] = _NOT_TESTED
        if sizes.nl and formulation != "index1":
            atols[at.y] = _NOT_TESTED
    return atols
