"""Steps of StableHLO that compute: one rule each, by the name of the step.

A rule gets the graph, the step and its arrays of nodes, and returns the array of the result. Each
independent part of a linear system calls a function of C, which eliminates with the largest entry
of a column as its pivot, as LAPACK does.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from integrators.lowering.graph import Graph, NotLowered, Solve
from integrators.lowering.operators import TO_COUNT, TO_FLOAT
from integrators.lowering.stablehlo import Step
from problems.base.runtime import Bool, Int

#: Most unknowns of a system, and of all in one operation.
_MOST_UNKNOWNS, _MOST_IN_ALL = 40, 4000
#: Results of folding nothing.
_OF_NOTHING = {
    "add": 0.0,
    "multiply": 1.0,
    "maximum": -np.inf,
    "minimum": np.inf,
    "and": True,
    "or": False,
}


def _logistic(graph: Graph, step: Step, x: np.ndarray) -> np.ndarray:
    decay = graph.each("exponential", graph.each("negate", x))
    return graph.each("divide", graph.one, graph.each("add", graph.one, decay))


def _convert(graph: Graph, step: Step, x: np.ndarray) -> np.ndarray:
    source, target = step.taken[0].dtype.kind, step.made[0].dtype.kind
    if source == target:
        return x
    if target == "f":
        return graph.each(TO_FLOAT, x)
    if (source, target) == ("b", "i"):
        return graph.each(TO_COUNT, x)
    if (source, target) == ("f", "b"):
        return graph.each("NE", x, graph.zero)
    raise NotLowered("whole numbers depend on the state")


def _folded(graph: Graph, step: Step, rows: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Fold the last axis away by the operation of a step, from the first entry to the last."""
    by = step.operation
    if by not in _OF_NOTHING:
        raise NotLowered("it folds arrays by other operations than sums")
    neutral = graph.is_constant(int(first)) and graph.value(int(first)) == _OF_NOTHING[by]
    start = [] if neutral and rows.shape[-1] else [np.full(rows.shape[:-1], first)]
    result, *others = *start, *np.moveaxis(rows, -1, 0)
    for other in others:
        result = graph.each(by, result, other)
    return result


def _reduce(graph: Graph, step: Step, x: np.ndarray, *others: np.ndarray) -> np.ndarray:
    if len(others) != 1:
        raise NotLowered("it folds several arrays at once")
    axes = step.numbers("dimensions")
    kept = [k for k in range(x.ndim) if k not in axes]
    length = int(np.prod([x.shape[k] for k in axes]))
    rows = np.transpose(x, [*kept, *axes]).reshape(*(x.shape[k] for k in kept), length)
    return _folded(graph, step, rows, *others)


def _reduce_window(graph: Graph, step: Step, x: np.ndarray, first: np.ndarray) -> np.ndarray:
    plain = "window_strides", "base_dilations", "window_dilations"
    if any(number != 1 for name in plain for number in step.numbers(name)):
        raise NotLowered("it folds windows with gaps")
    sides = np.resize(step.numbers("padding"), (x.ndim, 2))  # one number if all are equal
    padded = np.pad(x, sides, constant_values=first)
    sizes = step.numbers("window_dimensions")
    windows = np.lib.stride_tricks.sliding_window_view(padded, sizes)
    rows = windows.reshape(*windows.shape[: x.ndim], -1)
    # From the side that is padded: so equal parts of the windows come first, and stand once.
    rows = rows[..., ::-1] if sides[:, 1].sum() > sides[:, 0].sum() else rows
    return _folded(graph, step, rows, first)


def _dot_general(graph: Graph, step: Step, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    numbers = step.fields("dot_dimension_numbers")

    def arranged(x: np.ndarray, side: str) -> np.ndarray:
        """Batch axes as one, free axes as one, contracted axes as one."""
        batch, contracted = (
            numbers[f"{side}_{axes}_dimensions"] for axes in ("batching", "contracting")
        )
        free = [k for k in range(x.ndim) if k not in (*batch, *contracted)]
        sizes = [int(np.prod([x.shape[k] for k in axes])) for axes in (batch, free, contracted)]
        return np.transpose(x, [*batch, *free, *contracted]).reshape(sizes)

    rows, columns = arranged(a, "lhs"), arranged(b, "rhs")
    result = np.full((len(rows), rows.shape[1], columns.shape[1]), graph.zero)
    for k in range(rows.shape[2]):
        product = graph.each("multiply", rows[:, :, None, k], columns[:, None, :, k])
        result = graph.each("add", result, product)
    return result


#: Functions of the graph, a step and its arrays of nodes.
RULES: dict[str, Callable[..., np.ndarray]] = {
    "clamp": lambda graph, step, low, x, high: graph.each(
        "minimum", graph.each("maximum", x, low), high
    ),
    "convert": _convert,
    "dot_general": _dot_general,
    "logistic": _logistic,
    "reduce": _reduce,
    "reduce_window": _reduce_window,
    "rsqrt": lambda graph, step, x: graph.each("divide", graph.one, graph.each("sqrt", x)),
    "square": lambda graph, step, x: graph.each("multiply", x, x),
}


# ---- linear systems ---------------------------------------------------------------------
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
