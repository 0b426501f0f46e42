"""Equations for solvers that call them from Python: compiled, counted, with a limit of calls."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from integrators.contract import Work
from integrators.operations import Operations, operations
from problems.runtime import jax, runs_at_once, slower

if TYPE_CHECKING:
    from jaxtyping import Float

NOT_FINITE = "the equations gave a value that is not finite"


class EarlyEnd(Exception):
    """The end of a run ahead of its time; raised in a callback, it ends the run there.

    Parameters
    ----------
    status
        One of `integrators.contract.STATUSES`.
    reason
        A clause for the run's message.
    """

    def __init__(self, status: str, reason: str) -> None:
        super().__init__(reason)
        self.status, self.reason = status, reason


def advice(status: str) -> str:
    """Advice after an early end that does not depend on the formulation."""
    if status == "budget_exceeded":
        return "raise max_calls or use a larger rtol"
    if status == "diverged":
        return "check the scene's equations beyond this time or use a smaller rtol"
    return "use a larger rtol, or a smaller one if the solution changes abruptly here"


def all_finite(values: Float[np.ndarray, " n"]) -> bool:
    """Whether every entry of a vector is finite; three times as fast as ``np.isfinite``."""
    return _zeros(len(values)).dot(values) == 0.0  # 0 times NaN or infinity is NaN


@cache
def _zeros(n: int) -> np.ndarray:
    return np.zeros(n)


class PackedFunction:
    """A function of numbers and vectors, compiled once, and called with NumPy arrays.

    JAX takes a microsecond to convert each array that it is given. Here all arguments are copied
    side by side into one array that JAX has been given before. A program has read this array when
    it returns, as programs run in the calling thread (see `problems.runtime`). Where JAX was in use
    before us and they do not, wait for the result before the next call. Results are new arrays.

    Parameters
    ----------
    function
        Traceable function of arrays.
    lengths
        Lengths of its arguments, which are vectors; None for a scalar.

    Attributes
    ----------
    function
        The function itself.
    program
        The compiled function of one array, in which all arguments stand side by side.
    lengths
        Lengths of its arguments.
    places, size
        Places of the arguments in the array, and its length.
    """

    def __init__(self, function: Callable[..., Any], *lengths: int | None) -> None:
        ends = np.cumsum([0, *(1 if n is None else n for n in lengths)]).tolist()
        between = zip(pairwise(ends), lengths, strict=True)
        self.places = [a if n is None else slice(a, b) for (a, b), n in between]
        self.size, self.function, self.lengths = ends[-1], function, lengths
        self.program = jax.jit(lambda numbers: function(*(numbers[k] for k in self.places)))

    @cached_property
    def operations(self) -> Operations:
        """Floating-point operations of a call."""
        return operations(self.program, jax.ShapeDtypeStruct((self.size,), float))

    def bind(self, *first: np.ndarray) -> Callable[..., Any]:
        """Return the function of the remaining arguments, for one thread: it has its own memory."""
        memory = _aligned(self.size)
        for place, value in zip(self.places, first, strict=False):
            memory[place] = value
        places, program = self.places[len(first) :], self.program
        shared = memory_is_shared()
        numbers = jax.dlpack.from_dlpack(memory, copy=False) if shared else None

        def call(*arguments: Any) -> Any:
            # A strict zip would take as long as all the copying.
            for place, value in zip(places, arguments):  # noqa: B905
                memory[place] = value
            return program(numbers if shared else memory.copy())

        return call


@cache
def memory_is_shared() -> bool:
    """Whether JAX reads the memory of a NumPy array anew in each call, found by trying it."""
    memory, found = _aligned(1), []
    read = jax.jit(lambda numbers: 2 * numbers[0])
    try:
        numbers = jax.dlpack.from_dlpack(memory, copy=False)
        for value in (1.0, 2.0):
            memory[0] = value
            found.append(float(read(numbers)))
    except Exception:  # of whatever kind: the memory can be copied
        found.clear()
    if found == [2.0, 4.0] and runs_at_once():
        return True
    slower("Solvers that call equations one by one take longer: JAX copies their arguments.")
    return False


def _aligned(n: int) -> np.ndarray:
    """Memory for n floats that XLA uses without a copy: it begins at a multiple of 64 bytes."""
    room = np.zeros(n + 8)
    first = -room.ctypes.data % 64 // 8
    return room[first : first + n]


class CountedEquations:
    """The equations as a solver of scipy's kind calls them, counted; one object for each run.

    The times of the calls tell iterations and attempts. The first call of every Newton iteration
    is at the earliest time of its attempt. An attempt that is repeated with a smaller step begins
    earlier than those before it.

    Parameters
    ----------
    value, jacobian
        Functions of (t, ...).
    max_calls
        After so many calls of ``value`` the run ends as budget_exceeded.
    """

    def __init__(
        self, value: Callable[..., Any], jacobian: Callable[..., Any], max_calls: int
    ) -> None:
        self._value, self._jacobian, self._max_calls = value, jacobian, max_calls
        self._residuals = self._jacobians = self._newton = self._attempts = 0
        self._factorisations = self._solves = 0
        #: Factorisations and solves of complex systems among all.
        self.complex_factorisations = self.complex_solves = 0
        self._now = self._earliest = math.inf
        #: Whether all values since the last accepted step were finite.
        self.finite = True

    def begin_step(self, t: float) -> None:
        """Note that the solver begins a step at time t."""
        self._now, self._earliest, self.finite = t, math.inf, True

    def value(self, t: float, *vectors: np.ndarray) -> np.ndarray:
        """The right-hand side or residual, counted.

        Raises
        ------
        EarlyEnd
            If the calls are used up, or the time is NaN.
        """
        if self._residuals == self._max_calls:
            raise EarlyEnd("budget_exceeded", f"{self._max_calls} calls were used up")
        self._residuals += 1
        if self._now < t <= self._earliest:
            self._newton += 1
            self._attempts += int(t < self._earliest)
            self._earliest = t
        value = np.asarray(self._value(t, *vectors))
        if not all_finite(value):
            self.finite = False
            # Solvers take a smaller step after such a value, unless it made the time NaN.
            if not math.isfinite(t):
                raise EarlyEnd("diverged", NOT_FINITE)
        return value

    def jacobian(self, t: float, *vectors: np.ndarray) -> Any:
        """The Jacobian, counted."""
        self._jacobians += 1
        # Now, as the next call overwrites its arguments.
        return np.asarray(self._jacobian(t, *vectors))

    def count_linear_algebra(self, solver: Any) -> None:
        """Count the factorisations and solves of a solver, whose ``lu`` and ``solve_lu`` change.

        A solver that calls others, as later releases may, leaves them uncounted.
        """
        try:
            factorise, solve = solver.lu, solver.solve_lu
        except AttributeError:
            return

        def counted_lu(matrix: np.ndarray) -> Any:
            self._factorisations += 1
            self.complex_factorisations += np.iscomplexobj(matrix)
            return factorise(matrix)

        def counted_solve(factors: Any, b: np.ndarray) -> np.ndarray:
            self._solves += 1
            self.complex_solves += np.iscomplexobj(b)
            return solve(factors, b)

        solver.lu, solver.solve_lu = counted_lu, counted_solve

    def work(self, steps: int) -> Work:
        """The counts of the run, with its number of accepted steps.

        Factorisations and solves are unknown if there were steps and no solve was seen.
        """
        seen = self._solves or not steps
        return Work(
            steps,
            self._attempts - steps,
            self._newton,
            self._residuals,
            self._jacobians,
            self._factorisations if seen else None,
            self._solves if seen else None,
        )
