"""Counting of a function's evaluations inside compiled code."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from problems.runtime import jax


class Counter:
    """Counts evaluations and linearisations of a function inside compiled code."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.reset()

    def reset(self) -> None:
        self.evaluations = self.linearisations = 0

    def _evaluated(self) -> None:
        with self._lock:
            self.evaluations += 1

    def _linearised(self) -> None:
        with self._lock:
            self.linearisations += 1

    def watch(self, rate: Callable) -> Callable:
        """The same function of (t, s, p), counted.

        A linearisation in s passes once through the rule below, however many directions are
        then pushed through its linear part. The callbacks take no arguments, so that they stand
        outside of that part.
        """

        @jax.custom_jvp
        def counted(t: Any, s: Any, p: Any) -> Any:
            jax.debug.callback(self._evaluated)
            return rate(t, s, p)

        @counted.defjvp
        def linearise(at: tuple, directions: tuple) -> tuple:
            jax.debug.callback(self._linearised)
            t, s, p = at
            # Along s alone: nothing here differentiates with respect to time or parameters.
            return jax.jvp(lambda s: rate(t, s, p), (s,), (directions[1],))

        return counted
