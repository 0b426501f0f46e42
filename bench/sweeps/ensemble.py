"""Ensembles: many runs of one scene and integrator in one compiled program, and tables of them.

Members are run in parts by a worker process or a cluster. How they are divided depends on their
number and the kind of device alone, and a member's values on its own number: whoever runs a part
gives the same bits, on processors of the same kind with the same libraries.
"""

from __future__ import annotations

import io
import itertools
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from bench.plugins.registry import Sources
from bench.results.flat_rows import csv_text
from bench.running.cluster import ClusterRunner
from bench.running.interrupts import remark
from bench.running.plan import resolution_of
from bench.running.process import Refused
from bench.running.runner import Runner, Task
from bench.running.serve import RUNNING
from bench.running.worker import Worker
from bench.sweeps.batch import Batch, refuse
from bench.sweeps.variation import (
    Range,
    SweepRequest,
    find_quantity,
    read_ranges,
    runs_with,
    spec_without,
)
from integrators.contract import Integrator
from integrators.resolutions import Steps, Tolerances, check_end
from problems.base.cache import put
from problems.base.spec import SpecError
from problems.system import MechatronicSystem

#: Begins the names of columns with work counts.
WORK = "work_"
#: Message of members that were not run.
OUT_OF_TIME = "The ensemble's time was used up before; raise the budget."

#: Most members of a part, which come back, or are lost, together. A GPU needs many.
_OF_PART, _OF_PART_GPU = 1024, 65536
#: Members that are text together.
_ROWS = 1024

Columns = Mapping[str, np.ndarray]


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

    @property
    def not_run(self) -> int:
        """Number of members for which the budget was not enough."""
        return self.message.count(OUT_OF_TIME)


def joined(parts: Sequence[Ensemble]) -> Ensemble:
    """Return the members of several parts of an ensemble, one part after the other."""
    tables = [part.values for part in parts]
    return replace(
        parts[0],
        values={name: np.concatenate([table[name] for table in tables]) for name in tables[0]},
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
    """Run the members of an ensemble, numbered from the ``first`` on.

    ``vary`` has values by name (`bench.sweeps.variation.find_quantity`), equally many for each, one
    for a member; all else is that of scene, method and resolution (the scene's nominal step or
    rtol=1e-6 if None). They end at ``t_end`` (s; the scene's own if None); ``begun`` is called when
    everything is compiled, and ``budget`` seconds later no further members are begun.

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
    status = np.full(count, "budget_exceeded", dtype=object)
    message = np.full(count, OUT_OF_TIME, dtype=object)
    t, ends, work = np.full(count, scene.interval[0]), {}, {}
    for block in batch.blocks(budget=budget, begun=begun):
        status[block.members], message[block.members] = block.status, block.message
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
        {"member": first + np.arange(count), **values}
        | {"status": status, "message": message, "t": t, **ends, **work},
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
    scene, method, ranges, fixed = request.prepared(worker, read_ranges(request.vary, "--vary"))
    draw = partial(Range.draw, seed=request.seed, first=first, count=count)
    return ensemble(
        scene,
        method,
        {name: draw(of, place=place) for place, (name, of) in enumerate(ranges.items())},
        fixed,
        request.t_end,
        request.budget,
        begun=lambda: worker.notify(RUNNING, "running the members"),
        first=first,
    )


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
        If the request is refused, or a part has no answer before another one has.
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
    together = runner.together(len(tasks)) if isinstance(runner, ClusterRunner) else 1
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
        elif isinstance(answer, Refused):
            raise SpecError(answer.message)
        else:
            fault = f"{task.label}: {answer.message}"
            if not parts:
                raise SpecError(fault)
        runner.progress.advance()
    remark("")
    return joined(sorted(parts, key=lambda part: part.values["member"][0])), fault


# ---- files for the user ------------------------------------------------------------------
def check_file_name(path: Path) -> None:
    """Refuse a file that cannot be written, before any work is done for it.

    Raises
    ------
    SpecError
        If the name says no kind of table, or the library for it is missing.
    """
    if path.suffix not in (".csv", ".parquet"):
        raise SpecError(f"{path.name} is no table; give a name that ends in .csv or .parquet.")
    if path.suffix == ".parquet" and not find_spec("pyarrow"):
        raise SpecError(
            "A file .parquet needs pyarrow; install it by: pip install 'stepbench[parquet]'."
        )


def write_members(path: Path, columns: Columns) -> None:
    """Write all members, a flat row each, and put the file in place when it is whole."""
    if path.suffix == ".parquet":
        import pyarrow
        from pyarrow import parquet

        masks = {k: ~np.isfinite(c) for k, c in columns.items() if c.dtype.kind == "f"}
        arrays = {k: pyarrow.array(c, mask=masks.get(k)) for k, c in columns.items()}
        file = io.BytesIO()
        parquet.write_table(pyarrow.table(arrays), file)
        put(path, file.getvalue())
        return
    count = len(columns["member"])
    slices = [slice(k, k + _ROWS) for k in range(0, count, _ROWS)]
    texts = [csv_text(member_rows({k: c[of] for k, c in columns.items()})) for of in slices]
    put(path, "".join([texts[0], *(text.partition("\n")[2] for text in texts[1:])]))


def member_rows(columns: Columns) -> list[dict[str, Any]]:
    """Return a row per entry of the columns; None stands for what is not finite."""
    lists = []
    for column in columns.values():
        values = column.astype(object)
        if column.dtype.kind == "f":
            values[~np.isfinite(column)] = None
        lists.append(values.tolist())
    return [dict(zip(columns, row, strict=True)) for row in zip(*lists, strict=True)]
