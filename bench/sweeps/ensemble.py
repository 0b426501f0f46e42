"""Ensembles: many runs of one scene and integrator in one compiled program."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.sweeps.batch import Batch, refuse
from bench.sweeps.variation import default_resolution, find_quantity, runs_with, spec_without
from integrators.contract import Integrator
from integrators.resolutions import Steps, Tolerances, check_end
from problems.spec import SpecError
from problems.system import MechatronicSystem

#: Begins the names of columns with work counts.
WORK = "work_"
_OUT_OF_TIME = "The ensemble's time was used up before; raise the budget."


@dataclass(frozen=True)
class Ensemble:
    """Results of an ensemble, with one entry per member in the order of the values.

    Attributes
    ----------
    problem, integrator
        Printed names, without the quantities that vary.
    t_end
        End time in s.
    vary
        The values of each quantity that varies, by name.
    status, message
        As of a single run.
    values
        Arrays by name: "t", the time that was reached, in s; values at t_end, "q1", "q2" ..., NaN
        where a run failed; counts, "work_steps" and so on.
    compile_s, run_s
        Seconds for preparing and for running.
    """

    problem: str
    integrator: str
    t_end: float
    # Types without shapes, as they are read where an ensemble comes from another process.
    vary: dict[str, np.ndarray]
    status: list[str]
    message: list[str]
    values: dict[str, np.ndarray]
    compile_s: float
    run_s: float

    def columns(self, first: int = 0) -> dict[str, np.ndarray]:
        """Return all as a table for pandas, with the number of each member from ``first`` on."""
        return {
            "member": first + np.arange(len(self.status)),
            **self.vary,
            "status": np.array(self.status),
            "message": np.array(self.message),
            **self.values,
        }

    @property
    def whole(self) -> bool:
        """Whether the budget was enough to run all members."""
        return _OUT_OF_TIME not in self.message


def member_rows(columns: Mapping[str, np.ndarray]) -> list[dict[str, Any]]:
    """Return a row per entry of the columns; None stands for what is not finite."""
    lists = []
    for column in columns.values():
        values = column.astype(object)
        if column.dtype.kind == "f":
            values[~np.isfinite(column)] = None
        lists.append(values.tolist())
    return [dict(zip(columns, row, strict=True)) for row in zip(*lists, strict=True)]


def spread(values: np.ndarray) -> dict[str, float]:
    """Return the least, median and largest of some numbers."""
    return {
        "min": float(values.min()),
        "median": float(np.median(values)),
        "max": float(values.max()),
    }


def ensemble(
    scene: MechatronicSystem,
    method: Integrator,
    vary: Mapping[str, Sequence[float] | np.ndarray],
    resolution: Steps | Tolerances | None = None,
    t_end: float | None = None,
    budget: float = float("inf"),
    jobs: int | None = None,
    begun: Callable[[], None] = lambda: None,
) -> Ensemble:
    """Run the members of an ensemble.

    Parameters
    ----------
    scene, method
        Parameters and options that do not vary are taken from them.
    vary
        Values by name, equally many for every name; one member each. Names are ``h`` for the step
        in s, ``rtol`` or ``atol`` of a method that chooses its steps, a float parameter of the
        scene, or a float option of the integrator; ``step.h``, ``scene.NAME``, ``integrator.NAME``
        where a name stands for two things.
    resolution
        The step or the tolerances, as far as they do not vary; the scene's nominal step or
        rtol=1e-6 if not given.
    t_end
        End time in s; the scene's own if not given.
    budget
        Seconds after which no further members are begun; compiling is not counted.
    jobs
        Threads; one per processor if not given.
    begun
        Called when everything is compiled.

    Returns
    -------
    Ensemble
        A member that failed has its status and message there, and does not stop the others.

    Raises
    ------
    SpecError
        If a name or a value is not allowed, or the integrator cannot run many members as one
        program.
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
    quantities = {find_quantity(name, scene, method): v for name, v in values.items()}
    fixed = resolution or default_resolution(scene, method)
    batch = Batch(runs_with(scene, method, fixed, quantities), end)
    count = shape[0]
    status, message = ["budget_exceeded"] * count, [_OUT_OF_TIME] * count
    t, ends, work = np.full(count, scene.interval[0]), {}, {}
    for block in batch.blocks(jobs, budget, begun):
        for k, *ending in zip(block.members, block.status, block.message, strict=True):
            status[k], message[k] = ending
        t[block.members] = block.t_last
        for group, rows in block.values.items():
            for i, column in enumerate(rows[:, -1].T, 1):
                ends.setdefault(f"{group}{i}", np.full(count, np.nan))[block.members] = column
        for name, counts in zip(batch.counts, block.counts.T, strict=False):
            column = work.setdefault(f"{WORK}{name}", np.zeros(count, dtype=np.int64))
            column[block.members] = counts
    compiled, done = batch.compiled_at, time.perf_counter()
    return Ensemble(
        spec_without(scene, quantities),
        spec_without(method, quantities),
        end,
        values,
        status,
        message,
        {"t": t, **ends, **work},
        compiled - started,
        done - compiled,
    )
