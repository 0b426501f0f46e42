"""Linear algebra for Newton's method in a step: small and dense, or sparse by KLU.

Full Newton takes each update by the tangent at the current unknowns (`once`). Modified Newton keeps
a tangent over iterations and steps: the dense solver keeps its inverse, the sparse one its
factorisation.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from integrators.lowering.graph import NotLowered
from integrators.native.algebra import klu, small_matrices
from integrators.native.algebra.fixed_elimination import EliminationPlan, planned
from integrators.native.algebra.jaxpr_tools import tangent_along, tangent_pattern, with_constants
from problems.base import runtime
from problems.base.runtime import Array, Bool, Float, Int, jax, jnp
from problems.equations.programs import part
from problems.equations.sparsity import Pattern

if TYPE_CHECKING:
    from jax.extend.core import ClosedJaxpr

Residual: TypeAlias = Callable[[Float[Array, " n"]], Float[Array, " n"]]


#: Most operations on arrays of all products with a tangent that are written out one by one, which
#: is faster than in a loop, but takes longer to compile.
_MOST_WRITTEN_OUT = 1000


class Once(NamedTuple):
    """An update by a tangent, and the number of eliminations in a fixed order that had to be
    repeated with pivots for it."""

    update: Float[Array, " n"]
    repeated: Int[Array, ""] | int = 0


class LinearSolver(ABC):
    """Updates of Newton's method from tangents; all functions can be traced."""

    @abstractmethod
    def once(self, residual: Residual, u: Float[Array, " n"]) -> Once:
        """The update by the tangent at u: tangent^-1 residual(u)."""

    def factorised(
        self, residual: Residual, u: Float[Array, " n"], kept: Array
    ) -> tuple[Array, Callable[[Float[Array, " n"]], Once]]:
        """The replacement of ``kept``, and the update by the tangent at u as a function of a
        right-hand side."""
        kept = self.renewed(residual, u, kept)

        def update(r: Array) -> Once:
            with part("solves"):
                return Once(self.update(kept, r))

        return kept, update

    @abstractmethod
    def nothing_kept(self, size: int) -> Array:
        """Placeholder for a kept tangent of ``size`` unknowns."""

    @abstractmethod
    def renewed(self, residual: Residual, u: Float[Array, " n"], kept: Array) -> Array:
        """The tangent at u in the form to keep; it replaces ``kept``."""

    @abstractmethod
    def update(self, kept: Array, r: Float[Array, " n"]) -> Float[Array, " n"]:
        """The update by a kept tangent, for a residual r."""

    @abstractmethod
    def known(self, kept: Array) -> Bool[Array, ""]:
        """True if ``kept`` holds a tangent, not the placeholder."""


@dataclass(frozen=True)
class DenseSolver(LinearSolver):
    """Small and full matrices; modified Newton keeps the inverse, at first a matrix of NaN.

    Full Newton reads the tangent's entries from the residual's program, takes them by a few
    products, and eliminates in an order that is fixed; full matrices are eliminated where a program
    cannot be followed.
    """

    def once(self, residual: Residual, u: Float[Array, " n"]) -> Once:
        program = jax.make_jaxpr(residual)(u)
        order = _order(program, len(u))

        if order is not None:
            r, products = _linearised(program, u, order.seeds)
            return Once(*order.solve(products, r))
        residual = partial(with_constants, program, program.consts)
        with part("Jacobians"):
            tangent = jax.jacfwd(residual)(u)
        with part("residuals"):
            r = residual(u)
        return Once(small_matrices.solve(tangent, r))

    def factorised(
        self, residual: Residual, u: Float[Array, " n"], kept: Array
    ) -> tuple[Array, Callable[[Float[Array, " n"]], Once]]:
        program = jax.make_jaxpr(residual)(u)
        order = _order(program, len(u))
        if order is None:
            return super().factorised(residual, u, kept)
        factors = order.factorised(_linearised(program, u, order.seeds)[1])
        return kept, lambda r: Once(*order.solve_by(factors, r))

    def nothing_kept(self, size: int) -> Array:
        return jnp.full((size, size), jnp.nan)

    def renewed(self, residual: Residual, u: Float[Array, " n"], kept: Array) -> Array:
        with part("Jacobians"):
            tangent = full_tangent(residual, u)
        return small_matrices.inverse(tangent)

    def update(self, kept: Array, r: Float[Array, " n"]) -> Float[Array, " n"]:
        return small_matrices.product(kept, r)

    def known(self, kept: Array) -> Bool[Array, ""]:
        return ~jnp.isnan(kept[0, 0])


DENSE = DenseSolver()


def _order(program: ClosedJaxpr, n: int) -> EliminationPlan | None:
    """Order of the elimination; None for full matrices."""
    if not 0 < n <= small_matrices.MOST:
        return None
    try:
        return planned(tangent_pattern(program, n))
    except NotLowered as error:
        runtime.slower(f"Full Newton runs slowly: programs cannot be followed ({error}).")
        return None


def _linearised(
    program: ClosedJaxpr, u: Float[Array, " n"], seeds: Float[np.ndarray, "colours n"]
) -> tuple[Float[Array, " n"], list[Float[Array, " n"]]]:
    """The residual of a program at u, and the products of its tangent with the seeds."""
    residual = partial(with_constants, program, program.consts)
    if _is_dear(program, len(seeds)):
        with part("residuals"):
            r = residual(u)
        with part("Jacobians"):
            return r, tangent_along(residual, u, seeds)
    with part("residuals"):
        r, product = small_matrices.linearised(residual, u)
    with part("Jacobians"):
        return r, [product(jnp.asarray(seed)) for seed in seeds]


def full_tangent(residual: Residual, u: Float[Array, " n"]) -> Float[Array, "m n"]:
    """The tangent of a residual at u: all columns side by side, or in loops where that is dear."""
    program = jax.make_jaxpr(residual)(u)
    residual = partial(with_constants, program, program.consts)
    if _is_dear(program, len(u)):
        return jnp.stack(tangent_along(residual, u, np.eye(len(u))), axis=1)
    return jax.jacfwd(residual)(u)


def _is_dear(program: ClosedJaxpr, products: int) -> bool:
    """Whether products with the tangent of a program are too many to be written out."""
    return products * small_matrices.size(program) > _MOST_WRITTEN_OUT


@dataclass(frozen=True)
class SparseSolver(LinearSolver):
    """KLU on a known pattern; modified Newton keeps the address of a factorisation, zero for none.

    A new tangent takes a few Jacobian-vector products, one per colour of the pattern, and one
    factorisation with pivots of its own.
    """

    pattern: Pattern
    analysis: klu.Analysis

    def once(self, residual: Residual, u: Float[Array, " n"]) -> Once:
        with part("residuals"):
            r = residual(u)
        entries = self._entries(residual, u)
        with part("factorisations"):
            return Once(klu.solve_once(self.analysis, entries, r))

    def nothing_kept(self, size: int) -> Array:
        return klu.none()

    def renewed(self, residual: Residual, u: Float[Array, " n"], kept: Array) -> Array:
        entries = self._entries(residual, u)
        with part("factorisations"):
            return klu.factorised(self.analysis, entries, instead_of=kept)

    def update(self, kept: Array, r: Float[Array, " n"]) -> Float[Array, " n"]:
        return klu.solve_by(kept, self.analysis, r)

    def known(self, kept: Array) -> Bool[Array, ""]:
        return kept[0] > 0

    def _entries(self, residual: Residual, u: Float[Array, " n"]) -> Float[Array, " e"]:
        with part("Jacobians"):
            return self.pattern.values(residual, u)


#: Unknowns of all stages to a function: slope in steps to the tangent of a stage.
TangentsBySlope: TypeAlias = Callable[[Array], Callable[[complex], Array]]


class StageTangents(LinearSolver):
    """Tangents of s coupled stages: one real and one complex matrix in the place of a large one.

    The stages of an implicit Runge-Kutta method are coupled by its matrix A alone if all of them
    take their tangent at one point. With A = T diag(theta) T^-1 the transformed stages are
    decoupled: the k-th is a single stage of slope theta_k h (Butcher 1976, doi:10.1007/BF01931672;
    Bickart 1977, doi:10.1137/0714068). Complex slopes come in conjugate pairs, and one of each is
    enough. With three stages of n unknowns this takes 2/3 n^3 (1 + 4) operations instead of
    2/3 n^3 27. An inverse is kept for each slope.

    Unknowns are ordered component by component, residuals stage by stage.

    Parameters
    ----------
    a
        The method's matrix A.
    tangents
        From unknowns of all stages, the function that gives a single stage's tangent by its slope.
    """

    def __init__(self, a: np.ndarray, tangents: TangentsBySlope) -> None:
        slopes, columns = np.linalg.eig(a)
        rows = np.linalg.inv(columns)
        self.stages, self._tangents = len(a), tangents
        #: Slope, column of T and row of T^-1 of each transformed stage.
        self._modes = [
            (complex(z), 2 * columns[:, k], rows[k])
            if z.imag
            else (float(z.real), np.real(columns[:, k]), np.real(rows[k]))
            for k, z in enumerate(slopes)
            if z.imag >= 0
        ]

    def once(self, residual: Residual, u: Float[Array, " n"]) -> Once:
        return Once(self.update(self.renewed(residual, u, None), residual(u)))

    def nothing_kept(self, size: int) -> Any:
        n = size // self.stages
        return tuple(jnp.full((n, n), jnp.nan * slope) for slope, *_ in self._modes)

    def renewed(self, residual: Residual, u: Float[Array, " n"], kept: Any) -> Any:
        tangent = self._tangents(u)
        return tuple(small_matrices.inverse(tangent(slope)) for slope, *_ in self._modes)

    def update(self, kept: Any, r: Float[Array, " n"]) -> Float[Array, " n"]:
        r, du = r.reshape(self.stages, -1), jnp.zeros((len(r) // self.stages, self.stages))
        for inverse, (_, column, row) in zip(kept, self._modes, strict=True):
            one = small_matrices.product(inverse, row @ r)
            du = du + jnp.real(one[:, None] * column)
        return du.ravel()

    def known(self, kept: Any) -> Bool[Array, ""]:
        return ~jnp.isnan(kept[0][0, 0])
