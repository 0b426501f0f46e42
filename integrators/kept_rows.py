"""Choice of the steps of a run that are rows of its trajectory, and of those that are stored."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Int

#: A trajectory has a row for every step of a run with at most so many; a longer run has its first
#: steps and some thousands spread over the interval. Memory does not grow with the number of steps.
MOST_ROWS = 16_384
#: Of these rows the first are stored, which show start-up errors, and about SPREAD_ROWS more.
FIRST_ROWS = 16
SPREAD_ROWS = 200


def kept_rows(steps: int) -> Int[np.ndarray, " k"]:
    """Choose the steps whose ends are rows of a trajectory: all, or `MOST_ROWS` / 4 of more.

    Parameters
    ----------
    steps
        Number of steps of the run.

    Returns
    -------
    Step numbers in ascending order, from 0 (the start) to ``steps``.
    """
    if steps <= MOST_ROWS:
        return np.arange(steps + 1)
    return spread_rows(steps, MOST_ROWS // 4)


def spread_rows(steps: int, most: int = SPREAD_ROWS) -> Int[np.ndarray, " k"]:
    """Choose the first steps and some spread over the run.

    They are the start, the first `FIRST_ROWS` steps, and about ``most`` more at equal distance.
    The distance is a whole number of steps where a divisor of their number allows it, so that runs
    with nested steps are shown at the same times.

    Parameters
    ----------
    steps
        Number of steps of the run.
    most
        Largest number of steps at equal distance.

    Returns
    -------
    Step numbers in ascending order, from 0 (the start) to ``steps``.
    """
    most, least = min(steps, most), most // 2
    rows = next((d for d in range(most, least, -1) if steps % d == 0), most)
    spread = np.round(np.arange(rows + 1) * (steps / max(rows, 1))).astype(np.int64)
    return np.union1d(np.arange(min(FIRST_ROWS, steps) + 1), spread)
