"""Answers of the functions for notebooks: arrays, frames, and a chart where one is shown."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.commands.pages import view
from bench.results.records import Record, Rows

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Solution:
    """A run of one integrator on one scene; a notebook shows its components over time.

    Parameters
    ----------
    status, message
        "ok" with notes on what is wrong, if any, or how it ended, with the reason.
    t
        Times in s of the rows that are kept: the first steps, and 100 to 200 more.
    q, v, a, lam, x, y, xd
        Values at these times, a row per time and a column per component.
    components
        Names of the columns by group, with units.
    errors
        Relative errors by group and norm: ``errors["a"]["max"]`` is that of the worst component of
        the acceleration, the largest over all steps.
    work, operations
        Counts by name, and floating-point operations in total (None if they are not known).
    seconds
        Median time in s of the bare solve; None if it was not timed.
    """

    problem: str
    integrator: str
    resolution: str
    status: str
    message: str
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    x: np.ndarray
    y: np.ndarray
    xd: np.ndarray
    components: dict[str, list[str]]
    errors: dict[str, dict[str, float | None]]
    work: dict[str, int | None]
    operations: float | None
    seconds: float | None
    _rows: Rows = field(repr=False)

    @property
    def title(self) -> str:
        """The integrator, the scene, the resolution, and how the run ended."""
        return f"{self.integrator} on {self.problem}, {self.resolution}: {self.status}"

    def __repr__(self) -> str:
        return f"<{self.title}; {len(self.t)} rows>"

    def _repr_svg_(self) -> str | None:
        if not len(self.t):
            return None
        return view("solution_chart")(self.integrator, self._rows, self.components)


@dataclass(frozen=True)
class Orders:
    """Orders of convergence of one integrator on one scene; a notebook shows errors over steps.

    Parameters
    ----------
    steps
        Step sizes in s.
    orders, window, points, verdict
        The fitted order by group and norm (None if it is not determined), the largest and the
        smallest step of the fit in s, the number of its points, and a verdict in words.
    errors
        Relative errors by group and norm, one per step.
    status
        How each run ended.
    """

    steps: list[float]
    orders: dict[str, dict[str, float | None]]
    window: dict[str, dict[str, Any]]
    points: dict[str, dict[str, int]]
    verdict: dict[str, dict[str, str]]
    errors: dict[str, dict[str, list[float | None]]]
    status: list[str]
    _records: list[Record] = field(repr=False)

    @cached_property
    def frame(self) -> pd.DataFrame:
        """A pandas frame with a row for each group and norm."""
        rows = [
            {
                "group": group,
                "norm": norm,
                "order": fitted,
                "window": self.window[group][norm],
                "points": self.points[group][norm],
                "verdict": self.verdict[group][norm],
            }
            for group, by_norm in self.orders.items()
            for norm, fitted in by_norm.items()
        ]
        return pandas_module().DataFrame(rows)

    def _repr_svg_(self) -> str | None:
        return view("orders_chart")(self._records)


@dataclass(frozen=True)
class Results:
    """The results in a folder as pandas frames.

    Parameters
    ----------
    folder
        The folder.
    runs
        A row per run: names, resolution, status, ``error_a_max`` ..., ``work_residuals`` ...,
        ``operations``, ``run_s_median``. ``pattern``, ``run_s`` and the errors of components are
        lists.
    samples
        A row per timing sample: the key of the run, the number of the round, and seconds.
    scenes
        A row per scene: sizes, parameters (a dictionary), reference and its own error.
    environments
        A row per invocation that measured: name, date, command, machine and versions.
    """

    folder: Path
    runs: pd.DataFrame
    samples: pd.DataFrame
    scenes: pd.DataFrame
    environments: pd.DataFrame
    _state: str = field(repr=False)

    def __repr__(self) -> str:
        return f"<{self.folder}: {self._state}>"


def pandas_module() -> Any:
    """Return pandas.

    Raises
    ------
    ImportError
        If it is not installed; the message names the extra.
    """
    try:
        import pandas
    except ImportError:
        raise ImportError("pandas is not installed; install stepbench[notebook].") from None
    return pandas
