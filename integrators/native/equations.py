"""Programs of JAX evaluated anew, equation by equation, by a rule that replaces some operations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any


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
        results = rule(equation, taken) if inner is None else evaluated(inner, taken, rule)
        values.update(zip(equation.outvars, results, strict=True))
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
