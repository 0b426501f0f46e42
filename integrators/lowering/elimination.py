"""Linear systems: each independent part calls a function of C, which eliminates with pivots.

The pivot of a column is its largest entry, as in LAPACK.
"""

from __future__ import annotations

import numpy as np

from integrators.lowering.graph import Graph, NotLowered, Solve
from problems.runtime import Bool, Int

#: Most unknowns of a system, and of all in one operation.
_MOST_UNKNOWNS, _MOST_IN_ALL = 40, 4000


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
        found = _solved(graph, one, sides.reshape(len(one), -1)).reshape(sides.shape)
        x[places] = np.moveaxis(found, 0, 1)
    return x


def _parts(entries: Bool[np.ndarray, "n n"]) -> list[np.ndarray]:
    """Numbers of the unknowns that depend on each other."""
    from scipy.sparse.csgraph import connected_components

    count, part = connected_components(entries, directed=False)
    return [np.flatnonzero(part == number) for number in range(count)]


def _solved(
    graph: Graph, matrix: Int[np.ndarray, "n n"], right: Int[np.ndarray, "n m"]
) -> Int[np.ndarray, "n m"]:
    """Solve A X = B, one unknown by a quotient, and more by a function of C."""
    if len(matrix) == 1:
        return graph.each("divide", right, matrix)
    given = (*matrix.ravel().tolist(), *right.ravel().tolist())
    outputs = graph.outputs(Solve(*right.shape), given, "f" * right.size)
    return np.array(outputs, int).reshape(right.shape)
