"""C of a graph: one function, one line for each operation, in their order.

No operation is contracted or reordered, so that results differ from JAX's by the rounding of
elementary functions and of sums alone.
"""

from __future__ import annotations

import math

import numpy as np

from integrators.lowering.graph import OPERATORS, Graph
from integrators.lowering.programs import Program

HEADER = "#include <math.h>\n#include <stdint.h>\n#include <string.h>\n"


def c_function(name: str, program: Program, arguments: int) -> str:
    """A C function of so many pointers to floats, and a pointer to the results, all written.

    It is ``void name(const double *a0, const double *a1, ..., double *out)``.

    Raises
    ------
    NotLowered
        If a result needs an operation that has no form in C.
    """
    graph, results = program.graph, program.results.ravel().tolist()
    given = "".join(f"const double *restrict a{k}, " for k in range(arguments))
    lines = [f"void {name}({given}double *restrict out)", "{"]
    lines += [_line(graph, node) for node in graph.needed(results)]
    zeros = [k for k, node in enumerate(results) if node == graph.zero]
    if zeros:
        lines.append(f"    memset(out, 0, {len(results)} * sizeof(double));")
    lines += [
        f"    out[{k}] = {_text(graph, node)};"
        for k, node in enumerate(results)
        if node != graph.zero
    ]
    return "\n".join([*lines, "}", ""])


def _line(graph: Graph, node: int) -> str:
    operator, given = graph.nodes[node]
    kind = "int" if graph.kind(node) == "b" else "double"
    if operator == "input":
        value = "a{}[{}]".format(*given)
    else:
        value = OPERATORS[operator].c.format(*(_text(graph, x) for x in given))
    return f"    const {kind} v{node} = {value};"


def _text(graph: Graph, node: int) -> str:
    """A value within an expression."""
    if not graph.is_constant(node):
        return f"v{node}"
    value = graph.value(node)
    if graph.kind(node) == "b":
        return str(int(value))
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    # Seventeen digits give the same float back.
    text = repr(float(np.float64(value)))
    return f"({text})" if text.startswith("-") else text
