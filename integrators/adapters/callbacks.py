"""What solvers share that call the equations back in Python: how compiled functions are called
with few conversions, counting, budget, ways to end."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

from integrators.contract import Work
from problems.runtime import jax

NOT_FINITE = "the equations gave a value that is not finite"


class Stop(Exception):
    """Ends a run from inside a callback."""

    def __init__(self, status: str, reason: str) -> None:
        super().__init__(reason)
        self.status, self.reason = status, reason


def cure(status: str) -> str:
    """What to try after an ending that has nothing to do with the formulation."""
    if status == "budget_exceeded":
        return "raise max_calls or use a larger rtol"
    if status == "diverged":
        return "check the scene's equations beyond this time or use a smaller rtol"
    return "use a larger rtol, or a smaller one if the solution changes abruptly here"


def all_finite(values: np.ndarray) -> bool:
    """Whether every entry of a vector is finite, at a third of what looking at each costs."""
    return _zeros(len(values)).dot(values) == 0.0  # 0 times what is not finite is NaN


@cache
def _zeros(n: int) -> np.ndarray:
    return np.zeros(n)


class Packed:
    """A function of numbers and vectors, compiled once, and called with NumPy arrays.

    JAX makes arrays of its own of the arrays that it is given, at a microsecond each. Here all
    arguments are copied side by side into memory that JAX has been given once and for all. A
    program is done with them when it returns, as programs run in the calling thread (see
    `problems.runtime`); where JAX was in use before us and they do not, the result has to be waited
    for before the next call. Results are new arrays.

    Parameters
    ----------
    function
        Traceable function of arrays.
    lengths
        Lengths of its arguments, which are vectors; None for a scalar.
    """

    def __init__(self, function: Callable, *lengths: int | None) -> None:
        ends = np.cumsum([0, *(1 if n is None else n for n in lengths)]).tolist()
        between = zip(pairwise(ends), lengths, strict=True)
        self._places = [a if n is None else slice(a, b) for (a, b), n in between]
        self._size, self.function = ends[-1], function
        self.program = jax.jit(lambda numbers: function(*(numbers[k] for k in self._places)))

    def at(self, *first: np.ndarray) -> Callable:
        """The function of the remaining arguments, with memory of its own: for one thread."""
        memory = _aligned(self._size)
        for place, value in zip(self._places, first, strict=False):
            memory[place] = value
        places, program = self._places[len(first) :], self.program
        numbers = jax.dlpack.from_dlpack(memory, copy=False)

        def call(*arguments: Any) -> Any:
            # Were zip asked to be strict, it would take as long as all the copying.
            for place, value in zip(places, arguments):  # noqa: B905
                memory[place] = value
            return program(numbers)

        return call


def _aligned(n: int) -> np.ndarray:
    """Memory for n floats that XLA takes as it is: it begins at a multiple of 64 bytes."""
    room = np.zeros(n + 8)
    first = -room.ctypes.data % 64 // 8
    return room[first : first + n]


class Calls:
    """The equations as a stepping solver calls them, counted; one object for each run.

    Iterations and attempts are told by the times of the calls. The first call of every Newton
    iteration is at the earliest time of its attempt, and an attempt that is repeated with a
    smaller step begins earlier than those before it.

    Parameters
    ----------
    value, jacobian
        Functions of (t, ...).
    max_calls
        After so many calls of ``value`` the run ends as budget_exceeded.
    """

    def __init__(self, value: Callable, jacobian: Callable, max_calls: int) -> None:
        self._value, self._jacobian, self._max_calls = value, jacobian, max_calls
        self._residuals = self._jacobians = self._newton = self._attempts = 0
        self._factorisations = self._solves = 0
        self._now = self._earliest = math.inf
        #: Whether all values since the last accepted step were finite.
        self.finite = True

    def begin_step(self, t: float) -> None:
        """Say that the solver stands at time t."""
        self._now, self._earliest, self.finite = t, math.inf, True

    def value(self, t: float, *at: np.ndarray) -> np.ndarray:
        if self._residuals == self._max_calls:
            raise Stop("budget_exceeded", f"{self._max_calls} calls were used up")
        self._residuals += 1
        if self._now < t <= self._earliest:
            self._newton += 1
            self._attempts += int(t < self._earliest)
            self._earliest = t
        value = np.asarray(self._value(t, *at))
        if not all_finite(value):
            self.finite = False
            # Solvers answer to such a value by a smaller step, unless it made the time NaN.
            if not math.isfinite(t):
                raise Stop("diverged", NOT_FINITE)
        return value

    def jacobian(self, t: float, *at: np.ndarray) -> Any:
        self._jacobians += 1
        # Not later: what it is computed from is overwritten by the next call.
        return jax.block_until_ready(self._jacobian(t, *at))

    def watch(self, solver: Any) -> None:
        """Count the factorisations and solves of a solver of scipy's kind."""
        factorise, solve = solver.lu, solver.solve_lu

        def counted_lu(matrix: np.ndarray) -> Any:
            self._factorisations += 1
            return factorise(matrix)

        def counted_solve(factors: Any, b: np.ndarray) -> np.ndarray:
            self._solves += 1
            return solve(factors, b)

        solver.lu, solver.solve_lu = counted_lu, counted_solve

    def work(self, steps: int) -> Work:
        """What was counted, with the number of accepted steps."""
        return Work(
            steps,
            self._attempts - steps,
            self._newton,
            self._residuals,
            self._jacobians,
            self._factorisations,
            self._solves,
        )
