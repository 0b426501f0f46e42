"""Choice of the steps of a run that are rows of its trajectory, and of those that are stored."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Int

    from problems.system import Sizes

#: A trajectory has a row for every step of a run with at most so many; a longer run has its first
#: steps and some thousands spread over the interval. Memory does not grow with the number of steps.
MOST_ROWS = 16_384
#: Rows of large scenes are fewer, so that a trajectory has at most so many numbers (128 MiB), or
#: `LEAST_ROWS` rows. Memory grows with the number of unknowns alone.
MOST_NUMBERS = 2**24
LEAST_ROWS = 4
#: Of these rows the first are stored, which show start-up errors, and about SPREAD_ROWS more.
FIRST_ROWS = 16
SPREAD_ROWS = 200


def width_of(sizes: Sizes) -> int:
    """Count the numbers in a row of a trajectory: q, v, a, lam, x, xdot, y and the time."""
    return 3 * sizes.nq + sizes.nl + 2 * sizes.nx + sizes.ny + 1


def most_rows(width: int) -> int:
    """Return the number of steps up to which each of them is a row of so many numbers."""
    return int(np.clip(MOST_NUMBERS // max(width, 1), LEAST_ROWS, MOST_ROWS))


def kept_rows(steps: int, width: int = 1) -> Int[np.ndarray, " k"]:
    """Choose the steps whose ends are rows of a trajectory: all, or a quarter of `most_rows`.

    Parameters
    ----------
    steps
        Number of steps of the run.
    width
        Numbers in a row.

    Returns
    -------
    Step numbers in ascending order, from 0 (the start) to ``steps``.
    """
    most = most_rows(width)
    if steps <= most:
        return np.arange(steps + 1)
    return spread_rows(steps, most // 4, min(FIRST_ROWS, most // 4))


def spread_rows(
    steps: int, most: int = SPREAD_ROWS, first: int = FIRST_ROWS
) -> Int[np.ndarray, " k"]:
    """Choose the first steps and some spread over the run.

    They are the start, the ``first`` steps, and about ``most`` more at equal distance.
    The distance is a whole number of steps where a divisor of their number allows it, so that runs
    with nested steps are shown at the same times.

    Parameters
    ----------
    steps
        Number of steps of the run.
    most
        Largest number of steps at equal distance.
    first
        Number of steps at the start.

    Returns
    -------
    Step numbers in ascending order, from 0 (the start) to ``steps``.
    """
    most, least = min(steps, most), most // 2
    rows = next((d for d in range(most, least, -1) if steps % d == 0), most)
    spread = np.round(np.arange(rows + 1) * (steps / max(rows, 1))).astype(np.int64)
    return np.union1d(np.arange(min(first, steps) + 1), spread)


class RowKeeper:
    """Rows of a run whose number of steps is not known beforehand: all, up to `most_rows`.

    Of more steps every fourth is a row, of more than four times as many every 16th, and so on,
    beside the first ones and the last. The others are not held in memory.

    Parameters
    ----------
    width
        Numbers in a row.
    start
        The first row.
    """

    def __init__(self, width: int, start: Any) -> None:
        self._most, self._stride = most_rows(width), 1
        self._first = min(FIRST_ROWS, self._most // 4)
        self._rows = [(0, start)]
        self.steps, self.last = 0, start

    def add(self, row: Any) -> None:
        """Take the row of the next step."""
        self.steps, self.last = self.steps + 1, row
        if self._stays(self.steps):
            self._rows.append((self.steps, row))
        if len(self._rows) > self._most + 1:
            self._stride *= 4
            self._rows = [kept for kept in self._rows if self._stays(kept[0])]

    def rows(self) -> list[Any]:
        """Return the rows in the order of steps, from the start to the last."""
        rows = [row for _, row in self._rows]
        return rows if self._rows[-1][0] == self.steps else [*rows, self.last]

    def _stays(self, step: int) -> bool:
        return step <= self._first or step % self._stride == 0
