"""A linear system solved by elimination with pivots, written out operation by operation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from integrators.lowering.graph import Graph, NotLowered

if TYPE_CHECKING:
    from jaxtyping import Int

#: Unknowns of a system that is written out, and of all systems with one matrix.
_MOST_UNKNOWNS, _MOST_IN_ALL = 40, 400


def solve(
    graph: Graph, matrix: Int[np.ndarray, "n n"], right: Int[np.ndarray, " n"]
) -> Int[np.ndarray, " n"]:
    """Solve A x = b for nodes, each independent part by itself.

    Raises
    ------
    NotLowered
        If a part has too many unknowns.
    """
    from scipy.sparse.csgraph import connected_components

    count, part = connected_components(matrix != graph.zero, directed=False)
    x = np.empty(len(right), int)
    for number in range(count):
        of = np.flatnonzero(part == number)
        if len(of) > _MOST_UNKNOWNS:
            raise NotLowered(f"it solves a system of more than {_MOST_UNKNOWNS} unknowns")
        x[of] = _eliminated(graph, matrix[np.ix_(of, of)].tolist(), right[of].tolist())
    return x


def refuse_many(unknowns: int) -> None:
    """Refuse systems whose matrix alone would take minutes."""
    if unknowns > _MOST_IN_ALL:
        raise NotLowered(f"it solves systems of more than {_MOST_IN_ALL} unknowns in all")


def _eliminated(graph: Graph, matrix: list[list[int]], right: list[int]) -> list[int]:
    """Solve A x = b; the pivot of a column is its largest entry, as in LAPACK.

    The rows that compete for a place change places where a comparison says so. Entries that are
    known to be zero take part in nothing.
    """
    rows, n = [[*row, b] for row, b in zip(matrix, right, strict=True)], len(matrix)
    for k in range(n):
        for i in range(k + 1, n):
            _bring_up_the_larger(graph, rows, k, i)
        for i in range(k + 1, n):
            if rows[i][k] == graph.zero:
                continue
            factor = graph.apply("div", rows[i][k], rows[k][k])
            for j in range(k + 1, n + 1):
                product = graph.apply("mul", factor, rows[k][j])
                rows[i][j] = graph.apply("sub", rows[i][j], product)
    x = [graph.zero] * n
    for k in reversed(range(n)):
        left = rows[k][n]
        for j in range(k + 1, n):
            left = graph.apply("sub", left, graph.apply("mul", rows[k][j], x[j]))
        x[k] = graph.apply("div", left, rows[k][k])
    return x


def _bring_up_the_larger(graph: Graph, rows: list[list[int]], k: int, i: int) -> None:
    """Exchange rows k and i from column k on if the entry of row i there is larger."""
    if rows[i][k] == graph.zero:
        return
    if rows[k][k] == graph.zero:
        rows[k], rows[i] = rows[i], rows[k]
        return
    sizes = (graph.apply("abs", rows[at][k]) for at in (i, k))
    exchanged = graph.apply("gt", *sizes)
    for j in range(k, len(rows[k])):
        upper, lower = rows[k][j], rows[i][j]
        rows[k][j] = graph.apply("choose", exchanged, lower, upper)
        rows[i][j] = graph.apply("choose", exchanged, upper, lower)
