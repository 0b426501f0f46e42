"""Programs of JAX: evaluated anew by a rule or with other constants; entries of their tangents.

In contrast to asdex (`problems.equations.sparsity`) `tangent_pattern` knows zeros in matrices of
parameters, such as a diagonal mass matrix, and needs no extra. The results of a step of the program
that has no rule depend on all that goes into it, so a tangent has no entry that is not found.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from integrators.lowering.to_graph import lowered
from problems.base.runtime import Array, Bool, Float, Int, jax, jnp

if TYPE_CHECKING:
    from jax.extend.core import ClosedJaxpr


def evaluated(
    program: Any, given: Sequence[Any], rule: Callable[[Any, list[Any]], Sequence[Any]]
) -> list[Any]:
    """Return the results of a program; functions that it calls are evaluated likewise.

    Parameters
    ----------
    program
        As `jax.make_jaxpr` makes it.
    rule
        Function of an equation and its arguments that gives its results.
    """
    from jax.extend.core import Literal

    jaxpr, constants = getattr(program, "jaxpr", program), getattr(program, "consts", ())
    values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*constants, *given], strict=True))

    def value(atom: Any) -> Any:
        return atom.val if isinstance(atom, Literal) else values[atom]

    for equation in jaxpr.eqns:
        inner, taken = _called(equation), [value(atom) for atom in equation.invars]
        # Operations are counted by names, also by those of functions that are called here.
        called = equation.params.get("name", "") if inner is not None else ""
        with jax.named_scope(f"{equation.source_info.name_stack}/{called}"):
            found = rule(equation, taken) if inner is None else evaluated(inner, taken, rule)
        values.update(zip(equation.outvars, found, strict=True))
    return [value(atom) for atom in jaxpr.outvars]


def is_program(value: Any) -> bool:
    """Whether a parameter of an equation is a program."""
    return hasattr(value, "eqns")


def bound(equation: Any, given: Sequence[Any], **changed: Any) -> list[Any]:
    """The results of an equation on other arguments, with some parameters changed."""
    results = equation.primitive.bind(*given, **equation.params | changed)
    return results if equation.primitive.multiple_results else [results]


def _called(equation: Any) -> Any | None:
    """The program that an equation calls once: the only one that it has, if it is no loop."""
    programs = [value for value in equation.params.values() if is_program(value)]
    if len(programs) != 1 or "length" in equation.params:
        return None
    jaxpr = getattr(programs[0], "jaxpr", programs[0])
    return programs[0] if len(jaxpr.invars) == len(equation.invars) else None


def tangent_pattern(program: ClosedJaxpr, n: int) -> Bool[np.ndarray, "m n"]:
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
    from jax.core import Tracer

    traced = {k: x for k, x in enumerate(program.consts) if isinstance(x, Tracer)}
    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in traced.values()]

    def tangent(u: Array, change: Array, *others: Array) -> Array:
        constants = [*program.consts]
        for k, other in zip(traced, others, strict=True):
            constants[k] = other
        return jax.jvp(partial(with_constants, program, constants), (u,), (change,))[1]

    graph, results = lowered(tangent, np.zeros(n), np.zeros(n), *shapes)
    return graph.dependence(results.ravel().tolist(), [*map(graph.input, range(n, 2 * n))])


def tangent_along(
    residual: Callable[[Float[Array, " n"]], Float[Array, " m"]],
    u: Float[Array, " n"],
    seeds: Float[np.ndarray, "k n"],
) -> list[Float[Array, " m"]]:
    """Products of a residual's tangent at u with seeds, in loops: for chains of small arrays this
    takes half as long as side by side.

    A residual splits its unknowns into groups. A seed within one group is taken by this group
    alone: no body's motion has a derivative by the multipliers.
    """
    parted, sizes = _parted(jax.make_jaxpr(residual)(u))
    cuts = np.cumsum(sizes)[:-1]
    groups, of_group = jnp.split(u, cuts), np.split(np.asarray(seeds), cuts, axis=1)
    touched = np.array([part.any(axis=1) for part in of_group])
    products: list[Any] = [None] * len(seeds)

    def along(taken: Int[np.ndarray, " g"], *seed: Array) -> Array:
        def moved(*changed: Array) -> Array:
            others = dict(zip(taken, changed, strict=True))
            return parted(*(others.get(k, group) for k, group in enumerate(groups)))

        return jax.jvp(moved, tuple(groups[k] for k in taken), seed)[1]

    for pattern in np.unique(touched, axis=1).T:
        taken, mine = np.flatnonzero(pattern), np.flatnonzero((pattern == touched.T).all(axis=1))
        parts = [jnp.asarray(of_group[k][mine]) for k in taken]
        found = jax.lax.map(lambda seed, taken=taken: along(taken, *seed), parts)
        for k, product in zip(mine, found, strict=True):
            products[k] = product
    return products


def _parted(program: ClosedJaxpr) -> tuple[Callable[..., Array], list[int]]:
    """A program as a function of the groups into which it splits its unknowns, and their sizes; of
    one group if it does not begin so."""
    from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

    inner, [u] = program.jaxpr, program.jaxpr.invars
    takers = [one for one in inner.eqns if u in one.invars]
    if len(takers) != 1 or takers[0].primitive.name != "split" or u in inner.outvars:
        return partial(with_constants, program, program.consts), [u.aval.size]
    rest = [one for one in inner.eqns if one is not takers[0]]
    names = inner.debug_info.with_unknown_names()
    groups = inner.replace(invars=takers[0].outvars, eqns=rest, debug_info=names)
    function = jaxpr_as_fun(ClosedJaxpr(groups, program.consts))
    return lambda *parts: function(*parts)[0], list(map(int, takers[0].params["sizes"]))


def with_constants(program: ClosedJaxpr, constants: Sequence[Array], *u: Array) -> Array:
    """The result of a program with other constants."""
    from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

    return jaxpr_as_fun(ClosedJaxpr(program.jaxpr, constants))(*u)[0]
