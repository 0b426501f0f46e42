"""Effects of JAX's primitives on arrays of nodes: one rule each, by the name of the primitive.

A rule gets the graph, the equation of the program and the arrays of nodes, and returns the array
of the result, or a list of several.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from integrators.lowering.graph import Graph, NotLowered
from integrators.lowering.indexing import dynamic_slice, gather, scatter
from integrators.lowering.operators import OPERATORS

RULES: dict[str, Callable[..., Any]] = {
    "dynamic_slice": dynamic_slice,
    "gather": gather,
    "scatter": scatter,
    "scatter-add": scatter,
}


def _rule(*names: str) -> Callable[[Callable], Callable]:
    def register(function: Callable) -> Callable:
        RULES.update(dict.fromkeys(names, function))
        return function

    return register


# ---- numbers, entry by entry -----------------------------------------------------------
def entrywise(graph: Graph, operator: str, *given: np.ndarray) -> np.ndarray:
    """Apply an operator to arrays of nodes of equal shapes, or scalars."""
    arrays = np.broadcast_arrays(*given)
    rows = zip(*(array.ravel().tolist() for array in arrays), strict=True)
    nodes = [graph.apply(operator, *row) for row in rows]
    return np.array(nodes, int).reshape(arrays[0].shape)


def _operator(name: str) -> Callable:
    return lambda graph, equation, *given: entrywise(graph, name, *given)


for _name in OPERATORS:
    RULES[_name] = _operator(_name)
RULES["add_any"] = RULES["add"]


@_rule("square")
def _square(graph: Graph, equation: Any, x: np.ndarray) -> np.ndarray:
    return entrywise(graph, "mul", x, x)


@_rule("one_minus_square")
def _one_minus_square(graph: Graph, equation: Any, x: np.ndarray) -> np.ndarray:
    one = np.array(graph.one)
    return entrywise(graph, "mul", entrywise(graph, "add", one, x), entrywise(graph, "sub", one, x))


@_rule("log2")
def _log2(graph: Graph, equation: Any, x: np.ndarray) -> np.ndarray:
    two = np.array(graph.constant(2.0))
    return entrywise(graph, "div", entrywise(graph, "log", x), entrywise(graph, "log", two))


@_rule("rsqrt")
def _rsqrt(graph: Graph, equation: Any, x: np.ndarray) -> np.ndarray:
    return entrywise(graph, "div", np.array(graph.one), entrywise(graph, "sqrt", x))


@_rule("logistic")
def _logistic(graph: Graph, equation: Any, x: np.ndarray) -> np.ndarray:
    one, decay = np.array(graph.one), entrywise(graph, "exp", entrywise(graph, "neg", x))
    return entrywise(graph, "div", one, entrywise(graph, "add", one, decay))


@_rule("integer_pow")
def _integer_pow(graph: Graph, equation: Any, x: np.ndarray) -> np.ndarray:
    power, product = equation.params["y"], np.full(x.shape, graph.one)
    left = abs(power)
    while left:
        if left & 1:
            product = entrywise(graph, "mul", product, x)
        left >>= 1
        if left:
            x = entrywise(graph, "mul", x, x)
    return product if power >= 0 else entrywise(graph, "div", np.array(graph.one), product)


@_rule("clamp")
def _clamp(graph: Graph, equation: Any, low: Any, x: Any, high: Any) -> np.ndarray:
    return entrywise(graph, "min", entrywise(graph, "max", x, low), high)


@_rule("select_n")
def _select_n(graph: Graph, equation: Any, which: np.ndarray, *cases: np.ndarray) -> np.ndarray:
    if len(cases) == 2 and equation.invars[0].aval.dtype == bool:
        return entrywise(graph, "choose", which, cases[1], cases[0])
    chosen = np.array([graph.value(node) for node in which.flat], int).reshape(which.shape)
    return np.choose(chosen, cases)


@_rule("convert_element_type")
def _convert(graph: Graph, equation: Any, x: np.ndarray) -> np.ndarray:
    source, target = equation.invars[0].aval.dtype.kind, equation.outvars[0].aval.dtype.kind
    if source == target or x.size == 0:
        return x
    if all(graph.is_constant(node) for node in x.flat):
        kind = bool if target == "b" else float  # JAX itself computes whole numbers
        nodes = [graph.constant(kind(graph.value(node))) for node in x.flat]
        return np.array(nodes).reshape(x.shape)
    if target == "f":
        return entrywise(graph, "number", x)
    if (source, target) == ("b", "i"):
        return entrywise(graph, "count", x)
    if (source, target) == ("f", "b"):
        return entrywise(graph, "ne", x, np.array(graph.zero))
    raise NotLowered("whole numbers depend on the state")


# ---- numbers, several into one ---------------------------------------------------------
def _folded(graph: Graph, operator: str, x: np.ndarray, axes: tuple[int, ...]) -> np.ndarray:
    """Fold axes away by an operator, from the first entry to the last."""
    kept = [k for k in range(x.ndim) if k not in axes]
    rows = np.transpose(x, [*kept, *axes]).reshape(*(x.shape[k] for k in kept), -1)
    result = rows[..., 0]
    for k in range(1, rows.shape[-1]):
        result = entrywise(graph, operator, result, rows[..., k])
    return result


for _name, _by in {
    "reduce_sum": "add", "reduce_prod": "mul", "reduce_max": "max", "reduce_min": "min",
    "reduce_and": "and", "reduce_or": "or",
}.items():  # fmt: skip
    RULES[_name] = lambda graph, equation, x, _by=_by: (
        _folded(graph, _by, x, equation.params["axes"])
        if x.size
        else _empty(graph, _by, equation.outvars[0].aval.shape)
    )


def _empty(graph: Graph, operator: str, shape: tuple[int, ...]) -> np.ndarray:
    """The result of folding nothing."""
    if operator not in ("add", "mul"):
        raise NotLowered("it has a largest entry of nothing")
    return np.full(shape, graph.zero if operator == "add" else graph.one)


for _name, _by in {"cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"}.items():

    @_rule(_name)
    def _cumulated(graph: Graph, equation: Any, x: np.ndarray, _by: str = _by) -> np.ndarray:
        axis, reverse = equation.params["axis"], equation.params["reverse"]
        rows = np.moveaxis(np.flip(x, axis) if reverse else x, axis, 0).copy()
        for k in range(1, len(rows)):
            rows[k] = entrywise(graph, _by, rows[k - 1], rows[k])
        result = np.moveaxis(rows, 0, axis)
        return np.flip(result, axis) if reverse else result


@_rule("dot_general")
def _dot_general(graph: Graph, equation: Any, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    (contracted, batch) = equation.params["dimension_numbers"]

    def arranged(x: np.ndarray, batch: Any, contracted: Any) -> np.ndarray:
        """Batch axes as one, free axes as one, contracted axes as one."""
        free = [k for k in range(x.ndim) if k not in (*batch, *contracted)]
        sizes = [int(np.prod([x.shape[k] for k in axes])) for axes in (batch, free, contracted)]
        return np.transpose(x, [*batch, *free, *contracted]).reshape(sizes)

    rows, columns = (arranged(*x) for x in zip((a, b), batch, contracted, strict=True))
    result = np.full((len(rows), rows.shape[1], columns.shape[1]), graph.zero)
    for k in range(rows.shape[2]):
        product = entrywise(graph, "mul", rows[:, :, None, k], columns[:, None, :, k])
        result = entrywise(graph, "add", result, product)
    return result


# ---- moves -----------------------------------------------------------------------------
@_rule("copy", "copy_p", "stop_gradient")
def _same(graph: Graph, equation: Any, x: np.ndarray) -> np.ndarray:
    return x


@_rule("reduce_precision")
def _reduce_precision(graph: Graph, equation: Any, x: np.ndarray) -> np.ndarray:
    if (equation.params["exponent_bits"], equation.params["mantissa_bits"]) != (11, 52):
        raise NotLowered("it rounds to fewer digits")
    return x


@_rule("optimization_barrier", "device_put")
def _all_the_same(graph: Graph, equation: Any, *given: np.ndarray) -> list[np.ndarray]:
    return list(given)


@_rule("broadcast_in_dim")
def _broadcast_in_dim(graph: Graph, equation: Any, x: np.ndarray) -> np.ndarray:
    shape, axes = equation.params["shape"], equation.params["broadcast_dimensions"]
    sizes = np.ones(len(shape), int)
    sizes[list(axes)] = x.shape
    return np.broadcast_to(x.reshape(sizes), shape)


@_rule("reshape", "squeeze", "expand_dims")
def _reshape(graph: Graph, equation: Any, x: np.ndarray) -> np.ndarray:
    return x.reshape(equation.outvars[0].aval.shape)


@_rule("transpose")
def _transpose(graph: Graph, equation: Any, x: np.ndarray) -> np.ndarray:
    return np.transpose(x, equation.params["permutation"])


@_rule("rev")
def _rev(graph: Graph, equation: Any, x: np.ndarray) -> np.ndarray:
    return np.flip(x, equation.params["dimensions"])


@_rule("tile")
def _tile(graph: Graph, equation: Any, x: np.ndarray) -> np.ndarray:
    return np.tile(x, equation.params["reps"])


@_rule("concatenate")
def _concatenate(graph: Graph, equation: Any, *given: np.ndarray) -> np.ndarray:
    return np.concatenate(given, equation.params["dimension"])


@_rule("stack")
def _stack(graph: Graph, equation: Any, *given: np.ndarray) -> np.ndarray:
    return np.stack(given, equation.params["axis"])


@_rule("unstack")
def _unstack(graph: Graph, equation: Any, x: np.ndarray) -> list[np.ndarray]:
    return list(np.moveaxis(x, equation.params["axis"], 0))


@_rule("split")
def _split(graph: Graph, equation: Any, x: np.ndarray) -> list[np.ndarray]:
    ends = np.cumsum(equation.params["sizes"])[:-1]
    return np.split(x, ends, equation.params["axis"])


@_rule("slice")
def _slice(graph: Graph, equation: Any, x: np.ndarray) -> np.ndarray:
    first, end = equation.params["start_indices"], equation.params["limit_indices"]
    strides = equation.params["strides"] or [1] * x.ndim
    return x[tuple(slice(*part) for part in zip(first, end, strides, strict=True))]


@_rule("pad")
def _pad(graph: Graph, equation: Any, x: np.ndarray, value: np.ndarray) -> np.ndarray:
    for axis, (low, high, between) in enumerate(equation.params["padding_config"]):
        rows = np.moveaxis(x, axis, 0)
        length = len(rows) + between * max(len(rows) - 1, 0)
        filled = np.full((max(low, 0) + length + max(high, 0), *rows.shape[1:]), value)
        filled[max(low, 0) : max(low, 0) + length : between + 1] = rows
        cut = slice(max(-low, 0), len(filled) - max(-high, 0))
        x = np.moveaxis(filled[cut], 0, axis)
    return x
