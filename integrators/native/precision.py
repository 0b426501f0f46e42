"""Precisions of a lone step: 64-bit floats, 32-bit floats, and both.

In ``single`` all numbers of a step are 32-bit floats, those of the scene included; times are
computed from the number of the step, so that none adds up. In ``mixed`` states and residuals are
64-bit floats; a tangent is rounded, inverted and applied in 32 bits. Newton's method then is an
iterative refinement: each iteration gains some seven digits, less those of the tangent's condition,
and ends where the 64-bit residual says so.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from integrators.native import small_matrices
from integrators.native.linear_solvers import DenseSolver, Once, Residual
from problems.named_equations import part
from problems.runtime import Array, Float, jax, jnp

PRECISIONS = ("double", "single", "mixed")
#: Least relative tolerance of Newton's method in single: 16 units in the last place.
TOLERANCE = 16 * float(np.finfo(np.float32).eps)


@dataclass(frozen=True)
class RoundedSolver(DenseSolver):
    """Solves in 32-bit floats with full matrices; modified Newton keeps the inverse."""

    joins: bool = False

    def once(self, residual: Residual, u: Float[Array, " n"]) -> Once:
        inverse = self.renewed(residual, u, u)
        with part("residuals"):
            r = residual(u)
        with part("solves"):
            return Once(self.update(inverse, r))

    def nothing_kept(self, size: int) -> Array:
        return super().nothing_kept(size).astype(jnp.float32)

    def renewed(self, residual: Residual, u: Float[Array, " n"], kept: Array) -> Array:
        with part("Jacobians"):
            tangent = jax.jacfwd(residual)(u)
        return small_matrices.inverse(tangent.astype(jnp.float32))

    def update(self, kept: Array, r: Float[Array, " n"]) -> Float[Array, " n"]:
        return small_matrices.product(kept, r.astype(jnp.float32)).astype(r.dtype)


def rounded(numbers: Any) -> Any:
    """Round a pytree of numbers to 32-bit floats and integers."""
    kinds = {"f": np.float32, "i": np.int32}

    def one(leaf: Any) -> np.ndarray:
        leaf = np.asarray(leaf)
        return leaf.astype(kinds.get(leaf.dtype.kind, leaf.dtype))

    return jax.tree.map(one, numbers)
