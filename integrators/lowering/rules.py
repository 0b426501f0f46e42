"""Steps of StableHLO: those that compute on nodes, those that move entries of arrays, of nodes or
of numbers, and steps on known numbers; one rule each, by the name of the step.

A rule gets the graph, the step and its arrays of nodes, and returns the array of the result; a move
gets the step and its arrays, and indices are known beforehand. Each independent part of a linear
system calls a function of C, which eliminates with the largest entry of a column as its pivot, as
LAPACK does. Source: https://openxla.org/stablehlo/spec
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from integrators.lowering.graph import OPERATORS, TO_FLOAT, Graph, NotLowered, Solve
from integrators.lowering.stablehlo import Step
from problems.base.runtime import Bool, Int

#: Most unknowns of a system; LAPACK is faster with more.
_MOST_UNKNOWNS = 40
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
    if source == "f" and target in "iu":
        raise NotLowered("whole numbers depend on the state")
    if target == "b" != source:
        return graph.each("NE", x, graph.zero)
    return graph.each(TO_FLOAT, x) if source == "b" != target else x


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
    rows = np.moveaxis(x, axes, range(-len(axes), 0))
    kept = rows.shape[: x.ndim - len(axes)]
    return _folded(graph, step, rows.reshape(*kept, math.prod(rows.shape[len(kept) :])), *others)


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


def operator(step: Step) -> str:
    """Return the operator of a step that computes entry by entry; empty if it is none."""
    if step.name == "compare" and "TOTALORDER" not in step.attributes.get("compare_type", ""):
        return step.attributes["comparison_direction"].split()[-1].rstrip(">")
    return step.name if step.name in OPERATORS else ""


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
    parts = _parts(~np.isin(matrix, graph.zeros))
    if max(map(len, parts), default=0) > _MOST_UNKNOWNS:
        raise NotLowered(f"it solves a system of more than {_MOST_UNKNOWNS} unknowns")
    x = np.empty_like(right)
    for part in parts:
        own, sides = matrix[np.ix_(part, part)], right[part]
        if len(part) == 1:
            x[part] = graph.each("divide", sides, own)
            continue
        given = (*own.ravel().tolist(), *sides.ravel().tolist())
        outputs = graph.outputs(Solve(*sides.shape), given, "f" * sides.size)
        x[part] = np.array(outputs, int).reshape(sides.shape)
    return x


def _parts(entries: Bool[np.ndarray, "n n"]) -> list[np.ndarray]:
    """Numbers of the unknowns that depend on each other."""
    from scipy.sparse.csgraph import connected_components

    count, part = connected_components(entries, directed=False)
    return [np.flatnonzero(part == number) for number in range(count)]


# ---- moves ------------------------------------------------------------------------------
def _broadcast_in_dim(step: Step, x: np.ndarray) -> np.ndarray:
    shape = step.made[0].shape
    sizes = np.ones(len(shape), int)
    sizes[step.numbers("broadcast_dimensions")] = x.shape
    return np.broadcast_to(x.reshape(sizes), shape)


def _slice(step: Step, x: np.ndarray) -> np.ndarray:
    cuts = map(step.numbers, ("start_indices", "limit_indices", "strides"))
    return x[tuple(slice(*cut) for cut in zip(*cuts, strict=True))]


def _pad(step: Step, x: np.ndarray, value: np.ndarray) -> np.ndarray:
    sides = map(step.numbers, ("edge_padding_low", "edge_padding_high", "interior_padding"))
    for axis, (low, high, between) in enumerate(zip(*sides, strict=True)):
        rows = np.moveaxis(x, axis, 0)
        length = len(rows) + between * max(len(rows) - 1, 0)
        shape = max(low, 0) + length + max(high, 0), *rows.shape[1:]
        filled = np.full(shape, value, x.dtype)
        filled[max(low, 0) : max(low, 0) + length : between + 1] = rows
        cut = slice(max(-low, 0), len(filled) - max(-high, 0))
        x = np.moveaxis(filled[cut], 0, axis)
    return x


def _dynamic_update_slice(
    step: Step, x: np.ndarray, update: np.ndarray, *starts: np.ndarray
) -> np.ndarray:
    x = x.copy()
    x[_window(x, np.array(starts, int), update.shape)] = update
    return x


def _gather(step: Step, x: np.ndarray, indices: np.ndarray) -> np.ndarray:
    numbers, sizes = step.fields("dimension_numbers"), step.numbers("slice_sizes")
    axes = "start_index_map", "operand_batching_dims", "start_indices_batching_dims"
    starts = _starts(numbers, indices, x.ndim, axes)
    windows = np.array([x[_window(x, start, sizes)] for start in starts.reshape(-1, x.ndim)])
    dropped = {*numbers["collapsed_slice_dims"], *numbers["operand_batching_dims"]}
    kept = [size for k, size in enumerate(sizes) if k not in dropped]
    windows = windows.astype(x.dtype).reshape(*starts.shape[:-1], *kept)
    offsets = numbers["offset_dims"]
    return np.moveaxis(windows, range(-len(offsets), 0), offsets)


def _scatter(
    step: Step,
    x: np.ndarray,
    indices: np.ndarray,
    updates: np.ndarray,
    combined: Callable[..., np.ndarray] = lambda by, *arrays: OPERATORS[by].numpy(*arrays),
) -> np.ndarray:
    by = step.operation or ""
    if by not in OPERATORS and by != "second":
        raise NotLowered("it scatters by other operations than sums")
    numbers = step.fields("scatter_dimension_numbers")
    dropped = {*numbers["inserted_window_dims"], *numbers["input_batching_dims"]}
    window = numbers["update_window_dims"]
    lengths = iter([updates.shape[k] for k in window])
    sizes = [1 if k in dropped else next(lengths) for k in range(x.ndim)]
    axes = "scatter_dims_to_operand_dims", "input_batching_dims", "scatter_indices_batching_dims"
    starts = _starts(numbers, indices, x.ndim, axes).reshape(-1, x.ndim)
    news = np.moveaxis(updates, window, range(-len(window), 0)).reshape(len(starts), *sizes)
    x = x.copy()
    for start, new in zip(starts, news, strict=True):
        # Windows that are not inside are left out.
        if ((start >= 0) & (start <= np.subtract(x.shape, sizes))).all():
            at = _window(x, start, sizes)
            x[at] = new if by == "second" else combined(by, x[at], new)
    return x


#: Functions of a step and its arrays, all of one kind but for indices.
MOVES: dict[str, Callable[..., np.ndarray]] = {
    "broadcast_in_dim": _broadcast_in_dim,
    "concatenate": lambda step, *x: np.concatenate(x, step.numbers("dimension")[0]),
    "dynamic_slice": lambda step, x, *starts: x[
        _window(x, np.array(starts, int), step.numbers("slice_sizes"))
    ],
    "dynamic_update_slice": _dynamic_update_slice,
    "gather": _gather,
    "pad": _pad,
    "reshape": lambda step, x: x.reshape(step.made[0].shape),
    "reverse": lambda step, x: np.flip(x, step.numbers("dimensions")),
    "scatter": _scatter,
    "slice": _slice,
    "transpose": lambda step, x: np.transpose(x, step.numbers("permutation")),
}
#: Places of indices among the arguments; those of `_scatter` may be combined by other functions.
INDICES = {
    "dynamic_slice": slice(1, None),
    "dynamic_update_slice": slice(2, None),
    "gather": slice(1, None),
    "scatter": slice(1, 2),
}


def _starts(
    numbers: dict[str, list[int]], indices: np.ndarray, ndim: int, names: tuple[str, str, str]
) -> np.ndarray:
    """The first index of each window, along the last axis; the others are those of the indices.

    The names are those of indexed axes of the operand, of its other axes that go with axes of the
    indices, and of these.
    """
    axes, own, theirs = (numbers[name] for name in names)
    (along,) = numbers["index_vector_dim"] or [0]
    indices = np.moveaxis(indices, along, -1) if along < indices.ndim else indices[..., None]
    starts = np.zeros((*indices.shape[:-1], ndim), int)
    starts[..., axes] = indices
    for axis, other in zip(own, theirs, strict=True):
        starts[..., axis] = np.indices(indices.shape[:-1])[other]
    return starts


def _window(x: np.ndarray, start: np.ndarray, sizes: Sequence[int]) -> tuple[slice, ...]:
    """The slices of a window of x, which is moved until it is inside."""
    start = np.clip(start, 0, np.subtract(x.shape, sizes))
    return tuple(slice(int(a), int(a) + n) for a, n in zip(start, sizes, strict=True))


# ---- numbers that are known before the program runs -------------------------------------
def on_numbers(step: Step, *given: np.ndarray) -> np.ndarray | None:
    """The result of a step on numbers of any type; None if it has no rule here."""
    name, made, by = step.name, step.made[0], operator(step)
    with np.errstate(all="ignore"):
        if name == "constant" and step.value is not None:
            found = np.broadcast_to(step.value, made.shape)
        elif name == "iota":
            found = np.indices(made.shape)[step.numbers("iota_dimension")[0]]
        elif name in MOVES:
            found = MOVES[name](step, *given)
        elif name == "convert":
            (found,) = given
        elif name == "divide" and made.dtype.kind in "iu":
            found = (given[0] - np.fmod(*given)) // given[1]
        elif by:
            found = OPERATORS[by].numpy(*given)
        else:
            return None
        return found.astype(made.dtype)
