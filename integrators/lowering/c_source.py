"""C of a graph: one line for each operation.

No operation is contracted or reordered, so that results differ from JAX's by the rounding of
elementary functions and of sums alone. Compilers take time with the square of the length of a
function. So a long program is cut into pieces that hand over values in an array.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from integrators.lowering.graph import Entry, LoweredFunction, NotLowered, Solve, WhileLoop
from integrators.lowering.operators import OPERATORS

_HEADER = """#include <math.h>
#include <stdint.h>
#include <string.h>
#define NOINLINE __attribute__((noinline))

/* A X = B by elimination with pivots; n rows, m columns of B, which becomes X. */
__attribute__((unused))
static NOINLINE void solve(int n, int m, double *restrict a, double *restrict b)
{
    for (int k = 0; k < n; k++) {
        int pivot = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(a[i * n + k]) > fabs(a[pivot * n + k]))
                pivot = i;
        if (pivot != k) {
            for (int j = k; j < n; j++) {
                double kept = a[k * n + j];
                a[k * n + j] = a[pivot * n + j];
                a[pivot * n + j] = kept;
            }
            for (int j = 0; j < m; j++) {
                double kept = b[k * m + j];
                b[k * m + j] = b[pivot * m + j];
                b[pivot * m + j] = kept;
            }
        }
        for (int i = k + 1; i < n; i++) {
            double factor = a[i * n + k] / a[k * n + k];
            if (factor == 0.0)
                continue;
            for (int j = k + 1; j < n; j++)
                a[i * n + j] -= factor * a[k * n + j];
            for (int j = 0; j < m; j++)
                b[i * m + j] -= factor * b[k * m + j];
        }
    }
    for (int k = n - 1; k >= 0; k--)
        for (int j = 0; j < m; j++) {
            double left = b[k * m + j];
            for (int i = k + 1; i < n; i++)
                left -= a[k * n + i] * b[i * m + j];
            b[k * m + j] = left / a[k * n + k];
        }
}
"""
#: Lines of a piece, beside those that keep a value for a later piece.
_PIECE = 500
#: Operations, and values given to loops and solves, that a compiler takes some ten seconds for; a
#: third of that in trees of bodies, of which those of an arm of seven joints are fewer.
_MOST_OPERATIONS = 25_000


def c_function(program: LoweredFunction) -> str:
    """The C of ``void function(const double *a0, double *out)``, which writes all results.

    Raises
    ------
    NotLowered
        If a result needs an operation that has no form in C, or there are too many operations.
    """
    return _HEADER + _function("function", program, 1)[0]


def _function(name: str, program: LoweredFunction, arguments: int) -> tuple[str, int]:
    """The C of a function and of the loops in it, and the number of its operations."""
    writer = _Writer(name, program)
    loops = [_loop(writer.loop_name(node), loop) for node, loop in writer.loops.items()]
    count = writer.count + sum(inside for _, inside in loops)
    if count > _MOST_OPERATIONS:
        raise NotLowered(
            f"it has {count} operations on numbers, and a compiler is given at most "
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
    scratch = [f"    double s[{max(1, writer.room)}];"]
    main = [f"void {name}({head})", "{", *scratch, *writer.zeros(), *calls, "}", ""]
    source = "\n".join([*(text for text, _ in loops), *pieces, *main])
    return source, count


def _loop(name: str, loop: WhileLoop) -> tuple[str, int]:
    """The C of a loop on the values u that its turns change, and given ones."""
    goes_on, test = _function(f"{name}_test", loop.test, 2)
    turn, body = _function(f"{name}_turn", loop.turn, 2)
    source = f"""
{goes_on}{turn}static NOINLINE void {name}(const double *given, double *u)
{{
    double goes_on, next[{max(1, loop.turn.results.size)}];
    while ({name}_test(given, u, &goes_on), goes_on != 0.0) {{
        {name}_turn(given, u, next);
        memcpy(u, next, sizeof next);
    }}
}}
"""
    return source, test + body


class _Line(NamedTuple):
    """A line of a piece: `node` is computed, or called, or its value is put in a place."""

    node: int
    #: An array of C and an entry of it; None if the node is computed or called.
    place: tuple[str, int] | None = None


class _Writer:
    def __init__(self, name: str, program: LoweredFunction) -> None:
        self._name, self._graph = name, program.graph
        self._results = program.results.ravel().tolist()
        #: Size of the array s: the values of each loop and solve, then those for later pieces.
        self.room, self._values = 0, {}
        self.loops: dict[int, WhileLoop] = {}
        order = self._graph.needed(self._results)
        outputs: dict[int, list[int]] = {}
        for k, node in enumerate(self._results):
            outputs.setdefault(node, []).append(k)
        computed, self._lines = set(order), []
        for node in [*(node for node in outputs if node not in computed), *order]:
            if node in computed:
                self._lines += [*self._arguments(node), _Line(node)]
            if node not in self._graph.zeros:
                self._lines += [_Line(node, ("out", k)) for k in outputs.get(node, ())]
        self.count = sum(line.place is None or line.place[0] == "s" for line in self._lines)
        self.pieces = -(-len(self._lines) // _PIECE)
        self._piece = {
            line.node: k // _PIECE for k, line in enumerate(self._lines) if line.place is None
        }
        #: Places in the array s of the values that later pieces need.
        self.places: dict[int, int] = {}
        for k, line in enumerate(self._lines):
            for node in self._used(line):
                if self._piece.get(node, k // _PIECE) != k // _PIECE and node not in self.places:
                    self.places[node] = self.room
                    self.room += 1

    def _arguments(self, node: int) -> list[_Line]:
        """The lines that put the values given to a loop or a solve in their places."""
        operator, given = self._graph.nodes[node]
        if not isinstance(operator, WhileLoop | Solve):
            return []
        if isinstance(operator, WhileLoop):
            self.loops[node] = operator
        first = self._values[node] = self.room
        self.room += len(given)
        return [_Line(x, ("s", first + k)) for k, x in enumerate(given)]

    def _used(self, line: _Line) -> tuple[int, ...]:
        """The nodes whose values stand in a line."""
        operator, given = self._graph.nodes[line.node]
        if line.place is not None:
            return (line.node,)
        return () if isinstance(operator, Entry | WhileLoop | Solve) else given

    def loop_name(self, node: int) -> str:
        """The name of the function of a loop."""
        return f"{self._name}_loop_{node}"

    def lines(self, piece: int) -> list[str]:
        """The lines of a piece."""
        lines = []
        for node, place in self._lines[piece * _PIECE : (piece + 1) * _PIECE]:
            operator, given = self._graph.nodes[node]
            if place is not None:
                lines.append("    {}[{}] = {};".format(*place, self._text(node, piece)))
                continue
            if isinstance(operator, WhileLoop | Solve):
                lines.append(self._call(node))
                continue
            boolean = self._graph.kind(node) == "b"
            if isinstance(operator, Entry):
                value = _read(f"s[{self._outputs(*given) + operator.place}]", boolean)
            else:
                value = OPERATORS[operator].c.format(*(self._text(x, piece) for x in given))
            lines.append(f"    const {'int' if boolean else 'double'} v{node} = {value};")
            if node in self.places:
                lines.append(f"    s[{self.places[node]}] = v{node};")
        return lines

    def zeros(self) -> list[str]:
        """A line for the results that are zero, if there are any."""
        if not {*self._graph.zeros} & {*self._results}:
            return []
        return [f"    memset(out, 0, {len(self._results)} * sizeof(double));"]

    def _call(self, node: int) -> str:
        """The call of the function of a loop or a solve, whose outputs are in s."""
        operator, at = self._graph.nodes[node][0], f"s + {self._values[node]}"
        at = f"{at}, s + {self._outputs(node)}"
        if isinstance(operator, Solve):
            return f"    solve({operator.unknowns}, {operator.systems}, {at});"
        return f"    {self.loop_name(node)}({at});"

    def _outputs(self, node: int) -> int:
        """The first place in s of the outputs of a loop or a solve."""
        operator, given = self._graph.nodes[node]
        return self._values[node] + len(given) - operator.outputs

    def _text(self, node: int, piece: int) -> str:
        """A value within an expression of a piece."""
        operator, content = self._graph.nodes[node]
        boolean = self._graph.kind(node) == "b"
        if operator == "input":
            return _read("a{}[{}]".format(*content), boolean)
        if operator != "constant":
            if self._piece[node] == piece:
                return f"v{node}"
            return _read(f"s[{self.places[node]}]", boolean)
        if boolean:
            return str(int(content))
        if math.isnan(content):
            return "NAN"
        if math.isinf(content):
            return "INFINITY" if content > 0 else "(-INFINITY)"
        text = repr(float(content))  # as many digits as give the same float back
        return f"({text})" if text.startswith("-") else text


def _read(place: str, boolean: bool) -> str:
    """A value that is kept in an array of floats."""
    return f"({place} != 0.0)" if boolean else place
