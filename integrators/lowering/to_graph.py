"""From a function that JAX can trace to a graph of scalar operations.

Its program (`integrators.lowering.stablehlo`) is followed step by step. Arrays that depend on
arguments are arrays of nodes: whatever moves numbers moves nodes here, once and for all, and what
computes with numbers adds nodes (`integrators.lowering.rules`). All others are arrays of numbers;
indices have to be among them. A loop whose number of turns is known is written out; any other one
is an operator with programs of its own. A step without a rule, or on others than 64-bit floats,
whole numbers that are counters, true and false, spoils only the results that need it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from integrators.lowering.graph import Graph, LoweredFunction, NotLowered
from integrators.lowering.rules import INDICES, MOVES, RULES, eliminate, on_numbers, operator
from integrators.lowering.stablehlo import Follower, Step, Type, program
from problems.base.runtime import Array
from problems.system import MechatronicSystem

#: Entries of arrays that may be looked at, zeros included; more take half a minute.
_MOST_ENTRIES = 10_000_000
#: Turns of loops that are written out one after the other, as their number is known.
_MOST_TURNS = 1000
#: Most coordinates of a mass matrix whose entries are looked at.
_MOST_KNOWN = 32
#: Types of numbers in C. C keeps whole numbers as floats, which as counters stay exact: they have
#: these operations alone, and are not so large that JAX might wrap them.
_TYPES = {"bool", "int32", "int64", "float64"}
_OF_COUNTERS = {"add", "subtract", "maximum", "minimum", "select", "clamp", "convert"}
_OF_COUNTERS |= {"EQ", "NE", "LT", "LE", "GT", "GE"}
_LARGEST_COUNT = 10**6


class _Known(NamedTuple):
    """An array of numbers that depend on no argument."""

    numbers: np.ndarray


_Value = _Known | np.ndarray


def lowered(function: Callable[..., Any], *arguments: Any) -> LoweredFunction:
    """Follow a traceable function of arrays whose result is one array.

    Inputs of the graph are the entries of all arguments, one after the other, of which only shapes
    and types matter.

    Raises
    ------
    NotLowered
        If it has an operation without a rule, an index that depends on an argument, or too many
        operations.
    """
    graph, given, first = Graph(), list[_Value](), 0
    for one in arguments:
        nodes = np.array([*map(graph.input, range(first, first + one.size))], int)
        nodes, first = nodes.reshape(one.shape), first + one.size
        given.append(graph.each("NE", nodes, graph.zero) if one.dtype == bool else nodes)
    try:
        follower = _Follower(program(function, *arguments), graph)
        (result,) = follower.called("main", given)
    except NotLowered:
        raise
    except Exception as error:  # of whatever kind: another release of JAX has other programs
        raise NotLowered(f"programs of this JAX are not as known ({error!r})") from error
    return LoweredFunction(graph, follower.nodes(result))


@cache
def with_known_mass(template: MechatronicSystem) -> MechatronicSystem:
    """A kind of scene that multiplies by the diagonal of a small mass matrix, where no other entry
    can be other than zero."""
    nv, p = template.sizes.nv, template.parameters()
    if template.has("mass_product") or nv > _MOST_KNOWN:
        return template

    def mass(q: Array, *values: Array) -> Array:
        return template.with_parameters(dict(zip(p, values, strict=True))).mass(q)

    try:
        graph, entries = lowered(mass, np.zeros(template.sizes.nq), *map(np.asarray, p.values()))
    except NotLowered:
        return template
    if not np.isin(entries[~np.eye(nv, dtype=bool)], graph.zeros).all():
        return template
    cls, at = type(template), np.arange(nv)  # jnp.diagonal has another program for each platform
    known = {"mass_product": lambda self, q, a: self.mass(q)[at, at] * a, "name": cls.name}
    return template.with_parameters({}, type(cls.__name__, (cls,), known))


class _Follower(Follower[_Value]):
    def __init__(self, functions: Any, graph: Graph) -> None:
        super().__init__(functions)
        self._graph, self._entries, self._turns = graph, 0, 0
        #: Matrices by the nodes that stand for their factors, and right sides by the factors and
        #: the nodes that stand for the solution with the first of them.
        self._factored: dict[bytes, np.ndarray] = {}
        self._halves: dict[tuple[bytes, bytes], np.ndarray] = {}

    def nodes(self, value: _Value) -> np.ndarray:
        """The nodes of a value."""
        if not isinstance(value, _Known):
            return value
        numbers = value.numbers
        if numbers.dtype.kind not in "biuf":
            raise NotLowered("it has constants that are no numbers")
        if numbers.dtype.kind in "iu" and (abs(numbers) > _LARGEST_COUNT).any():
            raise NotLowered("it has large whole numbers")
        constants = [self._graph.constant(v) for v in numbers.flat]
        return np.array(constants, int).reshape(numbers.shape)

    def _numbers(self, value: _Value) -> np.ndarray:
        """The numbers of a value that depends on no argument."""
        if isinstance(value, _Known):
            return value.numbers
        return np.array([self._graph.value(node) for node in value.flat]).reshape(value.shape)

    def step(
        self, step: Step, given: list[_Value], values: dict[int, _Value], scope: str
    ) -> list[_Value]:
        self._entries += sum(made.size for made in step.made)
        if self._entries > _MOST_ENTRIES:
            raise NotLowered("its arrays are too large")
        try:
            results = self._results(step, given, values)
        except NotLowered as reason:
            others = sorted(_types(step) - _TYPES)
            name = repr(f"{step.name} of {others[0]}" if others else step.name)
            name = f"{name} ({reason})" if str(reason) else name
            around = [values[k] for body in step.bodies for k in body.used if k in values]
            return [self._unknown(name, made, [*given, *around]) for made in step.made]
        pairs = zip(results, step.made, strict=True)
        return [x if isinstance(x, _Known) else x.reshape(made.shape) for x, made in pairs]

    def _results(
        self, step: Step, given: list[_Value], values: dict[int, _Value]
    ) -> Sequence[_Value]:
        name = step.name
        if name == "while":
            return self._looped(step, given, values)
        if name == "optimization_barrier":
            return given
        if all(isinstance(value, _Known) for value in given):
            found = on_numbers(step, *map(self._numbers, given))
            if found is not None:
                return [_Known(found)]
        if name in MOVES:
            return [self._moved(step, given)]
        nodes = [self.nodes(value) for value in given]
        if not _types(step) <= _TYPES:
            raise NotLowered
        if "getrf" in name:
            return self._factors(step, *nodes)
        if "trsm" in name:
            return [self._solved(step, *nodes)]
        by = operator(step)
        if not by and name not in RULES:
            raise NotLowered
        whole = any(one.dtype.kind == "i" for one in (*step.taken, *step.made))
        if whole and (step.operation if step.bodies else by or name) not in _OF_COUNTERS:
            raise NotLowered("it computes with whole numbers")
        return [self._graph.each(by, *nodes) if by else RULES[name](self._graph, step, *nodes)]

    def _moved(self, step: Step, given: list[_Value]) -> _Value:
        """Entries at other places; indices are known beforehand."""
        places = range(len(given))[INDICES.get(step.name, slice(0))]
        known = all(isinstance(x, _Known) for k, x in enumerate(given) if k not in places)
        arrays = [
            self._numbers(x) if known or k in places else self.nodes(x) for k, x in enumerate(given)
        ]
        if known:
            return _Known(MOVES[step.name](step, *arrays))
        combined = [self._graph.each] if step.name == "scatter" else []
        return MOVES[step.name](step, *arrays, *combined)

    # ---- linear systems ----------------------------------------------------------------
    def _factors(self, step: Step, matrix: np.ndarray) -> list[_Value]:
        """Nodes that stand for the factors L and U of a matrix, without exchanged rows.

        Whoever solves with one after the other gets the solution; all else is unknown.
        """
        if matrix.ndim > 2:
            raise NotLowered("it factorises several matrices at once")
        made, pivots, info = step.made
        factors = self._unknown(repr(step.name), made, [matrix])
        self._factored[factors.tobytes()] = matrix
        order = np.arange(1, len(matrix) + 1, dtype=pivots.dtype)
        return [factors, _Known(order), _Known(np.zeros(info.shape, info.dtype))]

    def _solved(self, step: Step, factors: np.ndarray, right: np.ndarray) -> np.ndarray:
        """The solution with both factors of a matrix; nodes that stand for it after the first."""
        letters = {k: chr(*number) for k, number in step.fields("mhlo.backend_config").items()}
        kind = "".join(letters[k] for k in ("side", "uplo", "trans_x", "diag"))
        key = factors.tobytes()
        if kind == "LLNU":
            half = self._unknown(repr(step.name), step.made[0], [factors, right])
            self._halves[key, half.tobytes()] = right
            return half
        first = self._halves.get((key, right.tobytes()))
        if kind != "LUNN" or key not in self._factored or first is None:
            raise NotLowered
        return eliminate(self._graph, self._factored[key], first)

    # ---- loops ------------------------------------------------------------
    def _looped(
        self, step: Step, given: list[_Value], values: dict[int, _Value]
    ) -> Sequence[_Value]:
        """The results of a loop, which is written out if its number of turns is known."""
        (condition, turn), state, turns = step.bodies, given, self._turns
        while True:
            (goes_on,) = self.run(condition, state, values)
            if not isinstance(goes_on, _Known):
                self._turns = turns
                if not _types(step) <= _TYPES:
                    raise NotLowered
                return self._in_the_program(step, given, values)
            if not goes_on.numbers:
                return state
            self._turns += 1
            if self._turns > _MOST_TURNS:
                raise NotLowered(f"its loops have more than {_MOST_TURNS} turns")
            state = self.run(turn, state, values)

    def _in_the_program(
        self, step: Step, given: list[_Value], values: dict[int, _Value]
    ) -> Sequence[_Value]:
        """The results of a loop whose number of turns is found in the loop."""
        (condition, turn), graph = step.bodies, self._graph
        pairs = enumerate(zip(turn.parameters, turn.returned, strict=True))
        start = {k: self.nodes(given[k]) for k, (before, after) in pairs if before != after}
        flat, first = _joined(start.values()), len(graph.nodes)

        def replaced(nodes: Iterable[int]) -> list[_Value]:
            """The values that a turn changes, in their shapes, behind those that stay."""
            changed = iter([*nodes])
            of = (start[k].shape if k in start else None for k in range(len(given)))
            pairs = zip(given, of, strict=True)
            return [x if shape is None else _next(changed, shape) for x, shape in pairs]

        state = replaced(graph.state(k, graph.kind(node)) for k, node in enumerate(flat))
        (goes_on,), after = (self.run(body, state, values) for body in (condition, turn))
        changed = _joined(self.nodes(after[k]) for k in start)
        return replaced(graph.loop(int(self.nodes(goes_on)), changed, flat, first))

    def _unknown(self, name: str, made: Type, given: Sequence[_Value]) -> np.ndarray:
        """Nodes of an operation without a rule, which may depend on all that it is given."""
        kind = "b" if made.dtype.kind == "b" else "f"
        on = (*{node for value in given if not isinstance(value, _Known) for node in value.flat},)
        nodes = [self._graph.unknown(name, kind, on) for _ in range(made.size)]
        return np.array(nodes, int).reshape(made.shape)


def _types(step: Step) -> set[str]:
    return {str(one.dtype) for one in (*step.taken, *step.made)}


def _joined(pieces: Iterable[np.ndarray]) -> list[int]:
    """The nodes of several arrays side by side."""
    return [node for piece in pieces for node in piece.ravel().tolist()]


def _next(nodes: Iterator[int], shape: tuple[int, ...]) -> np.ndarray:
    """The next of several nodes in an array of a shape."""
    return np.array([*islice(nodes, math.prod(shape))], int).reshape(shape)
