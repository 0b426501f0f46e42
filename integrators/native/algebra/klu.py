"""KLU inside compiled programs: factorise, keep and free sparse matrices of one pattern.

klujax has these functions compiled for XLA. This module calls them by name, because klujax's own
wrappers sort the entries at every call. They also leave it to Python's garbage collector to free a
factorisation, and it does not see those of a compiled loop.

KLU owns the memory of a factorisation. A program holds its address: an array of one integer, zero
for none. It has one owner, who frees it or passes it to the next owner. All functions are for
single runs: there is no rule for `jax.vmap`.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple, TypeAlias

import numpy as np

from problems.base.runtime import Array, Float, Int, UInt, jax, jnp

#: The address of a factorisation, one integer; zero for none.
Address: TypeAlias = UInt[Array, " one"]

#: KLU's complaint about a singular matrix; the compiled program ends with it.
FAILURE = "klu_factor"
_FREE = "stepbench_klu_free"


class Analysis(NamedTuple):
    """Rows and columns of the entries of a pattern, and the address of KLU's analysis of it.

    They are arguments of a compiled program: XLA would fold constants while compiling.
    """

    rows: Int[np.ndarray, " e"]
    columns: Int[np.ndarray, " e"]
    address: np.ndarray


def none() -> Address:
    """The address that stands for no factorisation."""
    return jnp.zeros(1, jnp.uint64)


def solve_once(
    pattern: Analysis, values: Float[Array, " e"], right: Float[Array, " n"]
) -> Float[Array, " n"]:
    """Solve the equations of a matrix with these values of the pattern's entries."""
    shape = jax.ShapeDtypeStruct((1, len(right), 1), right.dtype)
    call = jax.ffi.ffi_call("solve_with_symbol_f64", shape)
    return call(
        pattern.rows, pattern.columns, values[None], right[None, :, None], _one(pattern.address)
    ).ravel()


def factorised(pattern: Analysis, values: Float[Array, " e"], instead_of: Address) -> Address:
    """Free the factorisation ``instead_of`` and return a new one, with pivots of its own."""
    # The barrier keeps this order: a singular matrix ends the program, and nobody would free the
    # old factorisation. A call with a declared side effect runs once, in its place; XLA may run
    # others twice, or ahead of a branch that is not taken.
    _, values = jax.lax.optimization_barrier((free(instead_of), values))
    address = jax.ShapeDtypeStruct((1,), np.uint64)
    call = jax.ffi.ffi_call("factor_f64", address, has_side_effect=True)
    return call(pattern.rows, pattern.columns, values[None], _one(pattern.address))


def solve_by(factors: Address, pattern: Analysis, right: Float[Array, " n"]) -> Float[Array, " n"]:
    """Solve the equations of a factorised matrix."""
    shape = jax.ShapeDtypeStruct((1, len(right), 1), right.dtype)
    call = jax.ffi.ffi_call("solve_with_numeric_f64", shape)
    return call(_one(pattern.address), factors, right[None, :, None]).ravel()


def free(factors: Address) -> Array:
    """Free a factorisation's memory; nothing happens if the address is zero."""
    _register()
    done = jax.ShapeDtypeStruct((1,), np.int32)
    return jax.ffi.ffi_call(_FREE, done, has_side_effect=True)(factors)


def _one(address: np.ndarray) -> Array:
    return jnp.asarray(address, jnp.uint64)


@cache
def _register() -> None:
    import klujax_cpp

    jax.ffi.register_ffi_target(_FREE, klujax_cpp.free_numeric(), platform="cpu")
