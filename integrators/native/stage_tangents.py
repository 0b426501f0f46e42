"""Linear algebra of coupled stages: one real and one complex matrix in the place of a large one.

The stages of an implicit Runge-Kutta method are coupled by its matrix A alone if all of them take
their tangent at one point. With A = T diag(theta) T^-1 the transformed stages are decoupled: the
k-th is a single stage of slope theta_k h (Butcher 1976, doi:10.1007/BF01931672; Bickart 1977,
doi:10.1137/0714068). Complex slopes come in conjugate pairs, and one of each is enough. With three
stages of n unknowns this takes 2/3 n^3 (1 + 4) operations instead of 2/3 n^3 27.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from integrators.native import small_matrices
from integrators.native.linear_solvers import LinearSolver, Once, Residual
from problems.runtime import Array, Bool, Float, jnp

#: Unknowns of all stages to a function: slope in steps to the tangent of a stage.
TangentsBySlope: TypeAlias = Callable[[Array], Callable[[complex], Array]]


class StageTangents(LinearSolver):
    """TangentsBySlope of s coupled stages, kept as an inverse for each slope.

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
        return tuple(map(small_matrices.inverse, self.assembled(u)))

    def assembled(self, u: Float[Array, " n"]) -> list[Array]:
        """The tangents of the transformed stages."""
        tangent = self._tangents(u)
        return [tangent(slope) for slope, *_ in self._modes]

    def update(self, kept: Any, r: Float[Array, " n"]) -> Float[Array, " n"]:
        r, du = r.reshape(self.stages, -1), jnp.zeros((len(r) // self.stages, self.stages))
        for inverse, (_, column, row) in zip(kept, self._modes, strict=True):
            one = small_matrices.product(inverse, row @ r)
            du = du + jnp.real(one[:, None] * column)
        return du.ravel()

    def known(self, kept: Any) -> Bool[Array, ""]:
        return ~jnp.isnan(kept[0][0, 0])
