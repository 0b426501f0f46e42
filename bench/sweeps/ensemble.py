"""Ensembles: many runs of one scene and integrator in one compiled program."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.running.plan import resolution_of
from bench.sweeps.batch import Batch, refuse
from bench.sweeps.variation import find_quantity, runs_with, spec_without
from integrators.contract import Integrator
from integrators.resolutions import Steps, Tolerances, check_end
from problems.spec import SpecError
from problems.system import MechatronicSystem

#: Begins the names of columns with work counts.
WORK = "work_"
#: Message of members that were not run.
OUT_OF_TIME = "The ensemble's time was used up before; raise the budget."


@dataclass(frozen=True)
class Ensemble:
    """Results of an ensemble, with one entry per member in the order of the values.

    Printed names are without the quantities that vary, times in s. ``member`` is the number of
    each, ``vary`` has the values of each quantity by name; ``status`` and ``message`` are as of a
    single run. ``values`` are arrays by name: "t", the time that was reached; values at t_end,
    "q1", "q2" ..., NaN where a run failed; counts, "work_steps" and so on.
    """

    problem: str
    integrator: str
    t_end: float
    member: np.ndarray
    vary: dict[str, np.ndarray]
    status: list[str]
    message: list[str]
    values: dict[str, np.ndarray]
    compile_s: float
    run_s: float

    def columns(self) -> dict[str, np.ndarray]:
        """Return all as a table for pandas."""
        texts = {"status": self.status, "message": self.message}
        return {
            "member": self.member,
            **self.vary,
            **{name: np.array(own, dtype=object) for name, own in texts.items()},
            **self.values,
        }

    def summary(self) -> dict[str, dict[str, float]]:
        """Return "min", "median" and "max" of each end value over the members that are ok."""
        ok, rules = (
            np.array(self.status) == "ok",
            {"min": np.min, "median": np.median, "max": np.max},
        )
        ends = [name for name in self.values if name != "t" and not name.startswith(WORK)]
        return {
            name: {rule: float(of(self.values[name][ok])) for rule, of in rules.items()}
            for name in (ends if ok.any() else ())
        }

    @property
    def work(self) -> dict[str, int]:
        """Counts of work of all members together."""
        return {
            name.removeprefix(WORK): int(column.sum())
            for name, column in self.values.items()
            if name.startswith(WORK)
        }

    @property
    def not_run(self) -> int:
        """Number of members for which the budget was not enough."""
        return self.message.count(OUT_OF_TIME)


def joined(parts: Sequence[Ensemble]) -> Ensemble:
    """Return the members of several parts of an ensemble, one part after the other."""

    def table(name: str) -> dict[str, np.ndarray]:
        tables = [getattr(part, name) for part in parts]
        return {key: np.concatenate([own[key] for own in tables]) for key in tables[0]}

    return replace(
        parts[0],
        member=np.concatenate([part.member for part in parts]),
        vary=table("vary"),
        status=[status for part in parts for status in part.status],
        message=[message for part in parts for message in part.message],
        values=table("values"),
        compile_s=sum(part.compile_s for part in parts),
        run_s=sum(part.run_s for part in parts),
    )


def ensemble(
    scene: MechatronicSystem,
    method: Integrator,
    vary: Mapping[str, Sequence[float] | np.ndarray],
    resolution: Steps | Tolerances | None = None,
    t_end: float | None = None,
    budget: float = float("inf"),
    begun: Callable[[], None] = lambda: None,
    first: int = 0,
) -> Ensemble:
    """Run the members of an ensemble.

    Parameters
    ----------
    scene, method, resolution
        All that does not vary is taken from them; the scene's nominal step or rtol=1e-6 if there is
        no resolution.
    vary
        Values by name, equally many for every name; one member each. Names are those of
        `bench.sweeps.variation.find_quantity`.
    t_end
        End time in s; the scene's own if not given.
    budget
        Seconds after which no further members are begun; compiling is not counted.
    begun
        Called when everything is compiled.
    first
        Number of the first member.

    Raises
    ------
    SpecError
        If a name or a value is not allowed, or the integrator cannot run many members as one
        program. A member that fails has its status and message, and does not stop the others.
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
    fixed = resolution or resolution_of(scene, method)
    batch = Batch(runs_with(scene, method, fixed, quantities), end)
    count = shape[0]
    status, message = ["budget_exceeded"] * count, [OUT_OF_TIME] * count
    t, ends, work = np.full(count, scene.interval[0]), {}, {}
    for block in batch.blocks(budget=budget, begun=begun):
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
        first + np.arange(count),
        values,
        status,
        message,
        {"t": t, **ends, **work},
        compiled - started,
        done - compiled,
    )
