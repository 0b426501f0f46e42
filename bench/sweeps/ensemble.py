"""Ensembles: many runs of one scene and integrator in one compiled program, and tables of them.

Members are run in parts by a worker process or a cluster. How they are divided depends on their
number and the kind of device alone, and a member's values on its own number: whoever runs a part
gives the same bits, on processors of the same kind with the same libraries.
"""

from __future__ import annotations

import csv
import io
import itertools
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from bench.plugins.registry import Sources
from bench.running.interrupts import remark
from bench.running.process import RUNNING
from bench.running.runner import Runner, Task
from bench.running.worker import Worker
from bench.sweeps.batch import Batch
from bench.sweeps.variation import Quantity, SweepRequest, read_ranges, runs_with, spec_without
from integrators.contract import Integrator
from integrators.resolutions import Steps, Tolerances
from problems.base.cache import put
from problems.base.spec import SpecError
from problems.system import MechatronicSystem

#: Begins the names of columns with work counts.
WORK = "work_"
#: Most members of a part, which come back, or are lost, together. A GPU needs many.
_OF_PART, _OF_PART_GPU = 1024, 65536
#: Members that are text together.
_ROWS = 1024


@dataclass(frozen=True)
class Ensemble:
    """Results of an ensemble, with one entry per member in the order of the values.

    Printed names are without the quantities that vary, times in s. ``values`` are columns by name,
    as for pandas: "member", its number; the quantities that vary; "status" and "message", as of a
    single run; "t", the time that was reached; values at t_end, "q1", "q2" ..., NaN where a run
    failed; counts, "work_steps" and so on.
    """

    problem: str
    integrator: str
    t_end: float
    values: dict[str, np.ndarray]
    compile_s: float
    run_s: float

    @property
    def status(self) -> list[str]:
        """How each member ended."""
        return self.values["status"].tolist()

    @property
    def message(self) -> list[str]:
        """The reason of each member that failed."""
        return self.values["message"].tolist()

    def summary(self) -> dict[str, dict[str, float]]:
        """Return "min", "median" and "max" of each end value over the members that are ok."""
        rules, names = {"min": np.min, "median": np.median, "max": np.max}, list(self.values)
        ends = [n for n in names[names.index("t") + 1 :] if not n.startswith(WORK)]
        ok = self.values["status"] == "ok"
        return {
            name: {rule: float(of(self.values[name][ok])) for rule, of in rules.items()}
            for name in (ends if ok.any() else ())
        }

    @property
    def work(self) -> dict[str, int]:
        """Counts of work of all members together."""
        counts = {k: column for k, column in self.values.items() if k.startswith(WORK)}
        return {name.removeprefix(WORK): int(column.sum()) for name, column in counts.items()}

    def write(self, path: Path) -> None:
        """Write all members, a row each, as comma-separated values; what is not finite is empty."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.values)
        for k in range(0, len(self.status), _ROWS):
            lists = [_cells(column[k : k + _ROWS]) for column in self.values.values()]
            writer.writerows(zip(*lists, strict=True))
        put(path, text.getvalue())


def _cells(column: np.ndarray) -> list[object]:
    """The values of a column; None where one is not finite."""
    cells = column.astype(object)
    if column.dtype.kind == "f":
        cells[~np.isfinite(column)] = None
    return cells.tolist()


def ensemble(
    scene: MechatronicSystem,
    method: Integrator,
    values: Mapping[Quantity, np.ndarray],
    resolution: Steps | Tolerances,
    end: float,
    begun: Callable[[], None] = lambda: None,
    first: int = 0,
) -> Ensemble:
    """Run the members of an ensemble up to ``end`` (s), numbered from the ``first`` on.

    ``values`` are equally many for each quantity, one for a member; all else is that of scene,
    method and resolution. ``begun`` is called when everything is compiled. A member that fails has
    its status and message, and does not stop the others.

    Raises
    ------
    SpecError
        If a value is not allowed, or members need different programs.
    """
    started = time.perf_counter()
    batch = Batch(runs_with(scene, method, resolution, values), end)
    count = len(next(iter(values.values())))
    told = {name: np.empty(count, dtype=object) for name in ("status", "message")}
    told["t"], ends, work = np.full(count, scene.interval[0]), {}, {}
    for block in batch.blocks(begun=begun):
        for name, own in zip(told, (block.status, block.message, block.t_last), strict=True):
            told[name][block.members] = own
        for group, rows in block.values.items():
            for i, column in enumerate(rows.T, 1):
                ends.setdefault(f"{group}{i}", np.full(count, np.nan))[block.members] = column
        for name, counts in zip(batch.counts, block.counts.T, strict=False):
            column = work.setdefault(f"{WORK}{name}", np.zeros(count, dtype=np.int64))
            column[block.members] = counts
    compiled, done = batch.compiled_at, time.perf_counter()
    varied = {quantity.name: column for quantity, column in values.items()}
    return Ensemble(
        spec_without(scene, values),
        spec_without(method, values),
        end,
        {"member": first + np.arange(count), **varied, **told, **ends, **work},
        compiled - started,
        done - compiled,
    )


# ---- jobs --------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class EnsembleRequest(SweepRequest):
    """An ensemble of ``count`` members as the user asked for it; ``vary`` are texts."""

    count: int
    vary: tuple[str, ...]
    seed: int


def members_job(worker: Worker, request: EnsembleRequest, first: int, count: int) -> Ensemble:
    """Run ``count`` members of an ensemble from the ``first`` on."""
    spans = read_ranges(request.vary, "--vary")
    scene, method, ranges, fixed, end = request.prepared(worker, spans)
    values = {
        of.quantity: of.draw(request.seed, place, first, count)
        for place, of in enumerate(ranges.values())
    }
    begun = partial(worker.notify, RUNNING, "running the members")
    return ensemble(scene, method, values, fixed, end, begun, first)


def parts_of(count: int) -> list[tuple[int, int]]:
    """Return the number of the first member of each part, and of its members."""
    most = _OF_PART if os.environ.get("JAX_PLATFORMS", "cpu") == "cpu" else _OF_PART_GPU
    parts = -(-count // most)
    firsts = [k * count // parts for k in range(parts + 1)]
    return [(a, b - a) for a, b in itertools.pairwise(firsts)]


def run_members(runner: Runner, request: EnsembleRequest, sources: Sources) -> tuple[Ensemble, str]:
    """Run all members of an ensemble; a worker of a cluster gets several parts at a time.

    Returns the members, without those of parts that have no answer, and the reason of one of these.

    Raises
    ------
    SpecError
        If a part has no answer before another one has, as where the request is refused.
    """
    about = f"{request.integrator} on {request.problem}"
    tasks = [
        Task(
            members_job,
            (request, first, count),
            f"{about}, members {first} to {first + count - 1}",
            sources=sources,
        )
        for first, count in parts_of(request.count)
    ]
    together = runner.together(len(tasks))
    groups = [tasks[k : k + together] for k in range(0, len(tasks), together)]
    if len(tasks) > 1:
        runner.progress.phase("running members", len(tasks))
    parts: list[Ensemble] = []
    fault, done = "", 0
    for task, answer in runner.run(groups):
        if isinstance(answer, Ensemble):
            parts.append(answer)
            done += len(answer.status)
            remark(f"{done} of {request.count} members had been run; none is kept.")
        else:
            fault = f"{task.label}: {answer.message}"
            if not parts:
                raise SpecError(fault)
        runner.progress.advance()
    remark("")
    parts.sort(key=lambda part: part.values["member"][0])
    columns = {k: np.concatenate([part.values[k] for part in parts]) for k in parts[0].values}
    compile_s, run_s = (sum(getattr(part, n) for part in parts) for n in ("compile_s", "run_s"))
    return replace(parts[0], values=columns, compile_s=compile_s, run_s=run_s), fault
