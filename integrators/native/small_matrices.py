"""Dense linear algebra of small matrices, without a call of a library.

A loop that calls a library (LAPACK, or a routine for matrix products) is run piece by piece, and on
small systems handing over from piece to piece costs far more than the arithmetic. The functions here
call none, so that the whole time loop becomes one compiled function (see `problems.runtime`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial, reduce
from math import prod
from operator import add
from typing import Any

from problems import runtime
from problems.runtime import jax, jnp

#: Where primitives keep the functions that they call, and the bodies of loops and branches.
_CALLS = {
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
}
_BODIES = {"while": ("cond_jaxpr", "body_jaxpr"), "cond": ("branches",), "scan": ("jaxpr",)}
#: Matrices up to this size are dealt with here; the libraries are faster with larger ones.
MOST = 32
#: The same of many matrices side by side.
MOST_OF_MANY = 13
#: A power of two above all rows.
_ROOM = 64


def inverse(a: Any) -> Any:
    """Inverse of a square matrix; where there is none, it is not finite."""
    if len(a) > MOST or not runtime.joins_loops():
        return jnp.linalg.inv(a)
    alone = jax.custom_batching.custom_vmap(_by_elimination)

    @alone.def_vmap
    def _(size: int, batched: list[bool], a: Any) -> tuple[Any, bool]:
        if a.shape[1] > MOST_OF_MANY:
            return jnp.linalg.inv(a), True
        return _side_by_side(a, jnp.broadcast_to(jnp.eye(a.shape[1]), a.shape)), True

    return alone(a)


def solve(a: Any, b: Any) -> Any:
    """Solution of a x = b for one right-hand side."""
    if len(a) > MOST or not runtime.joins_loops():
        return jnp.linalg.solve(a, b)
    alone = jax.custom_batching.custom_vmap(lambda a, b: product(inverse(a), b))

    @alone.def_vmap
    def _(size: int, batched: list[bool], *parts: Any) -> tuple[Any, bool]:
        a, b = (x if o else jnp.stack([x] * size) for x, o in zip(parts, batched, strict=True))
        many = _side_by_side if a.shape[1] <= MOST_OF_MANY else jnp.linalg.solve
        return many(a, b[:, :, None])[:, :, 0], True

    return alone(a, b)


def product(a: Any, b: Any) -> Any:
    """Product of a matrix and a vector; in terms of single columns, which XLA joins with the
    computation of the vector."""
    if len(b) > MOST:
        return a @ b
    return reduce(add, (a[:, k] * b[k] for k in range(len(b))))


def _by_elimination(a: Any) -> Any:
    """Gauss-Jordan elimination in place, with the largest pivots of the columns; instead of
    exchanging rows it remembers which row was the pivot's."""
    n, rows = len(a), jnp.arange(len(a))
    put = jax.lax.dynamic_update_index_in_dim

    def eliminate(k: Any, carry: tuple) -> tuple:
        w, row_of, column_of = carry
        column = w[:, k]
        # Floats without a sign are ordered as their bits are, and integers are compared faster;
        # the last bits make room for the row. What is not a number comes out largest.
        size = jax.lax.bitcast_convert_type(jnp.abs(column), jnp.int64) & -_ROOM | rows
        p = jnp.max(jnp.where(column_of == n, size, -1)) & (_ROOM - 1)
        row = put(w[p], 1.0, k, 0) / column[p]
        w = put(w, jnp.zeros(n), k, 1) - put(column, 0.0, p, 0)[:, None] * row
        return put(w, row, p, 0), put(row_of, p, k, 0), put(column_of, k, p, 0)

    w, row_of, column_of = jax.lax.fori_loop(0, n, eliminate, (a, *2 * (jnp.full(n, n),)))
    return w[row_of][:, column_of]


def _side_by_side(a: Any, b: Any) -> Any:
    """Solutions of a x = b for many matrices a ``(k, n, n)`` and b ``(k, n, m)``.

    Gauss-Jordan elimination with the largest pivots of the columns; the last axis is that of the
    matrices, as the processor then does the same with several at once.
    """
    w = jnp.moveaxis(jnp.concatenate([a, b], axis=2), 0, 2)
    # XLA would compute all that is cheap anew wherever it is used, and eliminate many times over.
    # It does not look into branches, and cannot tell that this is always so.
    always = jnp.isnan(w[0, 0, 0]) | (w[0, 0, 0] <= jnp.inf)
    for k in range(a.shape[1]):
        w = jax.lax.cond(always, partial(_eliminated, k), lambda w: jnp.zeros_like(w[:, 1:]), w)
    return jnp.moveaxis(w, 2, 0)


def _eliminated(k: int, w: Any) -> Any:
    """Rows without the first column, which is that of the k-th unknown, by the k-th pivot."""
    pivot = k + jnp.argmax(jnp.abs(w[k:, 0]), axis=0)
    # Choices one after the other: to look the pivots up would take the matrices one by one.
    of_pivot = w[k]
    for i in range(k + 1, len(w)):
        of_pivot = jnp.where(pivot == i, w[i], of_pivot)
    row = of_pivot[1:] / of_pivot[0]
    below = jnp.where(pivot == jnp.arange(k + 1, len(w))[:, None, None], w[k], w[k + 1 :])
    others = (part[:, 1:] - part[:, :1] * row for part in (w[:k], below))
    return jnp.concatenate([next(others), row[None], *others])


def without_products(function: Callable) -> Callable:
    """The function with products of small matrices written as sums, in loops and branches, too."""

    def rewritten(*args: Any) -> Any:
        closed, shape = jax.make_jaxpr(function, return_shape=True)(*args)
        out = _evaluate(closed, jax.tree.leaves(args))
        return jax.tree.unflatten(jax.tree.structure(shape), out)

    return rewritten


def _evaluate(closed: Any, args: list) -> list:
    """Evaluate a closed jaxpr, products of small matrices as sums."""
    from jax.extend.core import Literal

    jaxpr = closed.jaxpr
    values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*closed.consts, *args], strict=True))

    def value(atom: Any) -> Any:
        return atom.val if isinstance(atom, Literal) else values[atom]

    for equation in jaxpr.eqns:
        given, name = [value(atom) for atom in equation.invars], equation.primitive.name
        params = equation.params
        numbers = params.get("dimension_numbers")
        if name == "dot_general" and _is_small_product(given[0], given[1], numbers):
            out = [_as_sum(given[0], given[1], numbers)]
        elif name in _CALLS:
            out = _evaluate(params[_CALLS[name]], given)
        else:
            if name in _BODIES:
                params = params | {key: _rewritten(params[key]) for key in _BODIES[name]}
            out = equation.primitive.bind(*given, **params)
            out = out if equation.primitive.multiple_results else [out]
        values.update(zip(equation.outvars, out, strict=True))
    return [value(atom) for atom in jaxpr.outvars]


def _rewritten(body: Any) -> Any:
    if isinstance(body, tuple):
        return tuple(map(_rewritten, body))
    return jax.make_jaxpr(lambda *args: _evaluate(body, list(args)))(*body.in_avals)


def _is_small_product(a: Any, b: Any, numbers: tuple) -> bool:
    """Whether both factors are small matrices: products with a vector need no library."""
    (contracted, _), (batched, _) = numbers
    inner, copies = (prod(a.shape[k] for k in axes) for axes in (contracted, batched))
    rows, columns = (x.size // max(inner * copies, 1) for x in (a, b))
    return min(rows, columns) > 1 and inner <= MOST and copies * rows * inner * columns <= MOST**3


def _as_sum(a: Any, b: Any, numbers: tuple) -> Any:
    """``dot_general`` as the sum of columns of a times rows of b."""

    def ordered(x: Any, contracted: tuple, batched: tuple) -> tuple[Any, int]:
        """Batched axes, free axes, and the contracted ones as one; and how many are free."""
        free = [k for k in range(x.ndim) if k not in (*contracted, *batched)]
        x = jnp.transpose(x, (*batched, *free, *contracted))
        return jnp.reshape(x, (*x.shape[: len(batched) + len(free)], -1)), len(free)

    (of_a, of_b), (batch_a, batch_b) = numbers
    (a, free_a), (b, free_b) = ordered(a, of_a, batch_a), ordered(b, of_b, batch_b)
    first = len(batch_a)
    a = jnp.expand_dims(a, [first + free_a + k for k in range(free_b)])
    b = jnp.expand_dims(b, [first + k for k in range(free_a)])
    return reduce(add, (a[..., k] * b[..., k] for k in range(a.shape[-1])))
