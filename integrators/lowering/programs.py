"""From a function that JAX can trace to a graph of scalar operations.

A program is followed operation by operation. Its arrays are arrays of nodes: whatever moves numbers
moves nodes here, once and for all, and what computes with numbers adds nodes
(`integrators.lowering.primitives`). Indices have to be known beforehand, loops cannot be followed.
An operation without a rule spoils only the results that need it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from integrators.lowering.elimination import refuse_many, solve
from integrators.lowering.graph import Graph, NotLowered
from integrators.lowering.primitives import RULES
from integrators.operations import CALLS
from problems.runtime import jax

if TYPE_CHECKING:
    from jaxtyping import Int

#: Entries of arrays that may be looked at, zeros included; more take half a minute.
_MOST_ENTRIES = 10_000_000


class Program(NamedTuple):
    """A graph, and the nodes of the entries of its only result."""

    graph: Graph
    results: Int[np.ndarray, ...]


def lowered(program: Callable[..., Any], lengths: tuple[int | None, ...]) -> Program:
    """Follow a traceable function of one vector whose result is one array.

    Parameters
    ----------
    lengths
        Lengths of the arguments that stand side by side in the vector; None for a scalar.

    Raises
    ------
    NotLowered
        If it has an operation without a rule, an index that depends on an argument, a loop, or too
        many operations.
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
        self._graph, self._entries = graph, 0

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
        types = [var.aval.dtype for var in equation.outvars]
        if any(kind.kind == "c" or (kind.kind == "f" and kind != np.float64) for kind in types):
            raise NotLowered("it computes with numbers that are no 64-bit floats")
        if name in RULES:
            try:
                results = RULES[name](self._graph, equation, *given)
            except NotLowered:
                results = None
        else:
            results = self._known_beforehand(equation, given)
        if results is None:
            return [self._unknown(name, var.aval) for var in equation.outvars]
        results = results if isinstance(results, list) else [results]
        return [np.asarray(r, int).reshape(s) for r, s in zip(results, shapes, strict=True)]

    def _solved(self, params: dict[str, Any], given: list[np.ndarray]) -> list[np.ndarray]:
        """The solution of a linear system; its matrix are products with unit vectors."""
        graph, lengths = self._graph, params["const_lengths"]
        right, consts = given[sum(lengths) :], given[: lengths.matvec]
        sizes = [part.size for part in right]
        refuse_many(sum(sizes))

        def parts(column: np.ndarray) -> list[np.ndarray]:
            pieces = np.split(column, np.cumsum(sizes)[:-1])
            return [piece.reshape(part.shape) for piece, part in zip(pieces, right, strict=True)]

        def joined(pieces: list[np.ndarray]) -> np.ndarray:
            return np.concatenate([piece.ravel() for piece in pieces])

        units = np.where(np.eye(sum(sizes), dtype=bool), graph.one, graph.zero)
        program = params["jaxprs"].matvec
        columns = [joined(self.called(program, [*consts, *parts(unit)])) for unit in units]
        return parts(solve(graph, np.array(columns).T, joined(right)))

    def _known_beforehand(self, equation: Any, given: list[np.ndarray]) -> list[np.ndarray] | None:
        """The results of an operation on constants, computed by JAX; None if others take part."""
        graph, values = self._graph, []
        for nodes, var in zip(given, equation.invars, strict=True):
            if not all(graph.is_constant(node) for node in nodes.flat):
                return None
            numbers = [graph.value(node) for node in nodes.flat]
            values.append(np.array(numbers, var.aval.dtype).reshape(nodes.shape))
        with jax.ensure_compile_time_eval():
            results = equation.primitive.bind(*map(jax.numpy.asarray, values), **equation.params)
        several = equation.primitive.multiple_results
        return [self._constants(result) for result in (results if several else [results])]

    def _constants(self, value: Any) -> np.ndarray:
        array = np.asarray(value)
        return np.array([self._graph.constant(v) for v in array.flat], int).reshape(array.shape)

    def _unknown(self, name: str, aval: Any) -> np.ndarray:
        kind = {"b": "b", "f": "f"}.get(aval.dtype.kind, "i")
        nodes = [self._graph.unknown(name, kind) for _ in range(int(np.prod(aval.shape)))]
        return np.array(nodes, int).reshape(aval.shape)
