"""A graph of scalar operations, each of which stands in it once and is simplified when it comes.

A value is the number of its node. Equal operations on equal values are one node, operations on
constants are computed at once, and x + 0, 1 x, 0 x, x / 1 and double signs disappear. So a
derivative along a unit vector has only the operations that matter.

Zeros have the signs that XLA gives them, as atan2 tells them apart: x + 0 is x there, too, and
0 - x is not -x. There are two exceptions. 0 x and 0 / x are taken for a 0 whose sign is not known,
although x may turn infinite or zero. And sums begin with a term, not with 0: of -0 alone they are
-0.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

from integrators.lowering.operators import OPERATORS, TO_FLOAT
from problems.base.runtime import Array, Float, Int, jnp

#: Nodes that a graph may have, constants and operations that nobody needs included.
_MOST_NODES = 300_000


class NotLowered(Exception):
    """A program that has no form in C here; the message is a clause that says why."""


class Entry(NamedTuple):
    """The operator that takes one of the outputs of a loop or a solve."""

    place: int


class Unknown(NamedTuple):
    """The operator without a form in C."""

    name: str


_ARITHMETIC = {"negate", "add", "subtract", "multiply", "divide"}
#: Operators on whole numbers, which C keeps as floats: as counters they stay exact.
_COUNT = {"add", "subtract", "maximum", "minimum", TO_FLOAT, "select"}
_COUNT |= {"EQ", "NE", "LT", "LE", "GT", "GE"}
_LARGEST_COUNT = 10**6
_COMMUTE = {"add", "multiply", "maximum", "minimum", "EQ", "NE", "and", "or", "xor"}


class Graph:
    """Nodes in an order in which each comes after those that it needs.

    Attributes
    ----------
    nodes
        ``(operator, arguments)``; of an input ("input", (argument, entry)), of a constant
        ("constant", value). `WhileLoop` and `Solve` are operators with several outputs, each of
        which an `Entry` takes.
    """

    def __init__(self) -> None:
        self.nodes: list[tuple[Any, Any]] = []
        self._kinds: list[str] = []
        self._known: dict[Any, int] = {}
        self.zero, self.one = self.constant(0.0), self.constant(1.0)
        #: 0 x, whose sign is not known.
        self._nothing = self._node("nothing", "constant", 0.0, "f")
        self.zeros = self.zero, self._nothing

    def constant(self, value: Any) -> int:
        """The node of a float, a whole number, or true or false."""
        kind = {"b": "b", "i": "i", "u": "i", "f": "f"}[np.asarray(value).dtype.kind]
        # Of floats the bits count: 0.0 equals -0.0, and NaN nothing.
        plain = {"b": bool, "i": int, "f": float}[kind](value)
        key = kind, struct.pack("d", plain) if kind == "f" else plain
        return self._node(key, "constant", plain, kind)

    def input(self, argument: int, entry: int, kind: str = "f") -> int:
        """The node of an entry of an argument of the function."""
        return self._node(("input", argument, entry), "input", (argument, entry), kind)

    def outputs(
        self, operator: WhileLoop | Solve, given: tuple[int, ...], kinds: Iterable[str]
    ) -> list[int]:
        """The nodes of an operator's outputs, which are of these kinds."""
        key = (operator, given) if isinstance(operator, Solve) else ("loop", len(self.nodes))
        node = self._node(key, operator, given, "f")
        return [self._node((node, k), Entry(k), (node,), kind) for k, kind in enumerate(kinds)]

    def unknown(self, name: str, kind: str, given: tuple[int, ...]) -> int:
        """A new node of an operation without a form in C, which no result may need."""
        return self._node(("unknown", len(self.nodes)), Unknown(name), given, kind)

    def is_constant(self, node: int) -> bool:
        """Whether the value is known before the program runs."""
        return self.nodes[node][0] == "constant"

    def value(self, node: int) -> Any:
        """The value of a constant.

        Raises
        ------
        NotLowered
            If the node is none: whole numbers and indices must not depend on the arguments.
        """
        operator, value = self.nodes[node]
        if operator != "constant":
            raise NotLowered("it has an index or a whole number that depends on the state")
        return value

    def apply(self, operator: str, *given: int) -> int:
        """The node of an operation on nodes."""
        key = operator, *(sorted(given) if operator in _COMMUTE else given)
        known = self._known.get(key)
        if known is None:
            known = self._known[key] = self._simplest(operator, given, key)
        return known

    def each(self, operator: str, *given: Any) -> np.ndarray:
        """The nodes of an operation on arrays of nodes of equal shapes, or scalars."""
        arrays = np.broadcast_arrays(*given)
        rows = zip(*(array.ravel().tolist() for array in arrays), strict=True)
        nodes = [self.apply(operator, *row) for row in rows]
        return np.array(nodes, int).reshape(arrays[0].shape)

    def needed(self, results: Iterable[int]) -> list[int]:
        """The operations that the results need; each stands shortly before its first use.

        Raises
        ------
        NotLowered
            If one of them has no form in C.
        """
        order: dict[int, None] = {}
        waiting = [(int(node), False) for node in reversed(list(results))]
        while waiting:
            node, ready = waiting.pop()
            operator, given = self.nodes[node]
            if operator in ("constant", "input") or node in order:
                continue
            if isinstance(operator, Unknown):
                raise NotLowered(f"it has the operation {operator.name}")
            if ready:
                order[node] = None
            else:
                waiting.append((node, True))
                waiting.extend((x, False) for x in reversed(given))
        return list(order)

    def origins(self, results: Iterable[int], nodes: Iterable[int]) -> list[set[int]]:
        """For each result the numbers of those among the nodes on which it depends."""
        found = {node: {k} for k, node in enumerate(nodes)}
        first, results = min(found, default=0), list(results)
        waiting = [(node, False) for node in results]
        while waiting:
            node, ready = waiting.pop()
            operator, given = self.nodes[node]
            if node in found:
                continue
            if node < first or operator in ("constant", "input"):
                found[node] = set()
            elif ready:
                found[node] = set().union(*(found[x] for x in given))
            else:
                waiting.append((node, True))
                waiting.extend((x, False) for x in given)
        return [found[node] for node in results]

    def kind(self, node: int) -> str:
        """The kind of a value: "f" for a float, "b" for true or false, "i" for a whole number."""
        return self._kinds[node]

    def _node(self, key: Any, operator: Any, content: Any, kind: str) -> int:
        known = self._known.get(key)
        if known is None:
            if len(self.nodes) == _MOST_NODES:
                raise NotLowered(f"it has more than {_MOST_NODES} operations on numbers")
            known = self._known[key] = len(self.nodes)
            self.nodes.append((operator, content))
            self._kinds.append(kind)
        return known

    def _simplest(self, operator: str, given: tuple[int, ...], key: Any) -> int:
        if operator == "select" and given[1] == given[2]:
            return given[1]
        if operator == "select" and given[1] in self.zeros and given[2] in self.zeros:
            return self._nothing
        if operator == "select" and self.is_constant(given[0]):
            return given[1] if self.value(given[0]) else given[2]
        kinds = [self._kinds[node] for node in given]
        # JAX wraps whole numbers that are too large for their type.
        wraps = "i" in kinds and (operator not in _COUNT or any(map(self._is_large, given)))
        if all(self.is_constant(node) for node in given) and not wraps:
            known = self.constant(self._computed(operator, given))
            return self._nothing if self._nothing in given and self._is_zero(known) else known
        simple = self._signed(operator, *given) if operator in _ARITHMETIC else None
        if simple is not None:
            return simple
        kind = kinds[1] if operator == "select" else OPERATORS[operator].kind
        if wraps:
            return self.unknown("'arithmetic of whole numbers'", "i", given)
        if "i" in kinds and (operator in _ARITHMETIC or operator in ("maximum", "minimum")):
            kind = "i"
        return self._node(key, operator, given, kind)

    def _is_large(self, node: int) -> bool:
        """Whether it is a whole number with which counters might overflow."""
        constant = self.is_constant(node) and self._kinds[node] == "i"
        return constant and abs(self.value(node)) > _LARGEST_COUNT

    def _computed(self, operator: str, given: tuple[int, ...]) -> Any:
        values = [np.asarray(self.value(node)) for node in given]
        with np.errstate(all="ignore"):
            return np.asarray(OPERATORS[operator].numpy(*values))[()]

    def _signed(self, operator: str, a: int, b: int = -1) -> int | None:
        """A simpler node for -a, a + b, a - b, a b or a / b, or None."""
        minus_a, minus_b = self._negated(a), self._negated(b)
        if operator == "negate":
            return minus_a
        if operator == "add":
            if self._is_zero(a) or self._is_zero(b):
                return b if self._is_zero(a) else a
            if minus_b is not None:
                return self.apply("subtract", a, minus_b)
            return None if minus_a is None else self.apply("subtract", b, minus_a)
        if operator == "subtract":
            if self._is_zero(b):
                return a
            if a == self._nothing:
                return self.apply("negate", b)
            if minus_b is None or self._is_zero(a):
                return None
            return self.apply("add", a, minus_b)
        if a in self.zeros or (operator == "multiply" and b in self.zeros):
            return self._nothing
        if b == self.one or (operator == "multiply" and a == self.one):
            return a if b == self.one else b
        if minus_a is None and minus_b is None:
            return None
        product = self.apply(
            operator, *(x if y is None else y for x, y in ((a, minus_a), (b, minus_b)))
        )
        return self.apply("negate", product) if None in (minus_a, minus_b) else product

    def _is_zero(self, node: int) -> bool:
        """Whether it is a constant float, 0 or -0."""
        return self._kinds[node] == "f" and self.is_constant(node) and self.value(node) == 0

    def _negated(self, node: int) -> int | None:
        """-x if x is a node with a minus sign, else None."""
        if node < 0 or self.nodes[node][0] != "negate":
            return None
        return self.nodes[node][1][0]


class LoweredFunction(NamedTuple):
    """A graph, and the nodes of the entries of its only result."""

    graph: Graph
    results: Int[np.ndarray, ...]


class WhileLoop(NamedTuple):
    """An operator that goes round as long as a test says so.

    Both programs have two arguments: given values, and the values u that a turn changes. The
    operator's arguments are the given values and the first u.

    Attributes
    ----------
    test
        Whether there is another turn.
    turn
        The next u.
    """

    test: LoweredFunction
    turn: LoweredFunction

    @property
    def outputs(self) -> int:
        """The number of its outputs, which take the places of its last arguments."""
        return self.turn.results.size


class Solve(NamedTuple):
    """An operator that solves linear systems with one matrix, for given matrix and right sides."""

    unknowns: int
    systems: int

    @property
    def outputs(self) -> int:
        """The number of its outputs, which take the places of its last arguments."""
        return self.unknowns * self.systems


def side_by_side(program: LoweredFunction) -> Callable[..., list]:
    """Return a program of one vector as a function of its entries for k runs, arrays ``(k,)``.

    Its results are such arrays, in lists of the shape of the program's result. XLA works with
    several runs at once only where an array has nothing but runs. In a loop over vectors of many
    runs it decides anew for each entry which part of a program it comes from.

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
