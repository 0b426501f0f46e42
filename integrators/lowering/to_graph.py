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
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from integrators.lowering.graph import Graph, LoweredFunction, NotLowered, WhileLoop
from integrators.lowering.operators import operator
from integrators.lowering.rules import INDICES, MOVES, RULES, eliminate, on_numbers
from integrators.lowering.stablehlo import Body, Follower, Step, Type, program
from problems.base.runtime import jax

#: Entries of arrays that may be looked at, zeros included; more take half a minute.
_MOST_ENTRIES = 10_000_000
#: Turns of loops that are written out one after the other, as their number is known.
_MOST_TURNS = 1000
#: Types of numbers in C. C keeps whole numbers as floats, and JAX wraps those of fewer bits.
_TYPES = {"bool", "int32", "int64", "float64"}


class _Known(NamedTuple):
    """An array of numbers that depend on no argument."""

    numbers: np.ndarray


_Value = _Known | np.ndarray
#: No half of a solution.
_NO = b"", False, np.zeros(0, int)


def lowered(function: Callable[..., Any], lengths: tuple[int | None, ...]) -> LoweredFunction:
    """Follow a traceable function of one vector whose result is one array.

    Parameters
    ----------
    lengths
        Lengths of the arguments that stand side by side in the vector; None for a scalar.

    Raises
    ------
    NotLowered
        If it has an operation without a rule, an index that depends on an argument, or too many
        operations.
    """
    sizes = [1 if n is None else n for n in lengths]
    graph = Graph()
    nodes = [graph.input(k, entry) for k, n in enumerate(sizes) for entry in range(n)]
    vector = jax.ShapeDtypeStruct((sum(sizes),), float)
    try:
        follower = _Follower(program(function, vector), graph)
        (result,) = follower.called("main", [np.array(nodes, int)])
    except NotLowered:
        raise
    except Exception as error:  # of whatever kind: another release of JAX has other programs
        raise NotLowered(f"programs of this JAX are not as known ({error!r})") from error
    return LoweredFunction(graph, follower.nodes(result))


class _Follower(Follower[_Value]):
    def __init__(self, functions: Any, graph: Graph) -> None:
        super().__init__(functions)
        self._graph, self._entries, self._turns = graph, 0, 0
        #: Matrices by the nodes that stand for their factors.
        self._factored: dict[bytes, np.ndarray] = {}
        #: Factors, which of them, and right sides, by the nodes that stand for a half solution.
        self._halves: dict[bytes, tuple[bytes, bool, np.ndarray]] = {}

    def nodes(self, value: _Value) -> np.ndarray:
        """The nodes of a value."""
        if not isinstance(value, _Known):
            return value
        numbers = value.numbers
        if numbers.dtype.kind not in "biuf":
            raise NotLowered("it has constants that are no numbers")
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
            around = (values[k] for body in step.bodies for k in body.used if k in values)
            return [self._unknown(name, made, [*given, *around]) for made in step.made]
        pairs = zip(results, step.made, strict=True)
        return [x if isinstance(x, _Known) else x.reshape(made.shape) for x, made in pairs]

    def _results(
        self, step: Step, given: list[_Value], values: dict[int, _Value]
    ) -> Sequence[_Value]:
        name = step.name
        if name == "while":
            return self._looped(step, given, values)
        if name == "case":
            return self._chosen(step, given, values)
        if name == "optimization_barrier":
            return given
        if all(isinstance(value, _Known) for value in given):
            found = on_numbers(step, *map(self._numbers, given))
            if found is not None:
                return [_Known(one) for one in found]
        if name in MOVES:
            return [self._moved(step, given)]
        nodes = [self.nodes(value) for value in given]
        if not _types(step) <= _TYPES:
            raise NotLowered
        if by := operator(step):
            return [self._graph.each(by, *nodes)]
        if "getrf" in name:
            return self._factors(step, *nodes)
        if name == "triangular_solve" or "trsm" in name:
            return [self._solved(step, *nodes)]
        if name in RULES:
            return [RULES[name](self._graph, step, *nodes)]
        raise NotLowered

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
    def _factors(self, step: Step, matrices: np.ndarray) -> list[_Value]:
        """Nodes that stand for the factors L and U of matrices, without exchanged rows.

        Whoever solves with both of them gets the solution; all else is unknown.
        """
        factors = self._unknown(repr(step.name), step.made[0], [matrices])
        for place in np.ndindex(*matrices.shape[:-2]):
            self._factored[factors[place].tobytes()] = matrices[place]
        pivots, info = step.made[1:]
        order = np.broadcast_to(np.arange(1, len(factors.T) + 1, dtype=pivots.dtype), pivots.shape)
        return [factors, _Known(order), _Known(np.zeros(info.shape, info.dtype))]

    def _solved(self, step: Step, factors: np.ndarray, right: np.ndarray) -> np.ndarray:
        """The solution with both factors of matrices; nodes that stand for it after the first."""
        unit, transposed, left = _sides(step)
        x = self._unknown(repr(step.name), step.made[0], [factors, right])
        for place in np.ndindex(*factors.shape[:-2]):
            key, b = factors[place].tobytes(), right[place]
            matrix, (by, other, first) = self._factored.get(key), self._halves.get(b.tobytes(), _NO)
            self._halves[x[place].tobytes()] = key, unit, b
            if matrix is not None and by == key and other != unit:
                a = matrix if transposed != left else matrix.T
                solution = eliminate(self._graph, a, first if left else first.T)
                x[place] = solution if left else solution.T
        return x

    # ---- loops and branches ------------------------------------------------------------
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
                return self._in_the_program(condition, turn, given, values)
            if not goes_on.numbers:
                return state
            self._turns += 1
            if self._turns > _MOST_TURNS:
                raise NotLowered(f"its loops have more than {_MOST_TURNS} turns")
            state = self.run(turn, state, values)

    def _in_the_program(
        self, condition: Body, turn: Body, given: list[_Value], values: dict[int, _Value]
    ) -> Sequence[_Value]:
        """The results of a loop whose number of turns is found in the loop."""
        outer, inner, known = self._graph, _Follower(self.functions, Graph()), {}
        captured: list[int] = []  # constants are written where they are used
        inner._entries, inner._turns = self._entries, self._turns

        def inside(value: _Value) -> _Value:
            """Given values as the loop's programs see them; known ones stay known."""
            if isinstance(value, _Known):
                return value
            for node in value.flat:
                if node in known:
                    continue
                if outer.is_constant(node):
                    known[node] = inner._graph.constant(outer.value(node))
                else:
                    known[node] = inner._graph.input(0, len(captured), outer.kind(node))
                    captured.append(node)
            return np.array([known[node] for node in value.flat], int).reshape(value.shape)

        pairs = enumerate(zip(turn.parameters, turn.returned, strict=True))
        first = {k: self.nodes(given[k]) for k, (before, after) in pairs if before != after}
        kinds = [outer.kind(node) for node in _joined(first.values())]
        inputs = iter([inner._graph.input(1, k, kind) for k, kind in enumerate(kinds)])
        state = [
            _next(inputs, first[k].shape) if k in first else inside(value)
            for k, value in enumerate(given)
        ]
        around = {k: inside(values[k]) for k in condition.used | turn.used if k in values}
        (goes_on,) = inner.run(condition, state, around)
        after = inner.run(turn, state, around)
        self._entries, self._turns = inner._entries, inner._turns
        test = LoweredFunction(inner._graph, inner.nodes(goes_on))
        changed = _joined([inner.nodes(after[k]) for k in first])
        loop = WhileLoop(test, LoweredFunction(inner._graph, np.array(changed, int)))
        outputs = iter(outer.outputs(loop, (*captured, *_joined(first.values())), kinds))
        return [
            _next(outputs, first[k].shape) if k in first else value for k, value in enumerate(given)
        ]

    def _chosen(
        self, step: Step, given: list[_Value], values: dict[int, _Value]
    ) -> Sequence[_Value]:
        """The results of one of several bodies, all of which are computed."""
        graph, before = self._graph, len(self._graph.nodes)
        if isinstance(given[0], _Known):
            place = int(given[0].numbers)
            return self.run(step.bodies[place if place < len(step.bodies) else -1], [], values)
        index = int(given[0])
        *others, chosen = (
            [self.nodes(value) for value in self.run(body, [], values)] for body in step.bodies
        )
        if any(isinstance(operator, WhileLoop) for operator, _ in graph.nodes[before:]):
            raise NotLowered("a loop of a branch that is not taken might go on for ever")
        for k, results in reversed([*enumerate(others)]):
            taken = graph.apply("EQ", index, graph.constant(k))
            pairs = zip(results, chosen, strict=True)
            chosen = [graph.each("select", taken, yes, no) for yes, no in pairs]
        return chosen

    def _unknown(self, name: str, made: Type, given: Sequence[_Value]) -> np.ndarray:
        """Nodes of an operation without a rule, which may depend on all that it is given."""
        kind = {"b": "b", "f": "f"}.get(made.dtype.kind, "i")
        on = (*{node for value in given if not isinstance(value, _Known) for node in value.flat},)
        nodes = [self._graph.unknown(name, kind, on) for _ in range(made.size)]
        return np.array(nodes, int).reshape(made.shape)


def _types(step: Step) -> set[str]:
    return {str(one.dtype) for one in (*step.taken, *step.made)}


def _sides(step: Step) -> tuple[bool, bool, bool]:
    """Whether a triangle's diagonal is 1, it is transposed, and stands to the left of x."""
    if step.name == "triangular_solve":
        of = step.attributes
        transposed = "NO_TRANSPOSE" not in of["transpose_a"]
        return of["unit_diagonal"] == "true", transposed, of["left_side"] == "true"
    letters = {name: chr(*number) for name, number in step.fields("mhlo.backend_config").items()}
    return letters["diag"] == "U", letters["trans_x"] != "N", letters["side"] == "L"


def _joined(pieces: Iterable[np.ndarray]) -> list[int]:
    """The nodes of several arrays side by side."""
    return [node for piece in pieces for node in piece.ravel().tolist()]


def _next(nodes: Iterator[int], shape: tuple[int, ...]) -> np.ndarray:
    """The next of several nodes in an array of a shape."""
    return np.array([*islice(nodes, math.prod(shape))], int).reshape(shape)
