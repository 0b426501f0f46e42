"""C of a graph, one line for each operation; compiled by the machine's own compiler, and loaded.

No operation is contracted or reordered, so that results differ from JAX's by the rounding of
elementary functions and of sums alone. Compilers take time with the square of the length of a
function. So a long program is cut into pieces that hand over values in an array s.
"""

from __future__ import annotations

import ctypes
import hashlib
import math
import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path

import platformdirs

from integrators.lowering.graph import OPERATORS, Graph, LoweredFunction, NotLowered, WhileLoop
from problems.base.cache import keep, kept

_COMPILER = "cc"
#: Rounding stays as written: no operations are contracted. The library is not for one processor
#: alone, as a folder of the user may be shared by several machines.
_FLAGS = ("-O1", "-fno-math-errno", "-ffp-contract=off", "-fPIC", "-shared")
_CACHE = Path(platformdirs.user_cache_dir("stepbench")) / "native"
#: Time in s for which a compiler is waited for.
_PATIENCE = 90.0

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
    results = program.results.ravel().tolist()
    return _HEADER + _function("function", program.graph, results, ["a0"], {})[0]


def _function(
    name: str, graph: Graph, results: Sequence[int], arguments: list[str], around: dict[int, str]
) -> tuple[str, int]:
    """The C of a function and of the loops in it, and the number of its operations; of a loop, with
    the places of values around it."""
    #: Node that a line computes (None: it puts a value in a place, or calls), text, nodes in it.
    lines: list[tuple[int | None, str, tuple[int, ...]]] = []
    before, inside, room = [], 0, 0  # loops, their operations, and the size of the array s
    outputs: dict[int, int] = {}  # places in s of those of loops and solves
    for node in graph.needed(results, around):
        operator, given = graph.nodes[node]
        if isinstance(operator, str):
            lines.append((node, OPERATORS[operator].c, given))
        elif isinstance(operator, int):
            place = f"s[{outputs[given[0]] + operator}]"
            lines.append((node, _read(place, graph.kind(node)), ()))
        else:  # outputs take the places of the last values given
            lines += [(None, f"s[{k}] = {{}};", (x,)) for k, x in enumerate(given, room)]
            if isinstance(operator, WhileLoop):
                source, more = _loop(f"{name}_loop_{node}", graph, operator)
                before, inside = [*before, source], inside + more
                called, count = f"{name}_loop_{node}(", len(operator.turn)
            else:
                n, m = operator
                called, count = f"solve({n}, {m}, ", n * m
            outputs[node] = room + len(given) - count
            lines.append((None, f"{called}s + {room}, s + {outputs[node]});", ()))
            room += len(given)
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
    places = dict(around)  # and of values that later pieces need
    for k, (_, _, given) in enumerate(lines):
        for node in given:
            if piece_of.get(node, k // _PIECE) != k // _PIECE and node not in places:
                places[node], room = f"s[{room}]", room + 1
    passed = [*arguments, "out", "s"]
    typed = [f"{'const ' * one.startswith('a')}double *restrict {one}" for one in passed]
    calls = []
    for first in range(0, len(lines), _PIECE):
        before.append(f"static NOINLINE void {name}_{first}({', '.join(typed)})\n{{")
        for node, text, given in lines[first : first + _PIECE]:
            here = first // _PIECE
            text = text.format(
                *(f"v{x}" if piece_of.get(x) == here else _value(graph, x, places) for x in given)
            )
            if node is not None:
                kind = "int" if graph.kind(node) == "b" else "double"
                text = f"const {kind} v{node} = {text};"
            more = f" {places[node]} = v{node};" if node in places else ""
            before.append(f"    {text}{more}")
        before.append("}")
        calls.append(f"    {name}_{first}({', '.join(passed)});")
    cleared = [f"    memset(out, 0, {len(results)} * sizeof(double));"] * bool(zeros)
    head = f"void {name}({', '.join(typed[:-1])})\n{{\n    double s[{max(1, room)}];"
    return "\n".join([*before, head, *cleared, *calls, "}", ""]), count


def _loop(name: str, graph: Graph, loop: WhileLoop) -> tuple[str, int]:
    """The C of a loop on the values u that its turns change, and given ones."""
    around, arguments = {node: f"a0[{k}]" for k, node in enumerate(loop.given)}, ["a0", "a1"]
    goes_on, test = _function(f"{name}_test", graph, [loop.test], arguments, around)
    turn, body = _function(f"{name}_turn", graph, loop.turn, arguments, around)
    source = f"""
{goes_on}{turn}static NOINLINE void {name}(const double *given, double *u)
{{
    double goes_on, next[{max(1, len(loop.turn))}];
    while ({name}_test(given, u, &goes_on), goes_on != 0.0) {{
        {name}_turn(given, u, next);
        memcpy(u, next, sizeof next);
    }}
}}
"""
    return source, test + body


def _value(graph: Graph, node: int, places: dict[int, str]) -> str:
    """A value that is a constant, an input, or has a place."""
    operator, content = graph.nodes[node]
    if node in places or operator == "input":
        return _read(places.get(node) or "a{}[{}]".format(*content), graph.kind(node))
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


# ---- compiled C, kept by its content ----------------------------------------------------
@cache
def load_c(source: str) -> ctypes.CDLL:
    """Compile C, or take what was compiled before, and load it.

    Raises
    ------
    NotLowered
        If there is no compiler, it hangs or refuses the source, or the result cannot be kept or
        loaded.
    """
    compiler = shutil.which(_COMPILER)
    if compiler is None:
        raise NotLowered(f"there is no C compiler named {_COMPILER}")
    try:
        about = "\0".join((source, platform.machine(), _version(compiler), *_FLAGS))
        file = _CACHE / f"{hashlib.sha256(about.encode()).hexdigest()[:32]}.so"
        if kept(file) is not None:
            with suppress(OSError):  # of another system: it is made anew
                return ctypes.CDLL(str(file))
        keep(file, _compile(compiler, source))
        return ctypes.CDLL(str(file))
    except subprocess.TimeoutExpired as error:
        raise NotLowered(f"{_COMPILER} took more than {_PATIENCE:g} s") from error
    except OSError as error:
        raise NotLowered(f"{_COMPILER} or the folder {_CACHE} fails ({error})") from error


def _compile(compiler: str, source: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        text, new = Path(folder, "functions.c"), Path(folder, "functions.so")
        text.write_text(source, encoding="utf-8")
        command = [compiler, *_FLAGS, "-o", str(new), str(text), "-lm"]
        done = _run(command)
        if done.returncode:
            words = done.stderr.decode(errors="replace").strip().splitlines()
            raise NotLowered(f"{_COMPILER} failed: {words[0] if words else done.returncode}")
        return new.read_bytes()


@cache
def _version(compiler: str) -> str:
    """The first line of what a compiler says of itself."""
    return _run([compiler, "--version"]).stdout.decode(errors="replace").partition("\n")[0]


def _run(command: Sequence[str]) -> subprocess.CompletedProcess[bytes]:
    environment = os.environ | {"LC_ALL": "C"}
    return subprocess.run(command, capture_output=True, env=environment, timeout=_PATIENCE)
