"""A graph of scalar operations, each of which stands in it once and is simplified when it comes.

A value is the number of its node. Equal operations on equal values are one node, operations on
constants are computed at once, and x + 0, 1 x, 0 x and x / 1 disappear. So a derivative along a
unit vector has only the operations that matter.

Zeros have the signs that XLA gives them, as atan2 tells them apart: x + 0 is x there, too, and
0 - x is not -x. There are two exceptions. 0 x and 0 / x are taken for a 0 whose sign is not known,
although x may turn infinite or zero. And sums begin with a term, not with 0: of -0 alone they are
-0.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Container, Iterable, Sequence
from functools import reduce
from operator import or_
from typing import Any, NamedTuple

import numpy as np

from problems.base.runtime import Bool, Int

#: Nodes that a graph may have, constants and operations that nobody needs included.
_MOST_NODES = 300_000
#: Floating-point operations of an elementary function, such as sin or exp; about what their
#: polynomials take.
ELEMENTARY = 10
#: Converts what is true or false.
TO_FLOAT = "to_float"


class Operator(NamedTuple):
    """An operation on numbers, in `OPERATORS` by its name in StableHLO; comparisons go by their
    directions.

    Attributes
    ----------
    c
        How C writes it.
    numpy
        The function of arrays.
    cost
        Its floating-point operations.
    kind
        The kind of its result: "f" for a number, "b" for true or false.
    """

    c: str
    numpy: Callable[..., Any]
    cost: int = 0
    kind: str = "f"


#: Functions that C and NumPy call alike, where StableHLO has other names.
_RENAMED = {
    "sine": "sin",
    "cosine": "cos",
    "exponential": "exp",
    "exponential_minus_one": "expm1",
    "log_plus_one": "log1p",
}
_ELEMENTARY = ("log", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh")
_FUNCTIONS = {**_RENAMED, **{name: name for name in (*_ELEMENTARY, "atanh", "cbrt")}}
# As in JAX, NaN wins in maximum and minimum, and -0 is less than 0.
_LARGER = "{0} > {1} || {0} != {0} || ({0} == {1} && signbit((double){1})) ? {0} : {1}"
_SMALLER = "{0} < {1} || {0} != {0} || ({0} == {1} && signbit((double){0})) ? {0} : {1}"
OPERATORS = {
    "add": Operator("{} + {}", np.add, 1),
    "subtract": Operator("{} - {}", np.subtract, 1),
    "multiply": Operator("{} * {}", np.multiply, 1),
    "divide": Operator("{} / {}", np.divide, 1),
    "remainder": Operator("fmod({}, {})", np.fmod, 1),
    "sqrt": Operator("sqrt({})", np.sqrt, 1),
    **{
        name: Operator(f"{function}({{}})", getattr(np, function), ELEMENTARY)
        for name, function in _FUNCTIONS.items()
    },
    "power": Operator("pow({}, {})", np.power, ELEMENTARY),
    "atan2": Operator("atan2({}, {})", np.arctan2, ELEMENTARY),
    "negate": Operator("-{}", np.negative),
    "abs": Operator("fabs({})", np.abs),
    "maximum": Operator(_LARGER, np.maximum),
    "minimum": Operator(_SMALLER, np.minimum),
    "sign": Operator("{0} > 0 ? 1.0 : {0} < 0 ? -1.0 : {0}", np.sign),
    "round_nearest_even": Operator("rint({})", np.rint),
    "floor": Operator("floor({})", np.floor),
    "ceil": Operator("ceil({})", np.ceil),
    "EQ": Operator("{} == {}", np.equal, kind="b"),
    "NE": Operator("{} != {}", np.not_equal, kind="b"),
    "LT": Operator("{} < {}", np.less, kind="b"),
    "LE": Operator("{} <= {}", np.less_equal, kind="b"),
    "GT": Operator("{} > {}", np.greater, kind="b"),
    "GE": Operator("{} >= {}", np.greater_equal, kind="b"),
    "and": Operator("{} & {}", np.bitwise_and, kind="b"),
    "or": Operator("{} | {}", np.bitwise_or, kind="b"),
    "xor": Operator("{} ^ {}", np.bitwise_xor, kind="b"),
    "not": Operator("!{}", np.invert, kind="b"),
    "is_finite": Operator("isfinite({}) != 0", np.isfinite, kind="b"),
    #: The second value where the first is true, else the third.
    "select": Operator("{} ? {} : {}", np.where),
    TO_FLOAT: Operator("(double){}", np.float64),
}


class NotLowered(Exception):
    """A program that has no form in C here; the message is a clause that says why."""


_COMMUTE = {"add", "multiply", "maximum", "minimum", "EQ", "NE", "and", "or", "xor"}


class Graph:
    """Nodes in an order in which each comes after those that it needs.

    Attributes
    ----------
    nodes
        ``(operator, arguments)``; of an input ("input", (argument, entry)), of a constant
        ("constant", value). `WhileLoop` and `Solve` are operators with several outputs, each of
        which a number takes. `NotLowered` stands for an operator without a form in C.
    """

    def __init__(self) -> None:
        self.nodes: list[tuple[Any, Any]] = []
        self._kinds: list[str] = []  # "f" or "b"; whole numbers are floats
        self._known: dict[Any, int] = {}
        self.zero, self.one = self.constant(0.0), self.constant(1.0)
        #: 0 x, whose sign is not known.
        self._nothing = self._node("nothing", "constant", 0.0, "f")
        self.zeros = self.zero, self._nothing

    def constant(self, value: Any) -> int:
        """The node of a number, or of true or false."""
        if np.asarray(value).dtype.kind == "b":
            return self._node(("b", bool(value)), "constant", bool(value), "b")
        # The bits count: 0.0 equals -0.0, and NaN nothing.
        key = "f", struct.pack("d", value)
        return self._node(key, "constant", float(value), "f")

    def input(self, entry: int) -> int:
        """The node of an entry of the function's argument."""
        return self._node(("input", entry), "input", (0, entry), "f")

    def state(self, entry: int, kind: str) -> int:
        """A new node, of a value that the turns of a loop change."""
        return self._node(("state", len(self.nodes)), "input", (1, entry), kind)

    def outputs(
        self, operator: WhileLoop | Solve, given: tuple[int, ...], kinds: Iterable[str]
    ) -> list[int]:
        """The nodes of an operator's outputs, which are of these kinds."""
        key = (operator, given) if isinstance(operator, Solve) else ("loop", len(self.nodes))
        node = self._node(key, operator, given, "f")
        return [self._node((node, k), k, (node,), kind) for k, kind in enumerate(kinds)]

    def unknown(self, name: str, kind: str, given: tuple[int, ...]) -> int:
        """A new node of an operation without a form in C, which no result may need."""
        reason = NotLowered(f"it has the operation {name}")
        return self._node(("unknown", len(self.nodes)), reason, given, kind)

    def is_constant(self, node: int) -> bool:
        """Whether the value is known before the program runs."""
        return self.nodes[node][0] == "constant"

    def value(self, node: int) -> Any:
        """The value of a constant.

        Raises
        ------
        NotLowered
            If the node is none: indices must not depend on the arguments.
        """
        operator, value = self.nodes[node]
        if operator != "constant":
            raise NotLowered("it has an index that depends on the state")
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

    def needed(self, results: Iterable[int], given: Container[int] = ()) -> list[int]:
        """The operations that the results need beside given nodes, each shortly before its use.

        Raises
        ------
        NotLowered
            If one of them has no form in C.
        """
        order: dict[int, None] = {}
        waiting = [(int(node), False) for node in reversed(list(results))]
        while waiting:
            node, ready = waiting.pop()
            operator, arguments = self.nodes[node]
            if operator in ("constant", "input") or node in order or node in given:
                continue
            if isinstance(operator, NotLowered):
                raise NotLowered(*operator.args)
            if ready:
                order[node] = None
            else:
                waiting.append((node, True))
                waiting.extend((x, False) for x in reversed(arguments))
        return list(order)

    def loop(self, test: int, turn: Sequence[int], start: Sequence[int], first: int) -> list[int]:
        """The nodes of the results of a loop, whose nodes are those from the first one on.

        Parameters
        ----------
        test, turn
            Nodes of whether there is another turn, and of the next `state`.
        start
            Nodes of the first state.
        """
        inside = [test, *turn]
        used = [x for node in self.needed(inside, range(first)) for x in self.nodes[node][1]]
        outer = (x for x in (*inside, *used) if x < first and not self.is_constant(x))
        loop = WhileLoop(test, tuple(turn), tuple(dict.fromkeys(outer)))
        kinds = [self._kinds[node] for node in start]
        return self.outputs(loop, (*loop.given, *start), kinds)

    def dependence(self, results: Sequence[int], nodes: Sequence[int]) -> Bool[np.ndarray, "m n"]:
        """Whether each of m results depends on each of n nodes."""
        masks = {node: 1 << k for k, node in enumerate(nodes)}
        for node in range(min(nodes, default=0), max(results, default=-1) + 1):
            operator, given = self.nodes[node]
            if operator not in ("constant", "input"):
                masks[node] = reduce(or_, (masks.get(x, 0) for x in given), 0)
        bits = [masks.get(node, 0) >> k & 1 for node in results for k in range(len(nodes))]
        return np.array(bits, bool).reshape(len(results), len(nodes))

    def kind(self, node: int) -> str:
        """The kind of a value: "f" for a number, "b" for true or false."""
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
        if all(self.is_constant(node) for node in given):
            values = [np.asarray(self.value(node)) for node in given]
            with np.errstate(all="ignore"):
                known = self.constant(np.asarray(OPERATORS[operator].numpy(*values))[()])
            return self._nothing if self._nothing in given and self._is_zero(known) else known
        simple = self._without_zeros(operator, *given)
        if simple is not None:
            return simple
        kind = self._kinds[given[1]] if operator == "select" else OPERATORS[operator].kind
        return self._node(key, operator, given, kind)

    def _without_zeros(self, operator: str, a: int, b: int = -1, *_: int) -> int | None:
        """A simpler node for a + b, a - b, a b or a / b, or None."""
        if operator == "add" and (self._is_zero(a) or self._is_zero(b)):
            return b if self._is_zero(a) else a
        if operator == "subtract" and self._is_zero(b):
            return a
        if operator == "subtract" and a == self._nothing:
            return self.apply("negate", b)
        if operator in ("multiply", "divide"):
            if a in self.zeros or (operator == "multiply" and b in self.zeros):
                return self._nothing
            if b == self.one or (operator == "multiply" and a == self.one):
                return a if b == self.one else b
        return None

    def _is_zero(self, node: int) -> bool:
        """Whether it is a constant float, 0 or -0."""
        return self._kinds[node] == "f" and self.is_constant(node) and self.value(node) == 0


class LoweredFunction(NamedTuple):
    """A graph, and the nodes of the entries of its only result."""

    graph: Graph
    results: Int[np.ndarray, ...]


class WhileLoop(NamedTuple):
    """An operator that goes round as long as a test says so, from given values and a first state.

    Attributes
    ----------
    test, turn
        Nodes of whether there is another turn, and of the next state.
    given
        Nodes around the loop that these need.
    """

    test: int
    turn: tuple[int, ...]
    given: tuple[int, ...]


class Solve(NamedTuple):
    """An operator that solves linear systems with one matrix, for given matrix and right sides."""

    unknowns: int
    systems: int
