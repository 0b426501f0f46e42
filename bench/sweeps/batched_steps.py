"""The times of many runs: constant steps, or steps that follow a tolerance.

Both kinds give a compiled time loop its last arguments, of which ``numbers`` are the different
ones, and read what it returns. ``places`` are indices of runs among all.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from integrators.contract import Integrator
from integrators.native.algebra.step_records import COUNTS
from integrators.native.loops import adaptive_steps, constant_steps
from integrators.native.loops.adaptive_steps import Span
from integrators.native.loops.kernel import Form, Kernel
from integrators.native.loops.status import Ending
from integrators.native.step.step_program import StepProgram
from integrators.output_rows import FIRST_ROWS, SPREAD_ROWS
from integrators.resolutions import Steps, Tolerances
from problems.base.runtime import Float, Int
from problems.system import MechatronicSystem


class BatchRun(NamedTuple):
    """One of many runs; equal parts of several runs are made once."""

    scene: MechatronicSystem
    method: Integrator
    resolution: Steps | Tolerances


class BatchRows(NamedTuple):
    """Rows, endings and work counts of k runs; NaN in rows that a run did not reach.

    ``complete`` are the numbers of rows of complete runs, ``endings`` rows [ending, t].
    """

    t: Float[np.ndarray, "k r"]
    values: Float[np.ndarray, "k r n"]
    complete: Int[np.ndarray, " k"]
    endings: Float[np.ndarray, "k 2"]
    counts: Float[np.ndarray, "k c"]


class ConstantSteps:
    """Runs at constant steps, or patterns of them."""

    counts = ("steps", *COUNTS)

    def __init__(self, steps: Sequence[Steps], t0: float, t_end: float, every_row: bool) -> None:
        self._t_end = t_end
        different, self._of = distinct(steps)
        clocks, ends = zip(*(constant_steps.grid(t0, t_end, s) for s in different), strict=True)
        rows = [
            constant_steps.kept_steps(clock, end, SPREAD_ROWS) if every_row else np.array([end])
            for clock, end in zip(clocks, ends, strict=True)
        ]
        self.numbers = list(clocks)
        self._row_counts = np.array([len(numbers) for numbers in rows])
        self._rows = np.zeros((len(rows), self._row_counts.max()), dtype=np.int64)
        for table, numbers in zip(self._rows, rows, strict=True):
            table[: len(numbers)] = numbers

    def kernel(self, program: StepProgram, template: MechatronicSystem, form: Form) -> Kernel:
        """Return the compiled time loop of a method on a kind of scene."""
        return constant_steps.kernel(program, template, form)

    def longest_first(self) -> np.ndarray:
        """Return the places of all runs, the longest run first."""
        return np.argsort(-self._rows.max(axis=1)[self._of], kind="stable")

    def of(self, places: np.ndarray, idle: np.ndarray) -> np.ndarray:
        """Return places in ``numbers``; an ``idle`` run takes no step."""
        return self._of[places]

    def wanted(self, places: np.ndarray, idle: np.ndarray) -> tuple[Any, ...]:
        """Return the arguments of a loop that select the rows to keep."""
        of = self._of[places]
        return self._rows[of], np.where(idle, 0, self._row_counts[of])

    def read(self, places: np.ndarray, answer: tuple[np.ndarray, ...]) -> BatchRows:
        """Return rows and endings from the result of a loop."""
        table, end = answer
        of = self._of[places]
        table[table[:, :, 0] != self._rows[of]] = np.nan
        return BatchRows(
            table[:, :, 1], table[:, :, 2:], self._row_counts[of], end[:, :2], end[:, 2:]
        )

    def outcome(self, place: int, ending: Ending, t: float) -> tuple[str, str]:
        """Return status and message of a run that ended at t (s)."""
        return ending.outcome(t, self._t_end)


class ChosenSteps:
    """Runs whose steps follow a tolerance; methods as of `ConstantSteps`."""

    counts = ("steps", "rejected", *COUNTS)

    def __init__(
        self,
        tolerances: Sequence[Tolerances],
        step_limits: Sequence[int],
        t0: float,
        t_end: float,
        every_row: bool,
    ) -> None:
        self._every_row = every_row
        spans = [
            Span(t0, t_end, asked.rtol, asked.atol, most)
            for asked, most in zip(tolerances, step_limits, strict=True)
        ]
        self.numbers, self._of = distinct(spans)
        # A run over no time takes no step.
        self.numbers.append(self.numbers[0]._replace(t_end=t0))

    def kernel(self, program: StepProgram, template: MechatronicSystem, form: Form) -> Kernel:
        return adaptive_steps.kernel(program, template, form)

    def longest_first(self) -> np.ndarray:
        return np.argsort([self.numbers[k].rtol for k in self._of], kind="stable")

    def of(self, places: np.ndarray, idle: np.ndarray) -> np.ndarray:
        return np.where(idle, len(self.numbers) - 1, self._of[places])

    def wanted(self, places: np.ndarray, idle: np.ndarray) -> tuple[Any, ...]:
        if not self._every_row:
            return None, None
        rows = np.arange(1, FIRST_ROWS + SPREAD_ROWS + 1)
        return np.tile(rows, (len(places), 1)), np.full(len(places), SPREAD_ROWS)

    def read(self, places: np.ndarray, answer: tuple[np.ndarray, ...]) -> BatchRows:
        rows, last, end = answer
        tables = np.concatenate([rows, last[:, None]], axis=1)
        if not self._every_row:
            tables[end[:, 0] != 0] = 0  # a run that failed early has no last row
        kept = [adaptive_steps.in_order(table) for table in tables]
        complete = np.array([max(1, len(rows)) for rows in kept])
        table = np.full((len(kept), complete.max(), last.shape[1]), np.nan)
        for place, rows in zip(table, kept, strict=True):
            place[: len(rows)] = rows
        return BatchRows(table[:, :, 1], table[:, :, 2:], complete, end[:, :2], end[:, 2:])

    def outcome(self, place: int, ending: Ending, t: float) -> tuple[str, str]:
        span = self.numbers[self._of[place]]
        return ending.outcome(t, float(span.t_end), int(span.max_steps))


def times_of(
    runs: Sequence[BatchRun], t_end: float, every_row: bool
) -> ConstantSteps | ChosenSteps:
    """The times of runs that have either all steps or all tolerances."""
    t0 = runs[0].scene.interval[0]
    steps = [run.resolution for run in runs if isinstance(run.resolution, Steps)]
    if steps:
        return ConstantSteps(steps, t0, t_end, every_row)
    tolerances = [run.resolution for run in runs if isinstance(run.resolution, Tolerances)]
    limits = [run.method.step_method(run.scene).step_limit for run in runs]
    return ChosenSteps(tolerances, limits, t0, t_end, every_row)


def distinct(values: Iterable[Any]) -> tuple[list[Any], np.ndarray]:
    """The different values in order of appearance, and for each value its place among them."""
    places: dict[Any, int] = {}
    of = [places.setdefault(value, len(places)) for value in values]
    return list(places), np.array(of)
