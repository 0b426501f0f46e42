"""Equations as solvers of other libraries call them: compiled functions of numbers and vectors.

JAX compiles them, and the C compiler where they have a form in C.
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes import c_void_p
from functools import cache, cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from integrators.lowering.c_source import c_function, load_c
from integrators.lowering.graph import NotLowered
from integrators.lowering.to_graph import lowered
from integrators.program_costs import Cost, costs_of
from problems.base.runtime import Float, Int, jax

#: C and JAX may differ by so much of the largest entry, and of that of the equation: both round.
_ROUNDING, _ROUNDING_OF_A_ROW = 1e-12, 1e-9


class PackedFunction:
    """A function of numbers and vectors, compiled once, and called with NumPy arrays.

    JAX takes a microsecond to convert each array that it is given. Here all arguments are copied
    side by side into one new array. Results are new arrays, too.

    Parameters
    ----------
    function
        Traceable function of arrays; an attribute, too.
    lengths
        Lengths of its arguments, which are vectors, None for a scalar; an attribute, too.

    Attributes
    ----------
    program
        The compiled function of one array, in which all arguments stand side by side.
    places, size
        Places of the arguments in the array, and its length.
    """

    def __init__(self, function: Callable[..., Any], *lengths: int | None) -> None:
        ends = np.cumsum([0, *(1 if n is None else n for n in lengths)]).tolist()
        between = zip(pairwise(ends), lengths, strict=True)
        self.places = [a if n is None else slice(a, b) for (a, b), n in between]
        self.size, self.function, self.lengths = ends[-1], function, lengths
        self.program = jax.jit(
            lambda numbers: function(*(numbers[k] for k in self.places)), keep_unused=True
        )

    @cached_property
    def costs(self) -> list[Cost]:
        """Floating-point operations of a call."""
        return costs_of(self.program, jax.ShapeDtypeStruct((self.size,), float))

    def bind(self, *first: np.ndarray) -> Callable[..., Any]:
        """Return the function of the remaining arguments."""
        memory, places = self._memory(*first)
        program = self.program

        def call(*arguments: Any) -> Any:
            numbers = memory.copy()  # a program may read it after its call has returned
            # A strict zip would take as long as all the copying.
            for place, value in zip(places, arguments):  # noqa: B905
                numbers[place] = value
            return program(numbers)

        return call

    def bind_c(self, *first: np.ndarray) -> Callable[..., np.ndarray]:
        """Return the function in C, as `bind` returns that of JAX, but for one thread.

        Raises
        ------
        NotLowered
            If it has no form in C, or there is no compiler.
        """
        found = in_c(self)
        if isinstance(found, NotLowered):
            raise NotLowered(str(found))
        (function, shape), (memory, places) = found, self._memory(*first)
        out = np.empty(shape)
        given, result = c_void_p(memory.ctypes.data), c_void_p(out.ctypes.data)

        def call_c(*arguments: Any) -> np.ndarray:
            for place, value in zip(places, arguments):  # noqa: B905
                memory[place] = value
            function(given, result)
            return out.copy()

        return call_c

    def _memory(self, *first: np.ndarray) -> tuple[np.ndarray, list]:
        """Memory for all arguments that holds the first ones, and the places of the others."""
        memory = np.zeros(self.size)
        for place, value in zip(self.places, first, strict=False):
            memory[place] = value
        return memory, self.places[len(first) :]


@cache
def in_c(packed: PackedFunction) -> Any:
    """Return a function in C, which takes the addresses of all arguments side by side and of the
    result, and the shape of the result; a NotLowered if there is none."""
    try:
        program = lowered(packed.program, packed.size)
        function = load_c(c_function(program)).function
    except NotLowered as reason:
        return NotLowered(str(reason))  # without what the first one holds in memory
    function.restype, function.argtypes = None, [c_void_p, c_void_p]
    return function, program.results.shape


def same_to_rounding(
    found: Float[np.ndarray, "k n"], right: Float[np.ndarray, "k n"], rows: Int[np.ndarray, " n"]
) -> bool:
    """Whether values of C are those of JAX at some states; ``rows`` tells the equation of each.

    An equation may vanish at one state, and rounding does not: its scale is that of all states.
    """
    known = np.isfinite(found) & np.isfinite(right)
    ours, theirs = (np.where(known, values, 0.0) for values in (found, right))
    scales = np.zeros(rows.max(initial=-1) + 1)
    np.maximum.at(scales, rows, np.abs(theirs).max(0))
    allowed = np.minimum(_ROUNDING * scales.max(initial=0.0), _ROUNDING_OF_A_ROW * scales[rows])
    close = np.abs(ours - theirs) <= allowed
    return bool(close.all()) and np.array_equal(found[~known], right[~known], equal_nan=True)
