"""Ensembles: many members of one scene and integrator, run in one compiled program."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.running.plan import check_end
from bench.sweeps.batch import Batch, Block, refuse
from bench.sweeps.variation import apart_from, number, usual, varied
from integrators.contract import Integrator, Steps, Tolerances
from problems.spec import SpecError
from problems.system import MechatronicSystem

_OUT_OF_TIME = "The ensemble's time was used up before; raise the budget."


@dataclass(frozen=True)
class Ensemble:
    """What the members did; arrays have one entry per member, in their order.

    ``problem`` and ``integrator`` are printed names without what varies.
    ``vary`` holds the numbers in which the members differ, ``ends`` the values at t_end of q, v, a,
    lam, x, xdot and y, each ``(members, n)`` and NaN where a run failed, ``t`` the time that was
    reached, and ``work`` the counts. ``status`` and ``message`` are those of single runs.
    """

    problem: str
    integrator: str
    t_end: float
    vary: dict[str, np.ndarray]
    status: list[str]
    message: list[str]
    t: np.ndarray
    ends: dict[str, np.ndarray]
    work: dict[str, np.ndarray]
    compile_s: float
    run_s: float

    def rows(self) -> list[dict[str, Any]]:
        """A flat row per member, for pandas: ``member, h, k, status, t, q1, q2, ..., work_steps``;
        None where there is no number."""
        columns: dict[str, Sequence[Any]] = {
            "member": range(len(self.status)),
            **self.vary,
            "status": self.status,
            "message": self.message,
            "t": self.t,
            **self._end_columns(),
            **{f"work_{name}": counts for name, counts in self.work.items()},
        }
        lists = [v.tolist() if isinstance(v, np.ndarray) else v for v in columns.values()]
        # A value that is not a number differs from itself.
        return [
            {
                name: None if value != value else value
                for name, value in zip(columns, row, strict=True)
            }
            for row in zip(*lists, strict=True)
        ]

    def summary(self) -> dict[str, dict[str, float]]:
        """Least, median and largest of each end value over the members that are ok."""
        good = np.array([status == "ok" for status in self.status])
        if not good.any():
            return {}
        return {
            name: {
                "min": float(v[good].min()),
                "median": float(np.median(v[good])),
                "max": float(v[good].max()),
            }
            for name, v in self._end_columns().items()
        }

    def statuses(self) -> dict[str, int]:
        """How many members ended how."""
        return dict(Counter(self.status))

    def _end_columns(self) -> dict[str, np.ndarray]:
        return {
            f"{group}{k + 1}": column
            for group, table in self.ends.items()
            for k, column in enumerate(table.T)
        }


def ensemble(
    scene: MechatronicSystem,
    method: Integrator,
    vary: Mapping[str, Sequence[float]],
    resolution: Steps | Tolerances | None = None,
    t_end: float | None = None,
    budget: float = float("inf"),
    jobs: int | None = None,
) -> Ensemble:
    """Run as many members as ``vary`` has values, which has to be the same number for every name.

    Parameters
    ----------
    vary
        Values by name: ``h`` for the step, ``rtol`` or ``atol`` of a method that chooses its steps,
        a float parameter of the scene or option of the integrator; ``step.h``, ``scene.NAME``,
        ``integrator.NAME`` where one stands for two things.
    resolution
        The step or the tolerances of members where they do not vary; if not given, the scene's
        nominal step, or rtol=1e-6.
    t_end
        End time in s; the scene's own if not given.
    budget
        Seconds after which no further members are begun; compiling is not counted.
    jobs
        Threads; one per processor if not given.

    Raises
    ------
    SpecError
        If a name or a value is not allowed, or the integrator cannot run many as one program.
    """
    refuse(method, scene)
    values = {name: np.asarray(v, dtype=float) for name, v in vary.items()}
    shapes = {v.shape for v in values.values()}
    if len(shapes) != 1 or (shape := shapes.pop()) == (0,) or len(shape) != 1:
        raise SpecError("An ensemble takes equally many values, at least one, of each that varies.")
    end = check_end(scene.interval[0], scene.interval[1] if t_end is None else t_end)
    if not np.isfinite(np.concatenate(list(values.values()))).all():
        raise SpecError("A value of an ensemble is not a finite number.")
    started = time.perf_counter()
    numbers = {number(name, scene, method): v for name, v in values.items()}
    batch = Batch(varied(scene, method, resolution or usual(scene, method), numbers), end)
    batch.warm()
    compiled = time.perf_counter()
    count = shape[0]
    status, message = ["budget_exceeded"] * count, [_OUT_OF_TIME] * count
    t, ends, work = np.full(count, scene.interval[0]), {}, {}
    for block in within(budget, batch.blocks(jobs)):
        for k, *said in zip(block.members, block.status, block.message, strict=True):
            status[k], message[k] = said
        t[block.members] = block.t_last
        for name, rows in block.values.items():
            last = rows[:, -1]
            ends.setdefault(name, np.full((count, last.shape[1]), np.nan))[block.members] = last
        for name, counts in zip(batch.counts, block.counts.T, strict=False):
            work.setdefault(name, np.zeros(count, dtype=np.int64))[block.members] = counts
    done = time.perf_counter()
    return Ensemble(
        apart_from(scene, numbers), apart_from(method, numbers), end, values, status, message, t,
        {name: table for name, table in ends.items() if table.shape[1]}, work,
        compiled - started, done - compiled,
    )  # fmt: skip


def within(budget: float, blocks: Iterator[Block]) -> Iterator[Block]:
    """Blocks until so many seconds are over; the first one is always given."""
    begun = time.perf_counter()
    for block in blocks:
        yield block
        if time.perf_counter() - begun > budget:
            return
