"""Entries that the tangent of a residual can have, read from the program of the tangent.

In contrast to asdex (`problems.sparsity`) this knows zeros in matrices of parameters, such as a
diagonal mass matrix, and needs no extra. The results of a step of the program that has no rule
depend on all that goes into it, so a tangent has no entry that is not found.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from integrators.lowering.programs import lowered
from problems.runtime import jax, jnp

if TYPE_CHECKING:
    from jax import Array
    from jax.extend.core import ClosedJaxpr
    from jaxtyping import Bool, Float


def pattern(program: ClosedJaxpr, n: int) -> Bool[np.ndarray, "m n"]:
    """Return the entries that the Jacobian of a program can have.

    Parameters
    ----------
    program
        From n unknowns ``(n,)`` to m values. Its constants that JAX traces may be any numbers.

    Raises
    ------
    NotLowered
        If the program is too large to be followed.
    """
    differs, shapes = traced_constants(program)
    unknowns = [((n,), float)] * 2

    def tangent(numbers: Array) -> Array:
        u, change, *constants = parts(numbers, [*unknowns, *shapes])
        residual = partial(with_constants, program, replaced(program, differs, constants))
        return jax.jvp(residual, (u,), (change,))[1]

    lengths = (n, n, *(math.prod(shape) for shape, _ in shapes))
    graph, results = lowered(tangent, lengths)
    changes = [graph.input(1, k) for k in range(n)]
    entries = np.zeros((results.size, n), bool)
    for row, found in zip(entries, graph.origins(results.ravel().tolist(), changes), strict=True):
        row[[*found]] = True
    return entries


def with_constants(
    program: ClosedJaxpr, constants: Sequence[Array], u: Float[Array, " n"]
) -> Array:
    """The result of a program with other constants."""
    from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

    return jaxpr_as_fun(ClosedJaxpr(program.jaxpr, constants))(u)[0]


def traced_constants(program: ClosedJaxpr) -> tuple[list[bool], list[tuple[Any, Any]]]:
    """Whether JAX traces each constant of a program; shapes and types of those that it does."""
    from jax.core import Tracer

    differs = [isinstance(x, Tracer) for x in program.consts]
    pairs = zip(program.consts, differs, strict=True)
    return differs, [(x.shape, x.dtype) for x, differ in pairs if differ]


def replaced(program: ClosedJaxpr, differs: list[bool], others: Sequence[Any]) -> list[Any]:
    """The constants of a program with others in the place of some."""
    left = iter(others)
    return [next(left) if one else x for x, one in zip(program.consts, differs, strict=True)]


def parts(numbers: Array, shapes: Sequence[tuple[tuple[int, ...], Any]]) -> list[Array]:
    """Arrays of the shapes and types, of the numbers one after the other."""
    cuts = np.cumsum([math.prod(shape) for shape, _ in shapes])[:-1]
    pieces = zip(jnp.split(numbers, cuts), shapes, strict=True)
    return [piece.reshape(shape).astype(dtype) for piece, (shape, dtype) in pieces]
