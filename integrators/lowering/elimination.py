"""Linear systems: small ones are written out operation by operation, others call a function of C.

Either way eliminates with pivots: that of a column is its largest entry, as in LAPACK.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from integrators.lowering.graph import Graph, NotLowered, Solve
from problems.runtime import Bool, Int

#: Unknowns of a system that is written out, those of a system at all, and of all in one operation.
_WRITTEN_OUT, _MOST_UNKNOWNS, _MOST_IN_ALL = 4, 40, 4000


def eliminate(
    graph: Graph, matrix: Int[np.ndarray, "n n"], right: Int[np.ndarray, "n m"]
) -> Int[np.ndarray, "n m"]:
    """Solve A X = B for nodes, each independent part by itself.

    Raises
    ------
    NotLowered
        If a part has too many unknowns.
    """
    if right.size > _MOST_IN_ALL:
        raise NotLowered(f"it solves systems of more than {_MOST_IN_ALL} unknowns in all")
    parts = _parts(~np.isin(matrix, graph.zeros))
    if max(map(len, parts), default=0) > _MOST_UNKNOWNS:
        raise NotLowered(f"it solves a system of more than {_MOST_UNKNOWNS} unknowns")
    same: dict[bytes, list[np.ndarray]] = {}
    for part in parts:
        same.setdefault(matrix[np.ix_(part, part)].tobytes(), []).append(part)
    x = np.empty_like(right)
    for places in map(np.array, same.values()):
        one = matrix[np.ix_(places[0], places[0])]
        sides = np.moveaxis(right[places], 0, 1)
        by = _eliminated if len(one) <= _WRITTEN_OUT else _called
        found = by(graph, one, sides.reshape(len(one), -1)).reshape(sides.shape)
        x[places] = np.moveaxis(found, 0, 1)
    return x


def _parts(entries: Bool[np.ndarray, "n n"]) -> list[np.ndarray]:
    """Numbers of the unknowns that depend on each other."""
    from scipy.sparse.csgraph import connected_components

    count, part = connected_components(entries, directed=False)
    return [np.flatnonzero(part == number) for number in range(count)]


def _called(
    graph: Graph, matrix: Int[np.ndarray, "n n"], right: Int[np.ndarray, "n m"]
) -> Int[np.ndarray, "n m"]:
    """Solve A X = B by a function of C."""
    given = (*matrix.ravel().tolist(), *right.ravel().tolist())
    outputs = graph.outputs(Solve(*right.shape), given, "f" * right.size)
    return np.array(outputs, int).reshape(right.shape)


def _eliminated(
    graph: Graph, matrix: Int[np.ndarray, "n n"], right: Int[np.ndarray, "n m"]
) -> Int[np.ndarray, "n m"]:
    """Solve A X = B.

    The rows that compete for a place change places where a comparison says so. Entries that are
    known to be zero take part in nothing.
    """
    rows, n = np.hstack([matrix, right]), len(matrix)

    def without(row: np.ndarray, factor: Any, other: np.ndarray) -> np.ndarray:
        return graph.each("subtract", row, graph.each("multiply", factor, other))

    for k in range(n):
        for i in range(k + 1, n):
            _bring_up_the_larger(graph, rows, k, i)
        for i in range(k + 1, n):
            if rows[i, k] not in graph.zeros:
                factor = graph.each("divide", rows[i, k], rows[k, k])
                rows[i, k + 1 :] = without(rows[i, k + 1 :], factor, rows[k, k + 1 :])
    x = rows[:, n:]
    for k in reversed(range(n)):
        for j in range(k + 1, n):
            x[k] = without(x[k], rows[k, j], x[j])
        x[k] = graph.each("divide", x[k], rows[k, k])
    return x


def _bring_up_the_larger(graph: Graph, rows: Int[np.ndarray, "n m"], k: int, i: int) -> None:
    """Exchange rows k and i from column k on if the entry of row i there is larger."""
    upper, lower = rows[k, k:].copy(), rows[i, k:].copy()
    if lower[0] in graph.zeros:
        return
    if upper[0] in graph.zeros:
        rows[k, k:], rows[i, k:] = lower, upper
        return
    exchanged = graph.each("GT", graph.each("abs", lower[0]), graph.each("abs", upper[0]))
    rows[k, k:] = graph.each("select", exchanged, lower, upper)
    rows[i, k:] = graph.each("select", exchanged, upper, lower)
