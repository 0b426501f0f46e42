"""C of a graph: one line for each operation.

No operation is contracted or reordered, so that results differ from JAX's by the rounding of
elementary functions and of sums alone. Compilers take time with the square of the length of a
function. So a long program is cut into pieces that hand over values in an array.
"""

from __future__ import annotations

import math

from integrators.lowering.graph import Entry, Loop, NotLowered, Program, Solve
from integrators.lowering.operators import OPERATORS

HEADER = """#include <math.h>
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
#: Operations of a piece.
_PIECE = 500
#: Operations that a compiler takes some four seconds for.
_MOST_OPERATIONS = 12_000


def c_function(name: str, program: Program, arguments: int) -> str:
    """A C function of so many pointers to floats, and a pointer to the results, all written.

    It is ``void name(const double *a0, const double *a1, ..., double *out)``.

    Raises
    ------
    NotLowered
        If a result needs an operation that has no form in C, or there are too many operations.
    """
    return _function(name, program, arguments)[0]


def _function(name: str, program: Program, arguments: int) -> tuple[str, int]:
    """The C of a function and of the loops in it, and the number of its operations."""
    writer = _Writer(name, program)
    loops = [_loop(writer.loop_name(node), loop) for node, loop in writer.loops.items()]
    count = len(writer.order) + sum(inside for _, inside in loops)
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
    main = [f"void {name}({head})", "{", *scratch, *writer.constants(), *calls, "}", ""]
    source = "\n".join([*(text for text, _ in loops), *pieces, *main])
    return source, count


def _loop(name: str, loop: Loop) -> tuple[str, int]:
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


class _Writer:
    def __init__(self, name: str, program: Program) -> None:
        self._name, self._graph = name, program.graph
        self._results = program.results.ravel().tolist()
        self.order = self._graph.needed(self._results)
        self.pieces = -(-len(self.order) // _PIECE)
        self._piece = {node: k // _PIECE for k, node in enumerate(self.order)}
        self._outputs: dict[int, list[int]] = {}
        for k, node in enumerate(self._results):
            self._outputs.setdefault(node, []).append(k)
        #: Places in the array s of the values that later pieces need.
        self.places: dict[int, int] = {}
        self.loops: dict[int, Loop] = {}
        several = []
        for node in self.order:
            operator, inputs = self._graph.nodes[node]
            if isinstance(operator, Entry):
                continue
            if isinstance(operator, Loop):
                self.loops[node] = operator
            if isinstance(operator, Loop | Solve):
                several.append(node)
            for given in inputs:
                if self._piece.get(given, self._piece[node]) != self._piece[node]:
                    self.places.setdefault(given, len(self.places))
        #: Size of the array s; the values of each loop and solve stand behind all others.
        self.room, self._values = len(self.places), {}
        for node in several:
            self._values[node] = self.room
            self.room += len(self._graph.nodes[node][1])

    def loop_name(self, node: int) -> str:
        """The name of the function of a loop."""
        return f"{self._name}_loop_{node}"

    def lines(self, piece: int) -> list[str]:
        """The lines of a piece."""
        lines = []
        for node in self.order[piece * _PIECE : (piece + 1) * _PIECE]:
            operator, given = self._graph.nodes[node]
            if isinstance(operator, Loop | Solve):
                lines += self._call(node, [self._text(x, piece) for x in given])
                continue
            boolean = self._graph.kind(node) == "b"
            if isinstance(operator, Entry):
                value = _read(f"s[{self._left(*given) + operator.place}]", boolean)
            else:
                value = OPERATORS[operator].c.format(*(self._text(x, piece) for x in given))
            lines.append(f"    const {'int' if boolean else 'double'} v{node} = {value};")
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

    def _call(self, node: int, given: list[str]) -> list[str]:
        """Lines that call the function of a loop or a solve, which leaves values in s."""
        operator, first = self._graph.nodes[node][0], self._values[node]
        lines = [f"    s[{first + k}] = {text};" for k, text in enumerate(given)]
        at = f"s + {first}, s + {self._left(node)}"
        if isinstance(operator, Solve):
            return [*lines, f"    solve({operator.unknowns}, {operator.systems}, {at});"]
        return [*lines, f"    {self.loop_name(node)}({at});"]

    def _left(self, node: int) -> int:
        """The first place in s of the values that a loop or a solve leaves."""
        operator, given = self._graph.nodes[node]
        return self._values[node] + len(given) - operator.left

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
