"""Linear systems: small ones are written out operation by operation, others call a function of C.

Either way eliminates with pivots: that of a column is its largest entry, as in LAPACK.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from integrators.lowering.graph import Graph, NotLowered, Solve

if TYPE_CHECKING:
    from jaxtyping import Int

#: Unknowns of a system that is written out, those of a system at all, and of all in one operation.
_WRITTEN_OUT, _MOST_UNKNOWNS, _MOST_IN_ALL = 4, 40, 4000


def solve(
    graph: Graph, product: Callable[[np.ndarray], np.ndarray], right: Int[np.ndarray, " n"]
) -> Int[np.ndarray, " n"]:
    """Solve A x = b for nodes, each independent part by itself.

    Parameters
    ----------
    product
        A x of nodes x.

    Raises
    ------
    NotLowered
        If a part has too many unknowns.
    """
    n = len(right)
    if n > _MOST_IN_ALL:
        raise NotLowered(f"it solves systems of more than {_MOST_IN_ALL} unknowns in all")
    parts = _parts(graph, product, n)
    largest = max((len(part) for part in parts), default=0)
    if largest > _MOST_UNKNOWNS:
        raise NotLowered(f"it solves a system of more than {_MOST_UNKNOWNS} unknowns")
    # A product with one unit vector of each part gives one column of each.
    columns = np.empty((largest, n), int)
    for k in range(largest):
        unit = np.full(n, graph.zero)
        unit[[part[k] for part in parts if k < len(part)]] = graph.one
        columns[k] = product(unit)
    same: dict[tuple[int, ...], list[np.ndarray]] = {}
    for part in parts:
        matrix = columns[: len(part), part].T
        same.setdefault(tuple(matrix.ravel().tolist()), []).append(part)
    x = np.empty(n, int)
    for matrix, of in same.items():
        size = len(of[0])
        places = np.array(of).T
        x[places] = (_eliminated if size <= _WRITTEN_OUT else _called)(
            graph, np.array(matrix).reshape(size, size), right[places]
        )
    return x


def _parts(graph: Graph, product: Callable[[np.ndarray], np.ndarray], n: int) -> list[np.ndarray]:
    """Numbers of the unknowns that depend on each other, found in the product with unknowns."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    unknowns = [graph.fresh() for _ in range(n)]
    rows = graph.origins(product(np.array(unknowns, int)).tolist(), unknowns)
    entries = [(i, j) for i, row in enumerate(rows) for j in row]
    i, j = np.array(entries, int).reshape(-1, 2).T
    pattern = csr_matrix((np.ones(len(entries)), (i, j)), (n, n))
    count, part = connected_components(pattern, directed=False)
    return [np.flatnonzero(part == number) for number in range(count)]


def _called(
    graph: Graph, matrix: Int[np.ndarray, "n n"], right: Int[np.ndarray, "n m"]
) -> Int[np.ndarray, "n m"]:
    """Solve A X = B by a function of C."""
    given = (*matrix.ravel().tolist(), *right.ravel().tolist())
    return np.array(graph.left_by(Solve(*right.shape), given, "f" * right.size)).reshape(
        right.shape
    )


def _eliminated(
    graph: Graph, matrix: Int[np.ndarray, "n n"], right: Int[np.ndarray, "n m"]
) -> Int[np.ndarray, "n m"]:
    """Solve A X = B.

    The rows that compete for a place change places where a comparison says so. Entries that are
    known to be zero take part in nothing.
    """
    rows, (n, m) = np.hstack([matrix, right]).tolist(), right.shape
    for k in range(n):
        for i in range(k + 1, n):
            _bring_up_the_larger(graph, rows, k, i)
        for i in range(k + 1, n):
            if rows[i][k] in graph.zeros:
                continue
            factor = graph.apply("div", rows[i][k], rows[k][k])
            for j in range(k + 1, n + m):
                product = graph.apply("mul", factor, rows[k][j])
                rows[i][j] = graph.apply("sub", rows[i][j], product)
    x = np.empty((n, m), int)
    for k in reversed(range(n)):
        for column in range(m):
            left = rows[k][n + column]
            for j in range(k + 1, n):
                product = graph.apply("mul", rows[k][j], int(x[j, column]))
                left = graph.apply("sub", left, product)
            x[k, column] = graph.apply("div", left, rows[k][k])
    return x


def _bring_up_the_larger(graph: Graph, rows: list[list[int]], k: int, i: int) -> None:
    """Exchange rows k and i from column k on if the entry of row i there is larger."""
    if rows[i][k] in graph.zeros:
        return
    if rows[k][k] in graph.zeros:
        rows[k], rows[i] = rows[i], rows[k]
        return
    sizes = (graph.apply("abs", rows[at][k]) for at in (i, k))
    exchanged = graph.apply("gt", *sizes)
    for j in range(k, len(rows[k])):
        upper, lower = rows[k][j], rows[i][j]
        rows[k][j] = graph.apply("choose", exchanged, lower, upper)
        rows[i][j] = graph.apply("choose", exchanged, upper, lower)
