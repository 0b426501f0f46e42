"""Entries that the tangent of a residual can have, read from the residual's program.

Every value of the program gets marks: the first says that it may differ from zero, the others on
which unknowns it may depend. A step of the program that is not known here marks all of its results
by all that goes into it, so a tangent has no entry without a mark. In contrast to asdex
(`problems.sparsity`) this knows zeros in matrices of parameters, such as a diagonal mass matrix,
and needs no extra; it does not follow loops and branches.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from jax.extend.core import ClosedJaxpr, Jaxpr
    from jaxtyping import Bool

    Marks = Bool[np.ndarray, "..."]

#: Steps whose result depends, at each place, on the arguments at this place alone.
_BY_PLACE = {
    "abs", "acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cbrt", "ceil", "cos",
    "cosh", "div", "eq", "erf", "exp", "exp2", "expm1", "floor", "ge", "gt", "integer_pow",
    "is_finite", "le", "log", "log1p", "log2", "logistic", "lt", "max", "min", "ne",
    "one_minus_square", "pow", "rem", "round",
    "rsqrt", "sign", "sin", "sinh", "sqrt", "square", "stop_gradient", "tan", "tanh",
}  # fmt: skip
#: Likewise; the result is zero where all arguments are.
_SUMS = {"add", "add_any", "convert_element_type", "copy", "neg", "sub"}
#: Steps on places, which are computed: they decide where a matrix has its zeros.
_COMPUTED: dict[str, Callable] = {
    "add": np.add, "sub": np.subtract, "eq": np.equal, "ne": np.not_equal, "lt": np.less,
    "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal,
}  # fmt: skip
#: Parameters that hold a called function.
_CALLS = {"jit": "jaxpr", "pjit": "jaxpr"}


class _Value(NamedTuple):
    #: Shape ``(1 + n, *shape)``: may differ from zero; may depend on each of n unknowns.
    marks: Marks
    #: The value, if it is the same in every run.
    known: np.ndarray | None = None


def pattern(closed: ClosedJaxpr, n: int) -> Bool[np.ndarray, "m n"]:
    """Return the entries that the Jacobian of a program can have.

    Parameters
    ----------
    closed
        Program from n unknowns ``(n,)`` to m values.
    """
    unknowns = np.concatenate([np.ones((1, n), bool), np.eye(n, dtype=bool)])
    (result,) = _followed(closed, [_Value(unknowns)], n)
    return result.marks[1:].T


def _constant(value: Any, n: int) -> _Value:
    """A value that depends on no unknown; one that JAX traces may be any number."""
    from jax.core import Tracer

    known = None if isinstance(value, Tracer) else np.asarray(value)
    marks = np.zeros((1 + n, *np.shape(value)), bool)
    marks[0] = True if known is None else known != 0
    return _Value(marks, known)


def _followed(closed: ClosedJaxpr, given: Sequence[_Value], n: int) -> list[_Value]:
    """Follow a program from its arguments to its results."""
    from jax.extend.core import Literal

    jaxpr: Jaxpr = closed.jaxpr
    constants = [_constant(value, n) for value in closed.consts]
    values: dict[Any, _Value] = dict(
        zip([*jaxpr.constvars, *jaxpr.invars], [*constants, *given], strict=True)
    )
    for equation in jaxpr.eqns:
        name, params = equation.primitive.name, equation.params
        arguments = [
            _constant(atom.val, n) if isinstance(atom, Literal) else values[atom]
            for atom in equation.invars
        ]
        if name in _CALLS:
            found = _followed(params[_CALLS[name]], arguments, n)
        elif name == "iota":
            found = [_constant(np.indices(params["shape"])[params["dimension"]], n)]
        elif name in _COMPUTED and all(one.known is not None for one in arguments):
            found = [_constant(_COMPUTED[name](*(one.known for one in arguments)), n)]
        else:
            results: list[Any] = [result.aval for result in equation.outvars]
            shapes = [result.shape for result in results]
            found = [_Value(marks) for marks in _results(name, params, arguments, shapes)]
        values.update(zip(equation.outvars, found, strict=True))
    return [
        _constant(atom.val, n) if isinstance(atom, Literal) else values[atom]
        for atom in jaxpr.outvars
    ]


def _results(
    name: str, params: dict[str, Any], arguments: list[_Value], shapes: list[tuple[int, ...]]
) -> list[Marks]:
    """Marks of the results of one step of a program."""
    marks = [argument.marks for argument in arguments]
    if name in _MOVES:
        return _MOVES[name](params, *marks)
    if name == "mul":
        return [_times(np.multiply, *_aligned(marks))]
    if name == "dot_general":
        return [_product(params["dimension_numbers"], *marks)]
    if name == "select_n":
        return [_selected(arguments[0], _aligned(marks)[1:])]
    if name in _SUMS or name in _BY_PLACE:
        result = np.logical_or.reduce(np.broadcast_arrays(*_aligned(marks)))
        result[0] |= name in _BY_PLACE
        return [result]
    every = np.zeros(len(marks[0]), bool)
    for one in marks:
        every |= one.reshape(len(one), -1).any(axis=1)
    every[0] = True
    return [np.broadcast_to(every.reshape(-1, *[1] * len(s)), (len(every), *s)) for s in shapes]


def _aligned(marks: Sequence[Marks]) -> list[Marks]:
    """Marks with as many axes as the largest has: scalars go with arrays of any shape."""
    most = max(one.ndim for one in marks)
    return [one.reshape(len(one), *[1] * (most - one.ndim), *one.shape[1:]) for one in marks]


def _times(product: Callable, a: Marks, b: Marks) -> Marks:
    """Marks of a bilinear product: a part that is zero hides the unknowns of the other."""
    every = [
        product(a[0], b[0]),
        *(product(x, b[0]) | product(a[0], y) for x, y in zip(a[1:], b[1:], strict=True)),
    ]
    return np.stack(every)


def _product(numbers: tuple, a: Marks, b: Marks) -> Marks:
    """Marks of ``dot_general``: batched axes, free ones of a, free ones of b."""
    (of_a, of_b), (batch_a, batch_b) = numbers
    names = iter("abcdefghijklmnopqrstuvwxyz")
    axes_a = {k: next(names) for k in range(a.ndim - 1)}
    axes_b = dict(zip((*of_b, *batch_b), (axes_a[k] for k in (*of_a, *batch_a)), strict=True))
    free_a = [axes_a[k] for k in axes_a if k not in (*of_a, *batch_a)]
    free_b = [axes_b.setdefault(k, next(names)) for k in range(b.ndim - 1) if k not in axes_b]
    result = [*(axes_a[k] for k in batch_a), *free_a, *free_b]
    left, right = "".join(axes_a.values()), "".join(axes_b[k] for k in range(b.ndim - 1))
    rule = f"{left},{right}->{''.join(result)}"
    return _times(lambda x, y: np.einsum(rule, x.astype(int), y.astype(int)) > 0, a, b)


def _selected(which: _Value, cases: list[Marks]) -> Marks:
    if which.known is None:
        return np.logical_or.reduce(np.broadcast_arrays(*cases))
    cases = list(np.broadcast_arrays(*cases, np.empty((1, *which.known.shape), bool))[:-1])
    return (
        np.where(np.broadcast_to(which.known.astype(int), cases[0].shape) == 0, cases[0], cases[-1])
        if len(cases) == 2
        else np.logical_or.reduce(cases)
    )


def _broadcast(params: dict[str, Any], x: Marks) -> list[Marks]:
    shape = [1] * len(params["shape"])
    for k, axis in enumerate(params["broadcast_dimensions"]):
        shape[axis] = x.shape[1 + k]
    return [np.broadcast_to(x.reshape(len(x), *shape), (len(x), *params["shape"]))]


def _slice(params: dict[str, Any], x: Marks) -> list[Marks]:
    strides = params["strides"] or (1,) * (x.ndim - 1)
    cuts = zip(params["start_indices"], params["limit_indices"], strides, strict=True)
    return [x[(slice(None), *(slice(*map(int, cut)) for cut in cuts))]]


def _pad(params: dict[str, Any], x: Marks, fill: Marks) -> list[Marks]:
    sides = [tuple(map(int, one)) for one in params["padding_config"]]
    shape = [
        low + high + size + max(size - 1, 0) * inner
        for (low, high, inner), size in zip(sides, x.shape[1:], strict=True)
    ]
    if min((0, *(min(one) for one in sides))) < 0:  # cut off: rare
        every = x.any(axis=tuple(range(1, x.ndim))) | fill
        return [np.broadcast_to(every.reshape(-1, *[1] * len(shape)), (len(x), *shape))]
    result = np.broadcast_to(fill.reshape(-1, *[1] * len(shape)), (len(x), *shape)).copy()
    result[
        (
            slice(None),
            *(
                slice(low, low + (size - 1) * (inner + 1) + 1 if size else low, inner + 1)
                for (low, _, inner), size in zip(sides, x.shape[1:], strict=True)
            ),
        )
    ] = x
    return [result]


def _split(params: dict[str, Any], x: Marks) -> list[Marks]:
    return np.split(x, np.cumsum(params["sizes"])[:-1], axis=1 + params["axis"])


def _unstack(params: dict[str, Any], x: Marks) -> list[Marks]:
    return list(np.moveaxis(x, 1 + params["axis"], 0))


#: Steps that move entries.
_MOVES: dict[str, Callable[..., list[Marks]]] = {
    "broadcast_in_dim": _broadcast,
    "concatenate": lambda p, *x: [np.concatenate(x, axis=1 + p["dimension"])],
    "pad": _pad,
    "reduce_sum": lambda p, x: [x.any(axis=tuple(1 + axis for axis in p["axes"]))],
    "reshape": lambda p, x: [x.reshape(len(x), *p["new_sizes"])],
    "slice": _slice,
    "split": _split,
    "squeeze": lambda p, x: [x.squeeze(tuple(1 + k for k in p["dimensions"]))],
    "stack": lambda p, *x: [np.stack(x, axis=1 + p["axis"])],
    "transpose": lambda p, x: [x.transpose(0, *(1 + k for k in p["permutation"]))],
    "tile": lambda p, x: [np.tile(x, (1, *p["reps"]))],
    "unstack": _unstack,
}
