"""Linear algebra for Newton's method in a step: dense, or sparse by KLU.

Full Newton takes each update by the tangent at the current unknowns (`once`). Modified Newton keeps
a tangent over iterations and steps: the dense solver keeps its inverse, the sparse one its
factorisation.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from integrators.native import klu, small_matrices
from problems.runtime import jax, jnp
from problems.sparsity import Pattern

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Bool, Float

    Residual: TypeAlias = Callable[[Float[Array, " n"]], Float[Array, " n"]]


class LinearSolver(ABC):
    """Updates of Newton's method from tangents; all functions can be traced."""

    @abstractmethod
    def once(self, residual: Residual, u: Float[Array, " n"]) -> Float[Array, " n"]:
        """The update by the tangent at u: tangent^-1 residual(u)."""

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


class DenseSolver(LinearSolver):
    """Full matrices; modified Newton keeps the inverse, at first a matrix of NaN."""

    def once(self, residual: Residual, u: Float[Array, " n"]) -> Float[Array, " n"]:
        return small_matrices.solve(jax.jacfwd(residual)(u), residual(u))

    def nothing_kept(self, size: int) -> Array:
        return jnp.full((size, size), jnp.nan)

    def renewed(self, residual: Residual, u: Float[Array, " n"], kept: Array) -> Array:
        return small_matrices.inverse(jax.jacfwd(residual)(u))

    def update(self, kept: Array, r: Float[Array, " n"]) -> Float[Array, " n"]:
        return small_matrices.product(kept, r)

    def known(self, kept: Array) -> Bool[Array, ""]:
        return ~jnp.isnan(kept[0, 0])


DENSE = DenseSolver()


@dataclass(frozen=True)
class SparseSolver(LinearSolver):
    """KLU on a known pattern; modified Newton keeps the address of a factorisation, zero for none.

    A new tangent takes a few Jacobian-vector products, one per colour of the pattern, and one
    factorisation with pivots of its own.
    """

    pattern: Pattern
    analysis: klu.Analysis

    def once(self, residual: Residual, u: Float[Array, " n"]) -> Float[Array, " n"]:
        return klu.solve(self.analysis, self.pattern.values(residual, u), residual(u))

    def nothing_kept(self, size: int) -> Array:
        return klu.none()

    def renewed(self, residual: Residual, u: Float[Array, " n"], kept: Array) -> Array:
        return klu.factorised(self.analysis, self.pattern.values(residual, u), instead_of=kept)

    def update(self, kept: Array, r: Float[Array, " n"]) -> Float[Array, " n"]:
        return klu.solve_by(kept, self.analysis, r)

    def known(self, kept: Array) -> Bool[Array, ""]:
        return kept[0] > 0
