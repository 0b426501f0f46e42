"""Steps of StableHLO that move entries of arrays, of whatever kind: of nodes, or of numbers.

Indices are known beforehand. Source: https://openxla.org/stablehlo/spec
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from integrators.programs import Step


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


#: Functions of a step and its arrays, all of one kind.
MOVES: dict[str, Callable[..., np.ndarray]] = {
    "broadcast_in_dim": _broadcast_in_dim,
    "concatenate": lambda step, *x: np.concatenate(x, step.numbers("dimension")[0]),
    "pad": _pad,
    "reshape": lambda step, x: x.reshape(step.made[0].shape),
    "reverse": lambda step, x: np.flip(x, step.numbers("dimensions")),
    "slice": _slice,
    "transpose": lambda step, x: np.transpose(x, step.numbers("permutation")),
}


def dynamic_slice(step: Step, x: np.ndarray, *starts: np.ndarray) -> np.ndarray:
    """A window of x; its first index is moved until the window is inside."""
    sizes = step.numbers("slice_sizes")
    return x[_window(_inside(starts, x, sizes), sizes)]


def dynamic_update_slice(
    step: Step, x: np.ndarray, update: np.ndarray, *starts: np.ndarray
) -> np.ndarray:
    """x with another window, moved likewise."""
    x = x.copy()
    x[_window(_inside(starts, x, update.shape), update.shape)] = update
    return x


def gather(step: Step, x: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Windows of x at indices, side by side."""
    numbers, sizes = step.fields("dimension_numbers"), step.numbers("slice_sizes")
    shape = step.made[0].shape
    dropped = {*numbers["collapsed_slice_dims"], *numbers["operand_batching_dims"]}
    batch = [k for k in range(len(shape)) if k not in numbers["offset_dims"]]
    kept = tuple(0 if k in dropped else slice(None) for k in range(x.ndim))
    pairs = numbers["operand_batching_dims"], numbers["start_indices_batching_dims"]
    result = np.empty(shape, x.dtype)
    for place, start in _starts(numbers, indices, numbers["start_index_map"], x.ndim, *pairs):
        window = x[_window(_inside(start, x, sizes), sizes)]
        result[_at(batch, place, len(shape))] = window[kept]
    return result


def scatter(
    step: Step,
    x: np.ndarray,
    updates: np.ndarray,
    indices: np.ndarray,
    combined: Callable[[np.ndarray, np.ndarray], np.ndarray] = lambda _, new: new,
) -> np.ndarray:
    """x with windows combined with updates, or replaced; windows outside are left out."""
    numbers = step.fields("scatter_dimension_numbers")
    dropped = {*numbers["inserted_window_dims"], *numbers["input_batching_dims"]}
    window = [k for k in range(updates.ndim) if k in numbers["update_window_dims"]]
    batch = [k for k in range(updates.ndim) if k not in window]
    lengths = iter([updates.shape[k] for k in window])
    sizes = [1 if k in dropped else next(lengths) for k in range(x.ndim)]
    axes, limits = numbers["scatter_dims_to_operand_dims"], np.subtract(x.shape, sizes)
    pairs = numbers["input_batching_dims"], numbers["scatter_indices_batching_dims"]
    result = x.copy()
    for place, start in _starts(numbers, indices, axes, x.ndim, *pairs):
        if ((start >= 0) & (start <= limits)).all():
            at, new = _window(start, sizes), updates[_at(batch, place, updates.ndim)]
            result[at] = combined(result[at], new.reshape(sizes))
    return result


#: Functions of a step, so many arrays of one kind, and indices.
INDEXED: dict[str, tuple[Callable[..., np.ndarray], int]] = {
    "dynamic_slice": (dynamic_slice, 1),
    "dynamic_update_slice": (dynamic_update_slice, 2),
    "gather": (gather, 1),
    "scatter": (scatter, 2),
}


def _starts(
    numbers: dict[str, list[int]],
    indices: np.ndarray,
    axes: list[int],
    ndim: int,
    own: list[int],
    theirs: list[int],
) -> Iterator[tuple[tuple[int, ...], np.ndarray]]:
    """Places among the indices, and the first index of the window that belongs to each.

    ``axes`` of the operand are indexed; ``own`` axes of it go with ``theirs`` of the indices.
    """
    (along,) = numbers["index_vector_dim"] or [0]
    indices = np.moveaxis(indices, along, -1) if along < indices.ndim else indices[..., None]
    for place in np.ndindex(*indices.shape[:-1]):
        start = np.zeros(ndim, int)
        start[axes] = indices[place]
        start[own] = [place[other] for other in theirs]
        yield place, start


def _inside(start: Any, x: np.ndarray, sizes: Any) -> np.ndarray:
    """The first index of a window of x, moved inside."""
    return np.clip(np.array(start, int), 0, np.subtract(x.shape, sizes))


def _at(axes: list[int], place: tuple[int, ...], ndim: int) -> tuple[Any, ...]:
    """The index of a place along some axes."""
    index: list[Any] = [slice(None)] * ndim
    for axis, number in zip(axes, place, strict=True):
        index[axis] = number
    return tuple(index)


def _window(start: Any, sizes: Any) -> tuple[slice, ...]:
    return tuple(slice(int(a), int(a) + n) for a, n in zip(start, sizes, strict=True))
