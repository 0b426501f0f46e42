"""Programs in 32-bit floats, and programs that solve in 32 bits what they state in 64.

A program in `single` precision is traced as any other, in 64 bits, and evaluated anew with each of
its floats in 32 bits: constants of the scene and of the method too, whatever wrote them. Integers
stay. Time follows from the number of the step, so that no rounding of it adds up.

In mixed precision states and residuals have 64 bits; tangents are rounded, inverted and applied in
32 (`RoundedSolver`). Newton's method then is an iterative refinement: an iteration gains some seven
digits, less those of the tangent's condition, and the 64-bit residual says where it ends.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from integrators.native import small_matrices
from integrators.native.equations import bound, evaluated, is_program
from integrators.native.linear_solvers import DenseSolver, Once, Residual
from problems.named_equations import part
from problems.runtime import Array, Float, jax, jnp, single_floats

PRECISIONS = ("double", "single", "mixed")
#: Least relative tolerance of Newton's method in single: 16 units in the last place.
TOLERANCE = 16 * float(np.finfo(np.float32).eps)
_NARROW = {np.dtype(np.float64): np.dtype(np.float32), np.dtype("c16"): np.dtype("c8")}
_WIDE = {narrow: wide for wide, narrow in _NARROW.items()}


@dataclass(frozen=True)
class RoundedSolver(DenseSolver):
    """Solves in 32-bit floats with full matrices; modified Newton keeps the inverse."""

    joins: bool = False

    def once(self, residual: Residual, u: Float[Array, " n"]) -> Once:
        inverse = self.renewed(residual, u, u)
        with part("residuals"):
            r = residual(u)
        with part("solves"):
            return Once(self.update(inverse, r))

    def nothing_kept(self, size: int) -> Array:
        return super().nothing_kept(size).astype(jnp.float32)

    def renewed(self, residual: Residual, u: Float[Array, " n"], kept: Array) -> Array:
        with part("Jacobians"):
            tangent = jax.jacfwd(residual)(u)
        return small_matrices.inverse(tangent.astype(jnp.float32))

    def update(self, kept: Array, r: Float[Array, " n"]) -> Float[Array, " n"]:
        return small_matrices.product(kept, r.astype(jnp.float32)).astype(r.dtype)


def single(function: Callable) -> Callable:
    """Return a function with 32-bit floats wherever a function has 64-bit ones."""

    def narrowed(*args: Any) -> Any:
        wide = jax.tree.map(lambda x: _abstract(x, _WIDE), args)
        with single_floats():
            program, shape = jax.make_jaxpr(function, return_shape=True)(*wide)
        found = evaluated(program, [*map(_rounded, jax.tree.leaves(args))], _in_single)
        return jax.tree.unflatten(jax.tree.structure(shape), map(_rounded, found))

    return narrowed


def _abstract(x: Any, types: dict[np.dtype, np.dtype]) -> jax.ShapeDtypeStruct:
    """Shape and type of an array, with another type where there is one."""
    weak = getattr(x, "weak_type", False)
    return jax.ShapeDtypeStruct(x.shape, types.get(x.dtype, x.dtype), weak_type=weak)


def _rounded(x: Any) -> Any:
    """An array, or a constant, with 32-bit floats."""
    if isinstance(x, float):
        return np.float32(x)
    narrow = _NARROW.get(getattr(x, "dtype", None))  # pyright: ignore[reportArgumentType]
    with np.errstate(over="ignore"):  # constants beyond the range are infinite
        return x if narrow is None else x.astype(narrow)


def _in_single(equation: Any, given: list[Any]) -> Sequence[Any]:
    """The results of an equation in 32-bit floats."""
    given = [*map(_rounded, given)]
    if equation.primitive.name == "bitcast_convert_type":
        same_bits = jax.lax.bitcast_convert_type(given[0], jnp.int32)
        return [same_bits.astype(equation.params["new_dtype"])]
    return bound(equation, given, **{k: _parameter(x) for k, x in equation.params.items()})


def _parameter(parameter: Any) -> Any:
    """A parameter of an equation: types, and programs of loops and branches."""
    if isinstance(parameter, tuple):
        of = type(parameter)
        parts = map(_parameter, parameter)
        return of(*parts) if hasattr(parameter, "_fields") else of(parts)
    if isinstance(parameter, np.dtype):
        return _NARROW.get(parameter, parameter)
    if not is_program(parameter):
        return parameter

    def body(*given: Any) -> list[Any]:
        return [*map(_rounded, evaluated(parameter, given, _in_single))]

    variables = getattr(parameter, "jaxpr", parameter).invars
    made = jax.make_jaxpr(body)(*(_abstract(x.aval, _NARROW) for x in variables))
    # Sums of scattered entries, say, have a program without constants.
    return made if hasattr(parameter, "consts") else made.jaxpr
