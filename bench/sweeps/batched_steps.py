"""How runs side by side go in time: at constant steps, or at steps that follow a tolerance.

A pace gives a compiled march what it takes last, and reads the rows and the ending that it returns.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from integrators.contract import Steps, Tolerances
from integrators.native import adaptive_loop, time_loop
from integrators.native.adaptive_loop import AdaptiveMethod


class Rows(NamedTuple):
    """Rows of k runs: times ``(k, r)`` and values ``(k, r, n)``, NaN where a row was not reached;
    how many there are in a complete run ``(k,)``; endings ``(k, [status, t])``, counts ``(k, c)``.
    """

    t: np.ndarray
    values: np.ndarray
    complete: np.ndarray
    endings: np.ndarray
    counts: np.ndarray


class Pace(Protocol):
    """The time of many runs; ``places`` are places among all of them."""

    #: Names of what is counted.
    counts: tuple[str, ...]
    #: What a march takes last, for each that is different.
    numbers: list[Any]

    def longest_first(self) -> np.ndarray:
        """The places of all runs in the order in which they are best begun."""

    def of(self, places: np.ndarray, idle: np.ndarray) -> np.ndarray:
        """Places in ``numbers``; those that are idle shall take no step."""

    def wanted(self, places: np.ndarray, idle: np.ndarray) -> tuple[Any, ...]:
        """Which rows a march shall keep, as it takes them."""

    def read(self, places: np.ndarray, answer: tuple[np.ndarray, ...]) -> Rows:
        """What a march returned."""

    def outcome(self, place: int, ending: np.ndarray) -> tuple[str, str]:
        """Status and message of a run."""


class ConstantSteps:
    """Runs at constant steps, or patterns of them."""

    counts = ("steps", *time_loop.StepReport._fields[1:])

    def __init__(self, steps: Sequence[Steps], t0: float, t_end: float, every_row: bool) -> None:
        different, self._of = distinct(steps)
        clocks, rows = zip(*(time_loop.grid(t0, t_end, s) for s in different), strict=True)
        rows = [numbers if every_row else numbers[-1:] for numbers in rows]
        self.numbers = list(clocks)
        self._row_counts = np.array([len(numbers) for numbers in rows])
        self._rows = np.zeros((len(rows), self._row_counts.max()), dtype=np.int64)
        for table, numbers in zip(self._rows, rows, strict=True):
            table[: len(numbers)] = numbers

    def longest_first(self) -> np.ndarray:
        return np.argsort(-self._rows.max(axis=1)[self._of], kind="stable")

    def of(self, places: np.ndarray, idle: np.ndarray) -> np.ndarray:
        return self._of[places]

    def wanted(self, places: np.ndarray, idle: np.ndarray) -> tuple[Any, ...]:
        of = self._of[places]
        return self._rows[of], np.where(idle, 0, self._row_counts[of])

    def read(self, places: np.ndarray, answer: tuple[np.ndarray, ...]) -> Rows:
        table, end = answer
        of = self._of[places]
        table[table[:, :, 0] != self._rows[of]] = np.nan
        return Rows(table[:, :, 1], table[:, :, 2:], self._row_counts[of], end[:, :2], end[:, 2:])

    def outcome(self, place: int, ending: np.ndarray) -> tuple[str, str]:
        return time_loop.outcome(int(ending[0]), float(ending[1]))


class ChosenSteps:
    """Runs whose steps follow a tolerance."""

    counts = ("steps", "rejected", *time_loop.StepReport._fields[1:])

    def __init__(
        self,
        tolerances: Sequence[Tolerances],
        methods: Sequence[AdaptiveMethod],
        t0: float,
        t_end: float,
        every_row: bool,
    ) -> None:
        self._every_row = every_row
        spans = [
            method.span(t0, t_end, asked) for asked, method in zip(tolerances, methods, strict=True)
        ]
        self.numbers, self._of = distinct(spans)
        # A run over no time takes no step.
        self.numbers.append(self.numbers[0]._replace(t_end=t0))

    def longest_first(self) -> np.ndarray:
        return np.argsort([self.numbers[k].rtol for k in self._of], kind="stable")

    def of(self, places: np.ndarray, idle: np.ndarray) -> np.ndarray:
        return np.where(idle, len(self.numbers) - 1, self._of[places])

    def wanted(self, places: np.ndarray, idle: np.ndarray) -> tuple[Any, ...]:
        return (np.ones(len(places), dtype=np.int64) if self._every_row else None,)

    def read(self, places: np.ndarray, answer: tuple[np.ndarray, ...]) -> Rows:
        early, spread, last, end = answer
        tables = np.concatenate([early, spread, last[:, None]], axis=1)
        if not self._every_row:
            tables[end[:, 0] != 0] = 0  # an end that was not reached is no row
        kept = [adaptive_loop.in_order(table) for table in tables]
        complete = np.array([max(1, len(rows)) for rows in kept])
        table = np.full((len(kept), complete.max(), last.shape[1]), np.nan)
        for place, rows in zip(table, kept, strict=True):
            place[: len(rows)] = rows
        return Rows(table[:, :, 1], table[:, :, 2:], complete, end[:, :2], end[:, 2:])

    def outcome(self, place: int, ending: np.ndarray) -> tuple[str, str]:
        span = self.numbers[self._of[place]]
        return adaptive_loop.outcome(int(ending[0]), float(ending[1]), span)


def distinct(values: Iterable[Any]) -> tuple[list[Any], np.ndarray]:
    """The different ones in their order, and the place of each among them."""
    places: dict[Any, int] = {}
    of = [places.setdefault(value, len(places)) for value in values]
    return list(places), np.array(of)
