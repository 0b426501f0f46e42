"""KLU inside compiled programs: sparse matrices of one pattern, factorised, kept and freed.

klujax has these functions compiled for XLA. They are called here by name: klujax's own wrappers
sort the entries at every call, and hand a factorisation to Python's garbage collector, which does
not see those that are made within a compiled loop.

A factorisation is memory of KLU's, known by its address: an array of one integer, zero for none.
It has one owner, who frees it or hands it on. All functions are for single runs: there is no rule
for `jax.vmap`.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from problems.runtime import jax, jnp

#: KLU's complaint about a singular matrix; the compiled program ends with it.
FAILURE = "klu_factor"
_FREE = "stepbench_klu_free"


class Analysis(NamedTuple):
    """Rows and columns of the entries of a pattern, and the address of KLU's analysis of it;
    arguments of a compiled program, not constants, which XLA would fold while compiling."""

    rows: Any
    columns: Any
    address: Any


def none() -> Any:
    """No factorisation."""
    return jnp.zeros(1, jnp.uint64)


def solve(pattern: Analysis, values: Any, right: Any) -> Any:
    """Solution of the equations with these values of the pattern's entries."""
    shape = jax.ShapeDtypeStruct((1, len(right), 1), right.dtype)
    call = jax.ffi.ffi_call("solve_with_symbol_f64", shape)
    return call(
        pattern.rows, pattern.columns, values[None], right[None, :, None], _one(pattern.address)
    ).ravel()


def factorised(pattern: Analysis, values: Any, instead_of: Any) -> Any:
    """A new factorisation, with pivots of its own, after another one has been freed."""
    # The barrier keeps this order: where KLU gives up, because the matrix is singular, the program
    # ends, and nobody would free the other one. Declared as a side effect, a call is done where it
    # stands and once; XLA may do others twice, or ahead of a branch that is not taken.
    _, values = jax.lax.optimization_barrier((free(instead_of), values))
    address = jax.ShapeDtypeStruct((1,), np.uint64)
    call = jax.ffi.ffi_call("factor_f64", address, has_side_effect=True)
    return call(pattern.rows, pattern.columns, values[None], _one(pattern.address))


def solve_by(factors: Any, pattern: Analysis, right: Any) -> Any:
    """Solution of the equations with the matrix that was factorised."""
    shape = jax.ShapeDtypeStruct((1, len(right), 1), right.dtype)
    call = jax.ffi.ffi_call("solve_with_numeric_f64", shape)
    return call(_one(pattern.address), factors, right[None, :, None]).ravel()


def free(factors: Any) -> Any:
    """Give back a factorisation's memory, once; nothing is done where there is none."""
    _register()
    done = jax.ShapeDtypeStruct((1,), np.int32)
    return jax.ffi.ffi_call(_FREE, done, has_side_effect=True)(factors)


def _one(address: Any) -> Any:
    return jnp.asarray(address, jnp.uint64)


@cache
def _register() -> None:
    import klujax_cpp

    jax.ffi.register_ffi_target(_FREE, klujax_cpp.free_numeric(), platform="cpu")
