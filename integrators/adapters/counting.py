"""Counting of a function's evaluations inside compiled code, by callbacks of JAX.

A callback takes some ten microseconds, so that a program that counts is not one that is timed.
"""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Any, NamedTuple

from problems.runtime import jax


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
