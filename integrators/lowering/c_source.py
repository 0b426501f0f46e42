"""C of a graph: one line for each operation.

No operation is contracted or reordered, so that results differ from JAX's by the rounding of
elementary functions and of sums alone. Compilers take time with the square of the length of a
function. So a long program is cut into pieces that hand over values in an array.
"""

from __future__ import annotations

import math

from integrators.lowering.graph import OPERATORS, Graph, NotLowered
from integrators.lowering.programs import Program

HEADER = """#include <math.h>
#include <stdint.h>
#include <string.h>
#define NOINLINE __attribute__((noinline))
"""
#: Operations of a piece.
_PIECE = 500
#: Operations that a compiler takes some three seconds for.
_MOST_OPERATIONS = 10_000


def c_function(name: str, program: Program, arguments: int) -> str:
    """A C function of so many pointers to floats, and a pointer to the results, all written.

    It is ``void name(const double *a0, const double *a1, ..., double *out)``.

    Raises
    ------
    NotLowered
        If a result needs an operation that has no form in C, or there are too many operations.
    """
    writer = _Writer(program)
    if len(writer.order) > _MOST_OPERATIONS:
        raise NotLowered(
            f"it has {len(writer.order)} operations on numbers, and a compiler is given at most "
            f"{_MOST_OPERATIONS}"
        )
    given = [f"const double *restrict a{k}" for k in range(arguments)]
    head = ", ".join([*given, "double *restrict out"])
    passed = ", ".join([*(f"a{k}" for k in range(arguments)), "out", "s"])
    pieces, calls = [], []
    for k in range(writer.pieces):
        piece = f"static NOINLINE void {name}_{k}({head}, double *restrict s)"
        pieces.append("\n".join([piece, "{", *writer.lines(k), "}"]))
        calls.append(f"    {name}_{k}({passed});")
    scratch = [f"    double s[{max(1, len(writer.places))}];"]
    main = [f"void {name}({head})", "{", *scratch, *writer.constants(), *calls, "}", ""]
    return "\n".join([*pieces, *main])


class _Writer:
    def __init__(self, program: Program) -> None:
        self._graph: Graph = program.graph
        self._results = program.results.ravel().tolist()
        self.order = self._graph.needed(self._results)
        self.pieces = -(-len(self.order) // _PIECE)
        self._piece = {node: k // _PIECE for k, node in enumerate(self.order)}
        self._outputs: dict[int, list[int]] = {}
        for k, node in enumerate(self._results):
            self._outputs.setdefault(node, []).append(k)
        #: Places in the array s of the values that later pieces need.
        self.places: dict[int, int] = {}
        for node in self.order:
            for given in self._graph.nodes[node][1]:
                if self._piece.get(given, self._piece[node]) != self._piece[node]:
                    self.places.setdefault(given, len(self.places))

    def lines(self, piece: int) -> list[str]:
        """The lines of a piece."""
        lines = []
        for node in self.order[piece * _PIECE : (piece + 1) * _PIECE]:
            operator, given = self._graph.nodes[node]
            kind = "int" if self._graph.kind(node) == "b" else "double"
            value = OPERATORS[operator].c.format(*(self._text(x, piece) for x in given))
            lines.append(f"    const {kind} v{node} = {value};")
            if node in self.places:
                lines.append(f"    s[{self.places[node]}] = v{node};")
            lines += [f"    out[{k}] = v{node};" for k in self._outputs.get(node, ())]
        return lines

    def constants(self) -> list[str]:
        """Lines for the results that are constants or arguments."""
        lines = []
        if self._graph.zero in self._outputs:
            lines.append(f"    memset(out, 0, {len(self._results)} * sizeof(double));")
        for node, places in self._outputs.items():
            if node not in self._piece and node != self._graph.zero:
                lines += [f"    out[{k}] = {self._text(node, 0)};" for k in places]
        return lines

    def _text(self, node: int, piece: int) -> str:
        """A value within an expression of a piece."""
        operator, content = self._graph.nodes[node]
        boolean = self._graph.kind(node) == "b"
        if operator == "input":
            return "a{}[{}]".format(*content)
        if operator != "constant":
            if self._piece[node] == piece:
                return f"v{node}"
            stored = f"s[{self.places[node]}]"
            return f"({stored} != 0.0)" if boolean else stored
        if boolean:
            return str(int(content))
        if math.isnan(content):
            return "NAN"
        if math.isinf(content):
            return "INFINITY" if content > 0 else "(-INFINITY)"
        text = repr(float(content))  # as many digits as give the same float back
        return f"({text})" if text.startswith("-") else text
