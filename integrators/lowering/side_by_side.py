"""A graph computed for many runs side by side: each number is an array with an entry for each run.

XLA works with several runs at once only where an array has nothing but runs. In a loop over vectors
of many runs it decides anew for each entry which part of a program it comes from.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from integrators.lowering.graph import NotLowered
from integrators.lowering.operators import OPERATORS
from integrators.lowering.programs import Program
from problems.runtime import jnp

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Float


def check(program: Program) -> None:
    """Find out whether `evaluated` has a rule for all that a program needs.

    Raises
    ------
    NotLowered
        If it has a loop, a solve, or an operation that has no form.
    """
    for node in program.graph.needed(program.results.ravel().tolist()):
        if not isinstance(program.graph.nodes[node][0], str):
            raise NotLowered("a loop or a solve of many runs side by side has no rule")


def evaluated(program: Program, numbers: Sequence[Float[Array, " k"]]) -> np.ndarray:
    """Return the results of a program for k runs, as an array of arrays ``(k,)``.

    Parameters
    ----------
    program
        Of one argument, which `check` lets pass.
    numbers
        The entries of the argument.
    """
    graph, nodes = program.graph, program.results.ravel().tolist()
    known: dict[int, Any] = {}

    def value(node: int) -> Any:
        operator, content = graph.nodes[node]
        if operator == "constant":
            return content
        if operator == "input":
            return numbers[content[1]]
        return known[node]

    for node in graph.needed(nodes):
        operator, arguments = graph.nodes[node]
        function = getattr(jnp, OPERATORS[operator].numpy.__name__)
        known[node] = function(*map(value, arguments))
    shape = numbers[0].shape
    results = np.empty(len(nodes), object)
    for k, node in enumerate(nodes):
        results[k] = jnp.broadcast_to(jnp.asarray(value(node), float), shape)
    return results.reshape(program.results.shape)
