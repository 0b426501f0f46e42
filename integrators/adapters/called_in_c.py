"""Packed functions in C, called from Python; the option that chooses between C and JAX."""

from __future__ import annotations

from collections.abc import Callable
from ctypes import c_void_p
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from integrators.adapters.callbacks import PackedFunction
from integrators.contract import option
from integrators.lowering.c_source import HEADER, c_function
from integrators.lowering.graph import NotLowered
from integrators.lowering.native import load
from integrators.lowering.programs import lowered
from problems.runtime import slower

if TYPE_CHECKING:
    from jaxtyping import Float, Int

#: C and JAX may differ by so much of the largest entry, and of that of the equation: both round.
_ROUNDING, _ROUNDING_OF_A_ROW = 1e-12, 1e-9


class CallsEquations:
    """Base of methods with `callbacks_option`: their statement of how they call equations."""

    controls = "tolerance"
    #: A solver, as a clause that goes on with "calls ...".
    loop: ClassVar[str]
    callbacks: str

    @property
    def calls(self) -> str:
        """How the method calls its equations."""
        if self.callbacks == "compiled":
            return f"{self.loop} calls equations in C, where they have such a form, one by one"
        return f"{self.loop} calls compiled equations through Python, one by one"


def callbacks_option() -> Any:
    """The option that chooses how equations are called."""
    return option(
        "compiled",
        "compiled: the solver calls equations in C, where there is a C compiler; python: it calls "
        "JAX's compiled functions through Python",
        choices=("compiled", "python"),
    )


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


def compare(
    ours: Callable[..., Any],
    theirs: Callable[..., Any],
    start: tuple[Any, ...],
    rows: Int[np.ndarray, ...],
    *factors: float,
) -> bool:
    """Whether a function of C is that of JAX at the start of a run and near it.

    The start has the exact zeros of a scene, at which functions may jump; near it, where a run
    might come, nothing vanishes by chance.
    """
    t, *vectors = start
    shift = np.random.default_rng(0).uniform(-1e-3, 1e-3, (len(vectors), len(vectors[0])))
    moved = [v + d * (1 + abs(v)) for v, d in zip(vectors, shift, strict=True)]
    found, right = (
        np.array([np.ravel(function(t, *at, *factors)) for at in (vectors, moved)])
        for function in (ours, theirs)
    )
    return same_to_rounding(found, right, rows.ravel())


@cache
def _compiled(packed: PackedFunction) -> Any:
    """The C of a function of one array, in which all arguments stand side by side."""
    try:
        program = lowered(packed.program, (packed.size,))
        function = load(HEADER + c_function("function", program, 1)).function
    except NotLowered as reason:
        return NotLowered(str(reason))  # without what the first one holds in memory
    function.restype, function.argtypes = None, [c_void_p, c_void_p]
    return function, program.results.shape


def bound_in_c(packed: PackedFunction, *first: np.ndarray) -> Callable[..., np.ndarray]:
    """The C of a function as `PackedFunction.bind` gives that of JAX.

    Raises
    ------
    NotLowered
        If it has no form in C, or there is no compiler.
    """
    found = _compiled(packed)
    if isinstance(found, NotLowered):
        raise NotLowered(str(found))
    (function, shape), memory = found, np.zeros(packed.size)
    for place, value in zip(packed.places, first, strict=False):
        memory[place] = value
    out = np.empty(shape)
    given, results = c_void_p(memory.ctypes.data), c_void_p(out.ctypes.data)
    places = packed.places[len(first) :]

    def call(*arguments: Any) -> np.ndarray:
        for place, value in zip(places, arguments):  # noqa: B905
            memory[place] = value
        function(given, results)
        return out.copy()

    return call


def functions_in_c(
    about: str,
    packed: tuple[PackedFunction, PackedFunction],
    p: np.ndarray,
    functions: tuple[Callable[..., Any], Callable[..., Any]],
    start: tuple[Any, ...],
) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """A solver's functions in C; those of JAX, and a sentence, where there are none or they differ.

    Parameters
    ----------
    about
        The solver and the scene, as a clause that begins the sentence.
    functions
        Those of JAX, with the parameters p.
    start
        t and the vectors at the start of the run.
    """
    try:
        value, jacobian = (bound_in_c(one, p) for one in packed)
        for found, right in zip((value, jacobian), functions, strict=True):
            rows = np.indices(right(*start).shape)
            if not compare(found, right, start, rows[-2 if len(rows) > 1 else -1]):
                raise NotLowered("its equations in C are not those of JAX")
    except NotLowered as reason:
        slower(f"{about} through JAX, which takes longer: {reason}.")
        return functions
    return value, jacobian
