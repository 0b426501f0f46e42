"""Dense linear algebra of small matrices, without a call of a library.

XLA splits a loop that calls a library (LAPACK, or a routine for matrix products) into pieces. On
small systems the change from piece to piece costs far more than the arithmetic. These functions
call no library, so the whole time loop becomes one compiled function (see `problems.base.runtime`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial, reduce
from math import prod
from operator import add
from typing import Any

from integrators.native.algebra.jaxpr_tools import bound, evaluated, is_program, with_constants
from problems.base.runtime import Array, Float, Int, jax, jnp
from problems.equations.programs import part

#: Largest size of a matrix for these functions; the libraries are faster with larger ones.
MOST = 32
#: A power of two above all rows.
_ROOM = 64


def inverse(a: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Inverse of a square matrix; not finite if the matrix is singular."""
    if len(a) > MOST:
        with part("factorisations"):
            return jnp.linalg.inv(a)
    with part("factorisations"):
        return _by_elimination(a)


def solve(a: Float[Array, "n n"], b: Float[Array, " n"]) -> Float[Array, " n"]:
    """Solution of a x = b for one right-hand side."""
    if len(a) > MOST:
        with part("factorisations"):
            return jnp.linalg.solve(a, b)

    def by_inverse(a: Array, b: Array) -> Array:
        inverted = inverse(a)
        with part("solves"):
            return product(inverted, b)

    # An elimination has no derivative in reverse; a linear system has.
    return jax.lax.custom_linear_solve(
        partial(product, a), b, lambda _, b: by_inverse(a, b), lambda _, b: by_inverse(a.T, b)
    )


def product(a: Float[Array, "m n"], b: Float[Array, " n"]) -> Float[Array, " m"]:
    """Product of a matrix and a vector, as a sum of columns: XLA fuses it with the vector's
    computation."""
    if len(b) > MOST:
        return a @ b
    return reduce(add, (a[:, k] * b[k] for k in range(len(b))))


def weighted(
    weights: Sequence[Sequence[float]], k: Int[Array, ""] | int, values: Float[Array, "m n"]
) -> Float[Array, " n"]:
    """Sum of the rows of an array, by the k-th row of weights, for loops over k; nothing is
    computed with weights that are zero."""

    def by(row: Sequence[float], values: Array) -> Array:
        terms = [w * value for w, value in zip(row, values, strict=False) if w]
        return sum(terms, 0.0 * values[0])

    return jax.lax.switch(k, [partial(by, row) for row in weights], values)


def _by_elimination(a: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Gauss-Jordan elimination in place with the largest pivot of each column; it stores pivot
    rows instead of exchanging rows."""
    n, rows = len(a), jnp.arange(len(a))
    bits = jnp.int64 if jnp.finfo(a.dtype).bits == 64 else jnp.int32  # of a real part
    zero, one = jnp.zeros((), a.dtype), jnp.ones((), a.dtype)
    put = jax.lax.dynamic_update_index_in_dim

    def eliminate(k: Array, carry: tuple) -> tuple:
        w, row_of, column_of = carry
        column = w[:, k]
        # Floats without a sign have the order of their bits, and comparing integers is faster.
        # The last bits hold the row. NaN is the largest.
        size = jax.lax.bitcast_convert_type(jnp.abs(column), bits) & -_ROOM | rows
        p = jnp.max(jnp.where(column_of == n, size, -1)) & (_ROOM - 1)
        row = put(w[p], one, k, 0) / column[p]
        w = put(w, jnp.zeros(n, a.dtype), k, 1) - put(column, zero, p, 0)[:, None] * row
        return put(w, row, p, 0), put(row_of, p, k, 0), put(column_of, k, p, 0)

    w, row_of, column_of = jax.lax.fori_loop(0, n, eliminate, (a, *2 * (jnp.full(n, n),)))
    return w[row_of][:, column_of]


def unfused(function: Callable, *args: Any) -> Any:
    """Compute function(*args) in a branch that is always taken.

    XLA repeats cheap computations at every use, and would eliminate many times over. It does not
    look into branches, and cannot find out that this condition is always true.
    """
    function = jax.jit(function)  # so that it is traced once
    shapes = jax.eval_shape(function, *args)

    def otherwise(*_: Any) -> Any:
        return jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)

    first = jnp.real(jnp.ravel(jax.tree.leaves(args)[0])[0])
    return jax.lax.cond(jnp.isnan(first) | (first <= jnp.inf), function, otherwise, *args)


def linearised(function: Callable, *at: Any) -> tuple[Array, Callable[..., Array]]:
    """The value of a function at some arguments, its derivative along changes of them, of which all
    that does not depend on the changes is computed once."""
    programs: list[Any] = []

    def coefficients(*at: Any) -> tuple[Array, list[Array]]:
        value, linear = jax.linearize(function, *at)
        programs.append(jax.make_jaxpr(linear)(*at))
        return value, list(programs[-1].consts)

    value, constants = unfused(coefficients, *at)

    def product(*changes: Any) -> Array:
        return with_constants(programs[-1], constants, *jax.tree.leaves(changes))

    return value, product


def size(program: Any) -> int:
    """Number of steps of a program, with those of programs that it calls."""
    steps = 0
    for equation in program.eqns:
        called = [value for value in equation.params.values() if is_program(value)]
        steps += sum(map(size, called)) if called else 1
    return steps


def without_products(function: Callable) -> Callable:
    """Rewrite products of small matrices in a function as sums, in loops and branches, too."""

    def rewritten(*args: Any) -> Any:
        from jax.extend.core import jaxpr_as_fun

        closed, shape = jax.make_jaxpr(function, return_shape=True)(*args)
        given = jax.tree.leaves(args)
        takes = _has_products(closed)
        out = evaluated(closed, given, _as_sums) if takes else jaxpr_as_fun(closed)(*given)
        return jax.tree.unflatten(jax.tree.structure(shape), out)

    return rewritten


def _has_products(program: Any) -> bool:
    """Whether a program, or one that it calls, has a product of small matrices."""
    eqns = getattr(program, "jaxpr", program).eqns
    called = filter(is_program, jax.tree.leaves([one.params for one in eqns]))
    return any(map(_is_small_product, eqns)) or any(map(_has_products, called))


def _as_sums(equation: Any, given: list) -> Sequence[Any]:
    """The results of an equation; products of small matrices are sums."""
    if _is_small_product(equation):
        return [_as_sum(given[0], given[1], equation.params["dimension_numbers"])]
    return bound(equation, given, **{k: _rewritten(x) for k, x in equation.params.items()})


def _rewritten(parameter: Any) -> Any:
    """A parameter of an equation, in which bodies of loops and branches are rewritten."""
    if type(parameter) is tuple:
        return tuple(map(_rewritten, parameter))
    if not is_program(parameter) or not hasattr(parameter, "consts"):
        return parameter
    return jax.make_jaxpr(lambda *given: evaluated(parameter, given, _as_sums))(*parameter.in_avals)


def _is_small_product(equation: Any) -> bool:
    """True if it multiplies two small matrices; products with a vector need no library."""
    if equation.primitive.name != "dot_general":
        return False
    a, b = (one.aval for one in equation.invars)
    (contracted, _), (batched, _) = equation.params["dimension_numbers"]
    inner, copies = (prod(a.shape[k] for k in axes) for axes in (contracted, batched))
    rows, columns = (x.size // max(inner * copies, 1) for x in (a, b))
    return min(rows, columns) > 1 and inner <= MOST and copies * rows * inner * columns <= MOST**3


def _as_sum(a: Array, b: Array, numbers: tuple) -> Array:
    """``dot_general`` as the sum of columns of a times rows of b."""

    def ordered(x: Array, contracted: tuple, batched: tuple) -> tuple[Array, int]:
        """x with batched, free and one contracted dimension in this order; number of free ones."""
        free = [k for k in range(x.ndim) if k not in (*contracted, *batched)]
        x = jnp.transpose(x, (*batched, *free, *contracted))
        return jnp.reshape(x, (*x.shape[: len(batched) + len(free)], -1)), len(free)

    (of_a, of_b), (batch_a, batch_b) = numbers
    (a, free_a), (b, free_b) = ordered(a, of_a, batch_a), ordered(b, of_b, batch_b)
    first = len(batch_a)
    a = jnp.expand_dims(a, [first + free_a + k for k in range(free_b)])
    b = jnp.expand_dims(b, [first + k for k in range(free_a)])
    return reduce(add, (a[..., k] * b[..., k] for k in range(a.shape[-1])))
