"""Gathering and scattering of nodes at indices that are known beforehand.

They mean what XLA means by them (https://openxla.org/xla/operation_semantics).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from integrators.lowering.graph import Graph, NotLowered


def dynamic_slice(graph: Graph, equation: Any, x: np.ndarray, *starts: np.ndarray) -> np.ndarray:
    """A window of x; its first index is moved until the window is inside."""
    sizes = equation.params["slice_sizes"]
    first = [graph.value(int(node)) for node in starts]
    limits = np.subtract(x.shape, sizes)
    return x[_window(np.clip(first, 0, limits), sizes)]


def gather(graph: Graph, equation: Any, x: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Windows of x at indices, side by side."""
    params = equation.params
    numbers, sizes = params["dimension_numbers"], params["slice_sizes"]
    shape = equation.outvars[0].aval.shape
    dropped = {*numbers.collapsed_slice_dims, *numbers.operand_batching_dims}
    batch = [k for k in range(len(shape)) if k not in numbers.offset_dims]
    result = np.full(shape, graph.zero)
    for place, start in _starts(
        graph,
        indices,
        numbers.start_index_map,
        x.ndim,
        numbers.operand_batching_dims,
        numbers.start_indices_batching_dims,
    ):
        start = _inside(start, np.subtract(x.shape, sizes), params["mode"])
        if start is None:
            raise NotLowered("it has an index outside of its array")
        kept = tuple(0 if k in dropped else slice(None) for k in range(x.ndim))
        into: list[Any] = [slice(None)] * len(shape)
        for axis, index in zip(batch, place, strict=True):
            into[axis] = index
        result[tuple(into)] = x[_window(start, sizes)][kept]
    return result


def scatter(
    graph: Graph, equation: Any, x: np.ndarray, indices: np.ndarray, updates: np.ndarray
) -> np.ndarray:
    """x with windows replaced by updates, or with updates added; windows outside are left out."""
    params = equation.params
    numbers, adds = params["dimension_numbers"], equation.primitive.name == "scatter-add"
    dropped = {*numbers.inserted_window_dims, *numbers.operand_batching_dims}
    window = [k for k in range(updates.ndim) if k in numbers.update_window_dims]
    batch = [k for k in range(updates.ndim) if k not in numbers.update_window_dims]
    lengths = iter([updates.shape[k] for k in window])
    sizes = [1 if k in dropped else next(lengths) for k in range(x.ndim)]
    result = x.copy()
    for place, start in _starts(
        graph,
        indices,
        numbers.scatter_dims_to_operand_dims,
        x.ndim,
        numbers.operand_batching_dims,
        numbers.scatter_indices_batching_dims,
    ):
        start = _inside(start, np.subtract(x.shape, sizes), params["mode"])
        if start is None:
            continue
        taken: list[Any] = [slice(None)] * updates.ndim
        for axis, index in zip(batch, place, strict=True):
            taken[axis] = index
        at, new = _window(start, sizes), updates[tuple(taken)].reshape(sizes)
        if adds:
            pairs = zip(result[at].ravel().tolist(), new.ravel().tolist(), strict=True)
            new = np.array([graph.apply("add", *pair) for pair in pairs], int).reshape(sizes)
        result[at] = new
    return result


def _starts(
    graph: Graph, indices: np.ndarray, axes: Any, ndim: int, own: Any, theirs: Any
) -> Iterator[tuple[tuple[int, ...], np.ndarray]]:
    """Places among the indices, and the first index of the window that belongs to each.

    ``axes`` of the operand are indexed; ``own`` axes of it go with ``theirs`` of the indices.
    """
    numbers = np.array([graph.value(node) for node in indices.flat], int).reshape(indices.shape)
    for place in np.ndindex(*indices.shape[:-1]):
        start = np.zeros(ndim, int)
        start[list(axes)] = numbers[place]
        for mine, other in zip(own, theirs, strict=True):
            start[mine] = place[other]
        yield place, start


def _inside(start: np.ndarray, limits: np.ndarray, mode: Any) -> np.ndarray | None:
    """The first index of a window, moved inside if the mode says so; None if it is outside."""
    if "clip" in str(mode).lower():
        return np.clip(start, 0, limits)
    return start if ((start >= 0) & (start <= limits)).all() else None


def _window(start: Any, sizes: Any) -> tuple[slice, ...]:
    return tuple(slice(int(a), int(a) + n) for a, n in zip(start, sizes, strict=True))
