"""Steps of StableHLO that move entries of arrays, of nodes or of numbers; steps on known numbers.

Indices are known beforehand. Source: https://openxla.org/stablehlo/spec
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from integrators.lowering.graph import NotLowered
from integrators.lowering.operators import OPERATORS, operator
from integrators.lowering.stablehlo import Step


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


def _dynamic_slice(step: Step, x: np.ndarray, *starts: np.ndarray) -> np.ndarray:
    return x[_window(x, np.array(starts, int), step.numbers("slice_sizes"))]


def _dynamic_update_slice(
    step: Step, x: np.ndarray, update: np.ndarray, *starts: np.ndarray
) -> np.ndarray:
    x = x.copy()
    x[_window(x, np.array(starts, int), update.shape)] = update
    return x


def _gather(step: Step, x: np.ndarray, indices: np.ndarray) -> np.ndarray:
    numbers, sizes = step.fields("dimension_numbers"), step.numbers("slice_sizes")
    pairs = numbers["operand_batching_dims"], numbers["start_indices_batching_dims"]
    starts = _starts(numbers, indices, numbers["start_index_map"], x.ndim, *pairs)
    windows = np.array([x[_window(x, start, sizes)] for start in starts.reshape(-1, x.ndim)])
    dropped = {*numbers["collapsed_slice_dims"], *numbers["operand_batching_dims"]}
    kept = [size for k, size in enumerate(sizes) if k not in dropped]
    windows = windows.astype(x.dtype).reshape(*starts.shape[:-1], *kept)
    offsets = numbers["offset_dims"]
    return np.moveaxis(windows, range(-len(offsets), 0), offsets)


def _combined(operator: str, *arrays: np.ndarray) -> np.ndarray:
    return OPERATORS[operator].numpy(*arrays)


def _scatter(
    step: Step,
    x: np.ndarray,
    indices: np.ndarray,
    updates: np.ndarray,
    combined: Callable[..., np.ndarray] = _combined,
) -> np.ndarray:
    by = step.operation or ""
    if by not in OPERATORS and by != "second":
        raise NotLowered("it scatters by other operations than sums")
    numbers = step.fields("scatter_dimension_numbers")
    dropped = {*numbers["inserted_window_dims"], *numbers["input_batching_dims"]}
    window = numbers["update_window_dims"]
    lengths = iter([updates.shape[k] for k in window])
    sizes = [1 if k in dropped else next(lengths) for k in range(x.ndim)]
    pairs = numbers["input_batching_dims"], numbers["scatter_indices_batching_dims"]
    starts = _starts(numbers, indices, numbers["scatter_dims_to_operand_dims"], x.ndim, *pairs)
    starts = starts.reshape(-1, x.ndim)
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
    "dynamic_slice": _dynamic_slice,
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
    numbers: dict[str, list[int]],
    indices: np.ndarray,
    axes: list[int],
    ndim: int,
    own: list[int],
    theirs: list[int],
) -> np.ndarray:
    """The first index of each window, along the last axis; the others are those of the indices.

    ``axes`` of the operand are indexed; ``own`` axes of it go with ``theirs`` of the indices.
    """
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
def on_numbers(step: Step, *given: np.ndarray) -> list[np.ndarray] | None:
    """The results of a step on numbers of any type; None if it has no rule here."""
    if step.name == "sort" and step.operation == "compare" and given[0].ndim == 1:
        # Of the rows that a factorisation exchanges.
        order = np.argsort(given[0], kind="stable")
        return (
            [x[order] for x in given] if "LT" in str(step.bodies[0].steps[0].attributes) else None
        )
    with np.errstate(all="ignore"):
        found = _on_numbers(step, *given)
    return None if found is None else [found.astype(step.made[0].dtype)]


def _on_numbers(step: Step, *given: np.ndarray) -> np.ndarray | None:
    name, (made, *_) = step.name, step.made
    if name == "constant":
        return np.broadcast_to(np.asarray(step.value), made.shape)
    if name == "iota":
        return np.indices(made.shape)[step.numbers("iota_dimension")[0]]
    if name in MOVES:
        return MOVES[name](step, *given)
    if name == "convert":
        return _converted(given[0], made.dtype)
    if name == "divide" and made.dtype.kind in "iu":
        return (given[0] - np.fmod(*given)) // given[1]
    by = operator(step)
    return OPERATORS[by].numpy(*given) if by else None


def _converted(x: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """Numbers of another type; XLA turns too large ones into the largest whole number, NaN to 0."""
    if dtype.kind not in "iu" or x.dtype.kind != "f":
        return x.astype(dtype)
    x, limits = np.nan_to_num(x), np.iinfo(dtype)
    ends = np.where(x < limits.max, limits.min, limits.max)
    inside = (x > limits.min) & (x < limits.max)
    return np.where(inside, x.astype(dtype), ends).astype(dtype)
