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


#: By the name of the class of a method, operations of a solver of n unknowns at order k, or with k
#: stages: those of an attempt of a step over n, as coefficients of 1, k and k^2 (prediction, error
#: test, history, tests of other orders, error weights); of an iteration over n; of making a matrix
#: that is factorised, over n^2, and of what goes with it, over n (k + 1)^2.
#: CVODE multiplies by Pascal's triangle. Radau's three stages are W = T^-1 Z, with matrices
#: gamma/h I - J that alternate between real and complex; a new I - c J of BDF scales its
#: differences anew. Implicit methods of diffrax predict each stage, and have two norms in an
#: iteration.
_OF_VECTORS = {
    "IDA": ((18, 4, 0), 8, 0, 0),
    "CVODE": ((12, 2.5, 0.5), 9, 2, 0),
    **dict.fromkeys(("Radau", "RadauDAE"), ((69, 0, 0), 56, 1.5, 0)),
    **dict.fromkeys(("BDF", "BDFDAE"), ((18, 4, 0), 8, 2, 2)),
    "explicit": ((6, 3, 1), 0, 0, 0),
    "implicit": ((6, 2, 2), 10, 2, 0),
}


def own_work(
    solver: str, n: int, k: float, attempts: float, iterations: float, matrices: float
) -> float:
    """Operations on vectors of a run; Runge-Kutta methods of diffrax are explicit or implicit."""
    (one, by_order, by_square), iteration, matrix, renewal = _OF_VECTORS[solver]
    of_vectors = attempts * (one + by_order * k + by_square * k**2)
    of_vectors += iterations * iteration + matrices * renewal * (k + 1) ** 2
    return n * of_vectors + n**2 * matrices * matrix
