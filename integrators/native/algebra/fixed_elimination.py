"""Elimination of small sparse matrices in an order that is fixed when the program is made.

The matrices of one program have the same pattern. The order of its pivots is chosen once, so that
few entries arise (Markowitz 1957, doi:10.1287/mnsc.3.3.255), and the elimination is written out:
some 100 operations without an index for the 13 unknowns of a slider crank, in place of 13 updates
of a full matrix with a search for a pivot each.

Pivots are taken on the diagonal while it has one. Unknowns and equations of a step have the same
order: masses are on the diagonal, and a constraint's entry there arises from the masses on which it
acts. A fixed order cannot avoid a pivot that vanishes at some time. So each solution is tested: it
has to solve a system that differs from the given one by rounding alone in every entry (Oettli &
Prager 1964, doi:10.1007/BF01386090), else the elimination with pivots is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, reduce
from operator import add, and_, sub
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from integrators.native.algebra import small_matrices
from integrators.native.algebra.step_records import PIVOTS
from problems.base.runtime import Array, Bool, Float, Int, jax, jnp
from problems.equations.programs import part, turns

#: Entries of a matrix, by row and column.
_Numbers: TypeAlias = dict[tuple[int, int], Array]

#: Most multiplications of an elimination that is written out: compiling takes longer with each.
MOST_WORK = 600
#: Largest change of an entry, relative, that a solution may stand for.
_BACKWARD = 1e-13


class Pivot(NamedTuple):
    """A step of the elimination: its pivot, and the rows and columns that it changes."""

    row: int
    column: int
    rows: tuple[int, ...]
    columns: tuple[int, ...]


class Factors(NamedTuple):
    """A matrix that was eliminated in a fixed order, and its inverse if this is not ``sound``."""

    triangle: _Numbers
    inverse: Float[Array, "n n"]
    sound: Bool[Array, ""]


@dataclass(frozen=True, eq=False)
class EliminationPlan:
    """Elimination of the matrices of one pattern.

    Parameters
    ----------
    entries
        The pattern, ``(n, n)``.
    colours
        Columns of one colour share no row, so that one product with a matrix has them all.
    pivots
        The steps of the elimination.
    """

    entries: Bool[np.ndarray, "n n"]
    colours: Int[np.ndarray, " n"]
    pivots: tuple[Pivot, ...]

    @property
    def work(self) -> int:
        """Multiplications and divisions of a solution."""
        return sum((len(one.rows) + 1) * (len(one.columns) + 2) - 1 for one in self.pivots)

    @cached_property
    def seeds(self) -> Float[np.ndarray, "colours n"]:
        """Vectors whose products with a matrix have all of its entries."""
        return np.eye(self.colours.max() + 1)[self.colours].T

    def solve(
        self, products: Sequence[Float[Array, " n"]], b: Float[Array, " n"]
    ) -> tuple[Float[Array, " n"], Int[Array, ""]]:
        """Solve a x = b, given the products of a with the seeds; return x, and 1 if it took an
        elimination with pivots, else 0."""
        # Each stage stands unfused, and values between them are numbers: XLA computes a number anew
        # for each array that it goes into.
        triangle, reliable = self._triangle(products)
        x, a = self._solution(triangle, b), jnp.stack(products)
        solved = reliable & self._is_solved(a, b, x)
        with turns(PIVOTS):
            x = jax.lax.cond(solved, lambda a, b, x: x, self._by_pivots, a, b, x)
        return x, jnp.where(solved, 0, 1)

    def factorised(self, products: Sequence[Float[Array, " n"]]) -> Factors:
        """Factorise a matrix, given its products with the seeds; a trial tells whether it serves
        for any right-hand side."""
        triangle, reliable = self._triangle(products)
        # The seeds sum to a vector of ones.
        a, b = jnp.stack(products), reduce(add, products)
        sound = reliable & self._is_solved(a, b, self._solution(triangle, b))
        with turns(PIVOTS):
            inverse = jax.lax.cond(sound, lambda a: jnp.zeros_like(self._full(a)), self._inverse, a)
        return Factors(triangle, inverse, sound)

    def solve_by(
        self, factors: Factors, b: Float[Array, " n"]
    ) -> tuple[Float[Array, " n"], Int[Array, ""]]:
        """Solve a x = b for a matrix that was factorised; return x, and 1 if it took pivots."""
        x = self._solution(factors.triangle, b)
        with turns(PIVOTS):
            by_inverse = small_matrices.product
            x = jax.lax.cond(factors.sound, lambda *_: x, by_inverse, factors.inverse, b)
        return x, jnp.where(factors.sound, 0, 1)

    def _triangle(self, products: Sequence[Any]) -> tuple[_Numbers, Array]:
        with part("factorisations"):
            return small_matrices.unfused(self._eliminated, products)

    def _solution(self, triangle: _Numbers, b: Array) -> Array:
        with part("solves"):
            return jnp.stack(small_matrices.unfused(self._substituted, triangle, b))

    def _is_solved(self, a: Array, b: Array, x: Array) -> Array:
        with part("solves"):
            return small_matrices.unfused(self._solved, a, b, x)

    def _eliminated(self, products: Sequence[Any]) -> tuple[_Numbers, Array]:
        """Rows of the triangle with inverted pivots, factors in the place of what they eliminate,
        and whether each pivot is more than rounding of the terms that it is the sum of."""
        places, reliable = np.argwhere(self.entries).tolist(), []
        w = {(i, j): products[self.colours[j]][i] for i, j in places}
        terms: dict[tuple[int, int], list[Array]] = {
            (one.row, one.column): [] for one in self.pivots
        }
        for i, j, rows, columns in self.pivots:
            if terms[i, j]:
                size = reduce(add, map(jnp.abs, terms[i, j]))
                reliable.append(jnp.abs(w[i, j]) > _BACKWARD * size)
            w[i, j] = 1 / w[i, j]
            for r in rows:
                w[r, j] = w[r, j] * w[i, j]
                for c in columns:
                    change = w[r, j] * w[i, c]
                    w[r, c] = w[r, c] - change if (r, c) in w else -change
                    if (r, c) in terms:
                        terms[r, c].append(change)
        return w, reduce(and_, reliable, jnp.asarray(True))

    def _substituted(self, triangle: _Numbers, b: Any) -> list[Array]:
        """The solution, forward and backward."""
        right = list(b)
        for i, j, rows, _ in self.pivots:
            for r in rows:
                right[r] = right[r] - triangle[r, j] * right[i]
        x = list(right)
        for i, j, _, columns in reversed(self.pivots):
            x[j] = reduce(lambda s, c: s - triangle[i, c] * x[c], columns, right[i])
            x[j] = x[j] * triangle[i, j]
        return x

    def _solved(self, products: Array, b: Array, x: Array) -> Bool[Array, ""]:
        """Whether x solves a system whose entries differ by rounding alone."""
        fits = []
        for i, row in enumerate(self.entries):
            terms = [products[self.colours[j], i] * x[j] for j in np.flatnonzero(row).tolist()]
            gap, size = reduce(sub, terms, b[i]), reduce(add, map(jnp.abs, terms), jnp.abs(b[i]))
            fits.append(jnp.abs(gap) <= _BACKWARD * size)
        return reduce(and_, fits)

    def _by_pivots(self, products: Array, b: Array, _: Array) -> Array:
        return small_matrices.solve(self._full(products), b)

    def _inverse(self, products: Array) -> Array:
        return small_matrices.inverse(self._full(products))

    def _full(self, products: Array) -> Float[Array, "n n"]:
        return jnp.where(self.entries, products[self.colours].T, 0.0)


def planned(entries: Bool[np.ndarray, "n n"]) -> EliminationPlan | None:
    """Plan the elimination of matrices with a pattern; None if it is singular or much work."""
    return _planned(entries.tobytes(), len(entries))


@lru_cache(256)
def _planned(pattern: bytes, n: int) -> EliminationPlan | None:
    entries = np.frombuffer(pattern, bool).reshape(n, n)
    left, pivots = entries.copy(), []
    for _ in range(n):
        others = np.outer(left.sum(axis=1) - 1, left.sum(axis=0) - 1)
        found = [(i != j, others[i, j], i, j) for i, j in np.argwhere(left).tolist()]
        if not found:
            return None
        *_, i, j = min(found)
        rows, columns = left[:, j].copy(), left[i].copy()
        rows[i] = columns[j] = False
        left[i] = left[:, j] = False
        left |= np.outer(rows, columns)
        pivots.append(Pivot(i, j, *(tuple(np.flatnonzero(x).tolist()) for x in (rows, columns))))
    plan = EliminationPlan(entries, _coloured(entries), tuple(pivots))
    return plan if plan.work <= MOST_WORK else None


def _coloured(entries: Bool[np.ndarray, "n n"]) -> Int[np.ndarray, " n"]:
    """Colours of the columns, the fullest first: each takes the first that is free."""
    taken: list[np.ndarray] = []
    colours = np.zeros(len(entries), int)
    for j in np.argsort(-entries.sum(axis=0), kind="stable"):
        free = (k for k, rows in enumerate(taken) if not (rows & entries[:, j]).any())
        colours[j] = next(free, len(taken))
        if colours[j] == len(taken):
            taken.append(np.zeros(len(entries), bool))
        taken[colours[j]] |= entries[:, j]
    return colours
