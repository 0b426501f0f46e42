"""From a function that JAX can trace to a graph of scalar operations.

A program is followed operation by operation. Its arrays are arrays of nodes: whatever moves numbers
moves nodes here, once and for all, and what computes with numbers adds nodes
(`integrators.lowering.primitives`). Indices have to be known beforehand. A loop with a known number
of turns is written out; any other one is an operator with programs of its own. What depends on no
argument is computed by JAX, with numbers of any type. An operation without a rule, or on others
than 64-bit floats, whole numbers that are counters, true and false, spoils only the results that
need it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import numpy as np

from integrators.lowering.elimination import solve
from integrators.lowering.graph import Graph, Loop, NotLowered, Program
from integrators.lowering.primitives import RULES, entrywise
from integrators.operations import CALLS
from problems.runtime import jax

#: Entries of arrays that may be looked at, zeros included; more take half a minute.
_MOST_ENTRIES = 10_000_000
#: Turns of loops that are written out one after the other, as their number is known.
_MOST_TURNS = 1000
#: Types of numbers in C. C keeps whole numbers as floats, and JAX wraps those of fewer bits.
_TYPES = {"bool", "int32", "int64", "float64"}


def lowered(program: Callable[..., Any], lengths: tuple[int | None, ...]) -> Program:
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
    traced = jax.make_jaxpr(program)(jax.ShapeDtypeStruct((sum(sizes),), float))
    graph = Graph()
    nodes = [graph.input(k, entry) for k, n in enumerate(sizes) for entry in range(n)]
    try:
        (results,) = _Follower(graph).called(traced, [np.array(nodes)])
    except NotLowered:
        raise
    except Exception as error:  # of whatever kind: another release of JAX has other programs
        raise NotLowered(f"programs of this JAX are not as known ({error!r})") from error
    return Program(graph, results)


class _Follower:
    def __init__(self, graph: Graph) -> None:
        self._graph, self._entries, self._turns = graph, 0, 0

    def called(self, program: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        """The results of a program, with its constants or without any, on arrays of nodes."""
        jaxpr, consts = getattr(program, "jaxpr", program), getattr(program, "consts", ())
        return self._walk(jaxpr, [self._constants(value) for value in consts], given)

    def _walk(
        self, jaxpr: Any, consts: list[np.ndarray], given: list[np.ndarray]
    ) -> list[np.ndarray]:
        from jax.extend.core import Literal

        values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*consts, *given], strict=True))

        def value(atom: Any) -> np.ndarray:
            return self._constants(atom.val) if isinstance(atom, Literal) else values[atom]

        for equation in jaxpr.eqns:
            results = self._equation(equation, [value(atom) for atom in equation.invars])
            values.update(zip(equation.outvars, results, strict=True))
        return [value(atom) for atom in jaxpr.outvars]

    def _equation(self, equation: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        name, params = equation.primitive.name, equation.params
        if name in CALLS:
            return self.called(params[CALLS[name]], given)
        if name == "custom_linear_solve":
            return self._solved(params, given)
        shapes = [var.aval.shape for var in equation.outvars]
        self._entries += sum(int(np.prod(shape)) for shape in shapes)
        if self._entries > _MOST_ENTRIES:
            raise NotLowered("its arrays are too large")
        types = {str(var.aval.dtype) for var in (*equation.invars, *equation.outvars)}
        others = sorted(types - _TYPES)
        results = None
        with contextlib.suppress(NotLowered):
            if name not in RULES or types - {"bool", "float64"}:  # whole numbers wrap
                results = self._known_beforehand(equation, given)
            if results is None and name in _FLOW:
                results = _FLOW[name](self, params, given)
            elif results is None and name in RULES and not others:
                results = RULES[name](self._graph, equation, *given)
        if results is None:
            name = f"{name} of {others[0]}" if others else name
            return [self._unknown(name, var.aval) for var in equation.outvars]
        results = results if isinstance(results, list) else [results]
        return [np.asarray(r, int).reshape(s) for r, s in zip(results, shapes, strict=True)]

    def _solved(self, params: dict[str, Any], given: list[np.ndarray]) -> list[np.ndarray]:
        """The solution of a linear system; its matrix stands in a program of products."""
        lengths = params["const_lengths"]
        right, consts = given[sum(lengths) :], given[: lengths.matvec]

        def product(x: np.ndarray) -> np.ndarray:
            return _joined(self.called(params["jaxprs"].matvec, [*consts, *_parts(x, right)]))

        return _parts(solve(self._graph, product, _joined(right)), right)

    def _written_out(self, params: dict[str, Any], given: list[np.ndarray]) -> list[np.ndarray]:
        """The results of a loop with a known number of turns."""
        turns, same, carried = params["length"], params["num_consts"], params["num_carry"]
        self._turns += turns
        if self._turns > _MOST_TURNS:
            raise NotLowered(f"its loops have more than {_MOST_TURNS} turns")
        consts, values = given[:same], given[same : same + carried]
        order = range(turns)[:: -1 if params["reverse"] else 1]
        rows: list[list[np.ndarray]] = [[] for _ in params["jaxpr"].jaxpr.outvars[carried:]]
        for k in order:
            sliced = [array[k] for array in given[same + carried :]]
            found = self.called(params["jaxpr"], [*consts, *values, *sliced])
            values = found[:carried]
            for row, value in zip(rows, found[carried:], strict=True):
                row.append(value)
        return [*values, *(np.array(row[:: -1 if params["reverse"] else 1]) for row in rows)]

    def _looped(self, params: dict[str, Any], given: list[np.ndarray]) -> list[np.ndarray]:
        """The results of a loop whose number of turns is found in the loop."""
        graph, outer, inner = Graph(), self._graph, {}
        handed_over: list[int] = []  # constants are written where they are used
        follower = _Follower(graph)
        follower._entries, follower._turns = self._entries, self._turns
        tested, kept = params["cond_nconsts"], params["body_nconsts"]
        first = given[tested + kept :]

        def inside(array: np.ndarray) -> np.ndarray:
            """Given values as the loop's programs see them; known ones stay known."""
            for node in array.ravel().tolist():
                if node in inner:
                    continue
                if outer.is_constant(node):
                    inner[node] = graph.constant(outer.value(node))
                else:
                    inner[node] = graph.input(0, len(handed_over), outer.kind(node))
                    handed_over.append(node)
            return np.array([inner[node] for node in array.flat], int).reshape(array.shape)

        consts = [inside(array) for array in given[: tested + kept]]
        kinds = [outer.kind(node) for array in first for node in array.flat]
        if "other" in kinds:
            raise NotLowered("a loop changes values that are no numbers")
        nodes = np.array([graph.input(1, k, kind) for k, kind in enumerate(kinds)], int)
        values = _parts(nodes, first)
        (goes_on,) = follower.called(params["cond_jaxpr"], [*consts[:tested], *values])
        after = follower.called(params["body_jaxpr"], [*consts[tested:], *values])
        if goes_on.ndim:  # loops side by side, of which each keeps its values after its end
            after = [
                entrywise(graph, "choose", _along(goes_on, new.ndim), new, old)
                for new, old in zip(after, values, strict=True)
            ]
            goes_on = np.array(graph.any(goes_on.ravel().tolist()))
        self._entries, self._turns = follower._entries, follower._turns
        loop = Loop(Program(graph, goes_on), Program(graph, _joined(after)))
        left = outer.left_by(loop, (*handed_over, *_joined(first).tolist()), kinds)
        return _parts(np.array(left), first)

    def _chosen(self, params: dict[str, Any], given: list[np.ndarray]) -> list[np.ndarray]:
        """The results of one of several programs, all of which are computed."""
        (index,), graph, before = given[0].ravel().tolist(), self._graph, len(self._graph.nodes)
        if graph.is_constant(index):
            return self.called(params["branches"][graph.value(index)], given[1:])
        *others, chosen = (self.called(branch, given[1:]) for branch in params["branches"])
        if any(isinstance(operator, Loop) for operator, _ in graph.nodes[before:]):
            raise NotLowered("a loop of a branch that is not taken might go on for ever")
        for k, results in reversed([*enumerate(others)]):
            taken = np.array(graph.apply("eq", index, graph.constant(k)))
            pairs = zip(results, chosen, strict=True)
            chosen = [entrywise(graph, "choose", taken, yes, no) for yes, no in pairs]
        return chosen

    def _known_beforehand(self, equation: Any, given: list[np.ndarray]) -> list[np.ndarray] | None:
        """The results of an operation on constants, computed by JAX; None if others take part."""
        if not all(self._graph.is_constant(node) for nodes in given for node in nodes.flat):
            return None
        kinds = [var.aval.dtype for var in equation.invars]
        with jax.ensure_compile_time_eval():
            values = map(self._values, given, kinds)
            results = equation.primitive.bind(*values, **equation.params)
        several = equation.primitive.multiple_results
        return [self._constants(result) for result in (results if several else [results])]

    def _values(self, nodes: np.ndarray, dtype: Any) -> Any:
        """The array of JAX for constant nodes."""
        values = [self._graph.value(node) for node in nodes.flat]
        if _is_key(dtype):
            return jax.numpy.stack(values).reshape(nodes.shape)
        return jax.numpy.asarray(np.array(values, dtype).reshape(nodes.shape))

    def _constants(self, value: Any) -> np.ndarray:
        if _is_key(getattr(value, "dtype", float)):
            with jax.ensure_compile_time_eval():
                array, constant = value.reshape(-1), self._graph.other_constant
                return np.array([constant(key) for key in array], int).reshape(value.shape)
        array = np.asarray(value)
        number = array.dtype.kind in "biuf"
        constant = self._graph.constant if number else self._graph.other_constant
        return np.array([constant(v) for v in array.flat], int).reshape(array.shape)

    def _unknown(self, name: str, aval: Any) -> np.ndarray:
        kind = {"b": "b", "f": "f"}.get(getattr(aval.dtype, "kind", ""), "i")
        nodes = [self._graph.unknown(name, kind) for _ in range(int(np.prod(aval.shape)))]
        return np.array(nodes, int).reshape(aval.shape)


_FLOW = {
    "scan": _Follower._written_out,
    "while": _Follower._looped,
    "cond": _Follower._chosen,
}


def _is_key(dtype: Any) -> bool:
    """Whether a type is that of keys of random numbers, which are no numbers."""
    return jax.numpy.issubdtype(dtype, jax.dtypes.extended)


def _parts(nodes: np.ndarray, like: list[np.ndarray]) -> list[np.ndarray]:
    """Nodes that stand side by side, as arrays of the shapes of others."""
    pieces = np.split(nodes, np.cumsum([part.size for part in like])[:-1])
    return [piece.reshape(part.shape) for piece, part in zip(pieces, like, strict=True)]


def _along(which: np.ndarray, axes: int) -> np.ndarray:
    """Nodes for the first axes, as an array of more axes."""
    return which.reshape(*which.shape, *[1] * (axes - which.ndim))


def _joined(pieces: list[np.ndarray]) -> np.ndarray:
    return np.concatenate([piece.ravel() for piece in pieces])
