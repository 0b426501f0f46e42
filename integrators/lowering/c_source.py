"""C of a graph: one line for each operation.

No operation is contracted or reordered, so that results differ from JAX's by the rounding of
elementary functions and of sums alone. Compilers take time with the square of the length of a
function. So a long program is cut into pieces that hand over values in an array s.
"""

from __future__ import annotations

import math

from integrators.lowering.graph import Entry, Graph, LoweredFunction, NotLowered, WhileLoop
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
#: Lines of a piece.
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
    graph, results = program.graph, program.results.ravel().tolist()
    #: Node that a line computes (None: it puts a value in a place, or calls), text, nodes in it.
    lines: list[tuple[int | None, str, tuple[int, ...]]] = []
    before, inside, room = [], 0, 0  # loops, their operations, and the size of the array s
    outputs: dict[int, int] = {}  # places in s of those of loops and solves
    for node in graph.needed(results):
        operator, given = graph.nodes[node]
        if isinstance(operator, str):
            lines.append((node, OPERATORS[operator].c, given))
        elif isinstance(operator, Entry):
            place = f"s[{outputs[given[0]] + operator.place}]"
            lines.append((node, _read(place, graph.kind(node)), ()))
        else:  # outputs take the places of the last values given
            lines += [(None, f"s[{k}] = {{}};", (x,)) for k, x in enumerate(given, room)]
            outputs[node] = room + len(given) - operator.outputs
            called, at = f"{name}_loop_{node}(", f"s + {room}, s + {outputs[node]});"
            room += len(given)
            if isinstance(operator, WhileLoop):
                source, more = _loop(called[:-1], operator)
                before, inside = [*before, source], inside + more
            else:
                called = f"solve({operator.unknowns}, {operator.systems}, "
            lines.append((None, called + at, ()))
    count = len(lines) + inside
    if count > _MOST_OPERATIONS:
        raise NotLowered(
            f"it has {count} operations on numbers, and a compiler is given at most "
            f"{_MOST_OPERATIONS}"
        )
    zeros = {k for k, node in enumerate(results) if node in graph.zeros}
    pairs = enumerate(results)
    lines += [(None, f"out[{k}] = {{}};", (node,)) for k, node in pairs if k not in zeros]
    piece_of = {node: k // _PIECE for k, (node, *_) in enumerate(lines)}
    kept: dict[int, int] = {}  # places in s of the values that later pieces need
    for k, (_, _, given) in enumerate(lines):
        for node in given:
            if piece_of.get(node, k // _PIECE) != k // _PIECE and node not in kept:
                kept[node], room = room, room + 1
    passed = [*(f"a{k}" for k in range(arguments)), "out", "s"]
    typed = [f"{'const ' * one.startswith('a')}double *restrict {one}" for one in passed]
    calls = []
    for first in range(0, len(lines), _PIECE):
        before.append(f"static NOINLINE void {name}_{first}({', '.join(typed)})\n{{")
        for node, text, given in lines[first : first + _PIECE]:
            here = first // _PIECE
            values = [f"v{x}" if piece_of.get(x) == here else _value(graph, x, kept) for x in given]
            text = text.format(*values)
            if node is not None:
                kind = "int" if graph.kind(node) == "b" else "double"
                text = f"const {kind} v{node} = {text};"
            keep = f" s[{kept[node]}] = v{node};" if node in kept else ""
            before.append(f"    {text}{keep}")
        before.append("}")
        calls.append(f"    {name}_{first}({', '.join(passed)});")
    cleared = [f"    memset(out, 0, {len(results)} * sizeof(double));"] * bool(zeros)
    head = f"void {name}({', '.join(typed[:-1])})\n{{\n    double s[{max(1, room)}];"
    return "\n".join([*before, head, *cleared, *calls, "}", ""]), count


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


def _value(graph: Graph, node: int, kept: dict[int, int]) -> str:
    """A value that is a constant, an input, or kept by an earlier piece."""
    operator, content = graph.nodes[node]
    if operator == "input":
        return _read("a{}[{}]".format(*content), graph.kind(node))
    if operator != "constant":
        return _read(f"s[{kept[node]}]", graph.kind(node))
    if graph.kind(node) == "b":
        return str(int(content))
    if math.isnan(content):
        return "NAN"
    if math.isinf(content):
        return "INFINITY" if content > 0 else "(-INFINITY)"
    text = repr(float(content))  # as many digits as give the same float back
    return f"({text})" if text.startswith("-") else text


def _read(place: str, kind: str) -> str:
    """A value that is kept in an array of floats."""
    return f"({place} != 0.0)" if kind == "b" else place
