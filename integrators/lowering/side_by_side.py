"""A graph computed for many runs side by side: each number is an array with an entry for each run.

XLA works with several runs at once only where an array has nothing but runs. In a loop over vectors
of many runs it decides anew for each entry which part of a program it comes from.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from integrators.lowering.graph import LoweredFunction, NotLowered
from integrators.lowering.operators import OPERATORS
from problems.runtime import Array, Float, jnp


def side_by_side(program: LoweredFunction) -> Callable[..., list]:
    """Return a program of one vector as a function of its entries for k runs, arrays ``(k,)``.

    Its results are such arrays, in lists of the shape of the program's result.

    Raises
    ------
    NotLowered
        If the program has a loop, a solve, or an operation that has no form.
    """
    graph, results = program.graph, program.results.ravel().tolist()
    order = graph.needed(results)
    if not all(isinstance(graph.nodes[node][0], str) for node in order):
        raise NotLowered("a loop or a solve of many runs side by side has no rule")

    def evaluated(*numbers: Float[Array, " k"]) -> list:
        known: dict[int, Any] = {}

        def value(node: int) -> Any:
            operator, content = graph.nodes[node]
            if operator == "constant":
                return content
            return numbers[content[1]] if operator == "input" else known[node]

        for node in order:
            operator, given = graph.nodes[node]
            function = getattr(jnp, OPERATORS[operator].numpy.__name__)
            known[node] = function(*map(value, given))
        found = np.empty(len(results), object)
        for k, node in enumerate(results):
            found[k] = jnp.broadcast_to(jnp.asarray(value(node), float), numbers[0].shape)
        return found.reshape(program.results.shape).tolist()

    return evaluated
