"""The fully implicit DAE F(t, w, wdot) = 0, compiled for solvers of other libraries."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from integrators.adapters.callbacks import PackedFunction
from integrators.adapters.library_runs import GivenEquations
from integrators.adapters.trajectories import trajectory_from_states
from integrators.contract import Trajectory
from problems.base.runtime import jax, jnp
from problems.equations.formulations import dae_residual
from problems.equations.initial_values import consistent_start
from problems.equations.kinematics import q_rate
from problems.equations.layouts import Layout, dae_layout
from problems.equations.sparsity import Pattern
from problems.system import MechatronicSystem
from problems.variables import Sizes

if TYPE_CHECKING:
    from jaxtyping import Float, Int32

#: Absolute tolerance that takes a variable out of the error test, and of the test of convergence of
#: Newton's method. IDA's own switch (``suppress_algebraic``) keeps it in the latter; compiled
#: callbacks alone reach it, and other solvers have none.
_NOT_TESTED = 1e6


class SparseJacobian(NamedTuple):
    """The entries of dF/dw + cj dF/dwdot as compressed columns."""

    #: Values of the entries at (p, t, w, wdot, cj), column by column.
    values: PackedFunction
    #: Rows of the entries.
    rows: Int32[np.ndarray, " entries"]
    #: Number of the first entry of each column, and the number of entries at the end.
    starts: Int32[np.ndarray, " n+1"]


def given_dae(
    scene: MechatronicSystem,
    formulation: str,
    jacobian: PackedFunction,
    sparsity: tuple[Int32[np.ndarray, " entries"], Int32[np.ndarray, " n+1"]] | None = None,
) -> GivenEquations:
    """Return the residual of a scene's DAE and a Jacobian, and the consistent start.

    Parameters
    ----------
    sparsity
        Rows and starts of a sparse Jacobian.
    """
    layout = dae_layout(scene.sizes, formulation)
    p, start = np.array([*scene.parameters().values()]), start_vectors(scene, layout)

    def trajectory(t: np.ndarray, w: np.ndarray) -> Trajectory:
        """The solver's q, v, x, lam and y; a and xdot solve the equations of motion there."""
        found = trajectory_from_states(scene, t, w[:, layout.q], w[:, layout.v], w[:, layout.x])
        return replace(found, lam=w[:, layout.lam], y=w[:, layout.y])

    return GivenEquations(
        scene,
        packed_residual(scene.template(), formulation),
        jacobian,
        p,
        (scene.interval[0], *start),
        trajectory,
        sparsity,
    )


@cache
def packed_residual(template: MechatronicSystem, formulation: str) -> PackedFunction:
    """F(p, t, w, wdot), compiled; shape ``(n,)``.

    p is an array of the scene's parameters, w and wdot are laid out by `dae_layout`.
    """
    names, n = list(template.parameters()), dae_layout(template.sizes, formulation).size

    def residual(p: Any, t: Any, w: Any, wdot: Any) -> Any:
        scene = template.with_parameters(dict(zip(names, p, strict=True)))
        return dae_residual(scene, formulation, t, w, wdot)

    return PackedFunction(residual, len(names), None, n, n)


@cache
def packed_jacobian(template: MechatronicSystem, formulation: str) -> PackedFunction:
    """The transpose of dF/dw + cj dF/dwdot at (p, t, w, wdot, cj), compiled; shape ``(n, n)``.

    Directions give columns of the Jacobian; a transposition inside costs as much as the columns.
    """
    residual = packed_residual(template, formulation)

    def values(p: Any, t: Any, w: Any, wdot: Any, cj: Any) -> Any:
        function = _along(residual, p, t, w, wdot, cj)
        zero = jnp.zeros_like(w)
        return jax.vmap(lambda d: jax.jvp(function, (zero,), (d,))[1])(jnp.eye(len(w)))

    return PackedFunction(values, *residual.lengths, None)


@cache
def dae_pattern(template: MechatronicSystem, formulation: str) -> Pattern:
    """Find the entries of dF/dw + cj dF/dwdot that can differ from zero, by tracing F."""
    residual = packed_residual(template, formulation)
    n = dae_layout(template.sizes, formulation).size
    p = jnp.array(list(template.parameters().values()))
    # The pattern is the same for all w, wdot and cj; a zero or a one might hide an entry.
    w, wdot = jnp.asarray(np.random.default_rng(0).uniform(0.5, 1.5, (2, n)))
    return Pattern(_along(residual, p, template.interval[0], w, wdot, 0.7), n)


@cache
def sparse_jacobian(template: MechatronicSystem, formulation: str) -> SparseJacobian:
    """dF/dw + cj dF/dwdot on its `dae_pattern`."""
    residual, found = packed_residual(template, formulation), dae_pattern(template, formulation)
    order = np.lexsort((found.rows, found.columns))

    def values(p: Any, t: Any, w: Any, wdot: Any, cj: Any) -> Any:
        return found.values(_along(residual, p, t, w, wdot, cj), jnp.zeros(found.size))[order]

    starts = np.searchsorted(found.columns[order], np.arange(found.size + 1)).astype(np.int32)
    return SparseJacobian(
        PackedFunction(values, *residual.lengths, None), found.rows[order], starts
    )


def _along(
    residual: PackedFunction, p: Any, t: Any, w: Any, wdot: Any, cj: Any
) -> Callable[[Any], Any]:
    """F along w and wdot together: one sweep over n directions instead of two."""
    return lambda d: residual.function(p, t, w + d, wdot + cj * d)


def start_vectors(
    scene: MechatronicSystem, layout: Layout
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Consistent w and wdot; the rates of lam, y and mu are zero, as F does not depend on them."""
    start = consistent_start(scene)
    w, wdot = np.zeros(layout.size), np.zeros(layout.size)
    for name in ("q", "v", "x", "lam", "y"):
        w[getattr(layout, name)] = getattr(start.z, name)
    wdot[layout.q] = q_rate(scene, start.z.q, start.z.v)
    wdot[layout.v], wdot[layout.x] = start.z.a, start.xdot
    return w, wdot


def absolute_tolerances(
    sizes: Sizes, formulation: str, atol: float, multipliers_tested: bool
) -> Float[np.ndarray, " n"]:
    """An absolute tolerance for each entry of w, with the multipliers in the error test or not."""
    layout = dae_layout(sizes, formulation)
    atols = np.full(layout.size, atol)
    if not multipliers_tested:
        atols[layout.lam] = atols[layout.mu] = _NOT_TESTED
        if sizes.nl and formulation != "index1":
            atols[layout.y] = _NOT_TESTED
    return atols
