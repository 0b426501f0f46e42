"""Counts of the work of other libraries' solvers: evaluations, and operations on vectors.

Evaluations are counted by callbacks of JAX. A callback takes some ten microseconds, so that a
program that counts is not one that is timed.

Operations are estimates, by formulas of each library: what the documented algorithms do in each
attempt of a step, in each iteration of Newton's method and with each matrix. A norm, a product, a
square and a sum, takes 3 for each entry, so do error weights 1/(rtol |y| + atol). Scaling after a
change of the step, and tests that are seldom made, are left out. Sources: user guides of IDA and
CVODE, "Mathematical Considerations" (Hindmarsh et al. 2005, doi:10.1145/1089014.1089020);
scipy.integrate._ivp.radau and .bdf; diffrax._solver.runge_kutta.
"""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Any, NamedTuple

from problems.base.runtime import jax


class Counts(NamedTuple):
    """Numbers of evaluations and linearisations of a watched function."""

    evaluations: int
    linearisations: int


#: Of the run at hand.
_tally = [0, 0]
_one_at_a_time = Lock()


def watch(function: Callable) -> Callable:
    """Return the same function, counted in runs under `run_counted`.

    A linearisation counts once, in whatever arguments it is and however many directions follow:
    callbacks take no arguments, so that they stand outside of its linear part.
    """
    from jax.experimental import io_callback

    @jax.custom_jvp
    def counted(*arguments: Any) -> Any:
        io_callback(_evaluated, None)
        return function(*arguments)

    @counted.defjvp
    def linearise(arguments: tuple, directions: tuple) -> tuple:
        io_callback(_linearised, None)
        return jax.jvp(function, arguments, directions)

    return counted


def _evaluated() -> None:
    _tally[0] += 1


def _linearised() -> None:
    _tally[1] += 1


def run_counted(program: Callable, *arguments: Any) -> tuple[Any, Counts]:
    """Call a program of watched functions; return its finished result and the counts."""
    with _one_at_a_time:
        _tally[:] = 0, 0
        result = jax.block_until_ready(program(*arguments))
        jax.effects_barrier()
        return result, Counts(*_tally)


class VectorWork(NamedTuple):
    """Operations of a solver of n unknowns at order k, or with k stages.

    ``attempt`` is that of an attempt of a step over n, as coefficients of 1, k and k^2: prediction,
    error test, history, tests of other orders, error weights. ``iteration`` is over n, ``matrix``
    that of making a matrix that is factorised, over n^2, and ``renewal`` what goes with it, over
    n (k + 1)^2.
    """

    attempt: tuple[float, float, float]
    iteration: float
    matrix: float = 0.0
    renewal: float = 0.0

    def operations(
        self, n: int, k: float, attempts: float, iterations: float, matrices: float
    ) -> float:
        """Operations of a run."""
        one, by_order, by_square = self.attempt
        of_vectors = attempts * (one + by_order * k + by_square * k**2)
        of_vectors += iterations * self.iteration + matrices * self.renewal * (k + 1) ** 2
        return n * of_vectors + n**2 * matrices * self.matrix


# scipy's: Radau's three stages are W = T^-1 Z, with matrices gamma/h I - J that alternate between
# real and complex; a new I - c J of BDF scales its differences anew.
_RADAU = VectorWork((69, 0, 0), 56, matrix=1.5)
_BDF = VectorWork((18, 4, 0), 8, matrix=2, renewal=2)
#: By the name of the class of a method. CVODE multiplies by Pascal's triangle.
VECTOR_WORK = {
    "IDA": VectorWork((18, 4, 0), 8),
    "CVODE": VectorWork((12, 2.5, 0.5), 9, matrix=2),
    **{"Radau": _RADAU, "RadauDAE": _RADAU, "BDF": _BDF, "BDFDAE": _BDF},
}
#: Runge-Kutta methods of diffrax; implicit ones predict each stage and have two norms in an
#: iteration.
EXPLICIT, IMPLICIT = VectorWork((6, 3, 1), 0), VectorWork((6, 2, 2), 10, matrix=2)
