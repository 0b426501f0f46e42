"""Choice of the steps of a run that are rows of its trajectory, and of those that are stored."""

from __future__ import annotations

from itertools import compress
from typing import TYPE_CHECKING, Any

import numpy as np

from problems.variables import row_layout

if TYPE_CHECKING:
    from jaxtyping import Int

    from problems.variables import Sizes

#: A trajectory has a row for every step of a run with at most so many, and of a longer run those of
#: `is_row`. Memory does not grow with the number of steps.
MOST_ROWS = 16_384
#: Rows of large scenes are fewer, so that a trajectory has at most so many numbers (128 MiB), or
#: `LEAST_ROWS` rows. Memory grows with the number of unknowns alone.
MOST_NUMBERS = 2**24
LEAST_ROWS = 4
#: The first steps are rows of every run, as they show start-up errors.
FIRST_ROWS = 16
#: Of the rows of a trajectory the first are stored, and about so many more.
SPREAD_ROWS = 200
#: Times so dense that every step is the first after one of them.
EVERY_STEP = 10**15
#: Times of steps are rounded: one that misses a time by this part of the distance has reached it.
_ROUNDING = 1e-6


def width_of(sizes: Sizes) -> int:
    """Count the numbers in a row of a trajectory: q, v, a, lam, x, xdot, y and the time."""
    return 1 + row_layout(sizes).size


def most_rows(width: int) -> int:
    """Return the number of steps up to which each of them is a row of so many numbers."""
    return int(np.clip(MOST_NUMBERS // max(width, 1), LEAST_ROWS, MOST_ROWS))


def row_times(steps: int, width: int = 1) -> int:
    """Return the number of equally spaced times after which steps are rows (see `is_row`), of a run
    with so many steps and numbers in a row."""
    most = most_rows(width)
    return EVERY_STEP if steps <= most else most // 4


def is_row(step: Any, before: Any, part: Any, times: Any) -> Any:
    """Whether steps are rows: the rule for all integrators, whatever chooses their steps.

    Rows are the first steps, the last one, which is known at the end alone, and the first step to
    end at or after each of so many equally spaced times. So every part of the interval is judged
    at the same density. All arguments may be arrays, and traced.

    Parameters
    ----------
    step
        Number of the step, from 1.
    before, part
        Parts of the interval, from 0 to 1, that lie before the start and the end of the step.
    times
        Number of equally spaced times (see `row_times`).
    """
    first = (step <= FIRST_ROWS) & (step <= times)
    return first | (_reached(part, times) > _reached(before, times))


def _reached(part: Any, times: Any) -> Any:
    return (part * times + _ROUNDING) // 1


def spread_rows(steps: int) -> Int[np.ndarray, " k"]:
    """Choose the first steps and some spread over the run.

    They are the start, `FIRST_ROWS` steps, and at most `SPREAD_ROWS` more at equal distance, in
    ascending order from 0 to ``steps``. The distance is a whole number of steps where a divisor of
    their number allows it, so that runs with nested steps are shown at the same times.
    """
    most, least = min(steps, SPREAD_ROWS), SPREAD_ROWS // 2
    rows = next((d for d in range(most, least, -1) if steps % d == 0), most)
    spread = np.round(np.arange(rows + 1) * (steps / max(rows, 1))).astype(np.int64)
    return np.union1d(np.arange(min(FIRST_ROWS, steps) + 1), spread)


class RowKeeper:
    """Rows of a run whose number of steps is not known beforehand; the others are not held.

    Parameters
    ----------
    width
        Numbers in a row.
    start
        The first row; a row begins with its time in s.
    t_end
        End of the run in s.
    """

    def __init__(self, width: int, start: tuple, t_end: float) -> None:
        self._width, self._t0, self._length = width, start[0], t_end - start[0]
        self._rows, self._times = [start], row_times(0)
        self.steps, self.last = 0, start

    def add(self, row: tuple) -> None:
        """Take the row of the next step."""
        before, self.last, self.steps = self._part(self.last), row, self.steps + 1
        if is_row(self.steps, before, self._part(row), self._times):
            self._rows.append(row)
        if len(self._rows) > most_rows(self._width) + 1:
            self._times = row_times(self.steps, self._width)
            parts = np.array([self._part(kept) for kept in self._rows])
            stay = is_row(np.arange(1, len(parts)), parts[:-1], parts[1:], self._times)
            self._rows = [self._rows[0], *compress(self._rows[1:], stay)]

    def rows(self) -> list[tuple]:
        """Return the rows in the order of steps, from the start to the last."""
        return self._rows if self._rows[-1] is self.last else [*self._rows, self.last]

    def _part(self, row: tuple) -> float:
        return (row[0] - self._t0) / self._length
