"""Members of an ensemble: run in parts by a worker process or a cluster, and tables of them.

How members are divided depends on their number and the kind of device alone, and a member's values
on its own number: whoever runs a part gives the same bits, on processors of the same kind with the
same libraries.
"""

from __future__ import annotations

import io
import itertools
import os
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from bench.guard.interrupts import remark
from bench.guard.process import Refused
from bench.plugins.registry import Sources
from bench.results.csv_text import csv_export
from bench.running.cluster import ClusterRunner
from bench.running.runner import Runner, Task
from bench.sweeps.ensemble import Ensemble, joined
from bench.sweeps.jobs import EnsembleRequest, members_job
from problems.spec import SpecError
from problems.whole_files import put

#: Most members of a part, which come back, or are lost, together. A GPU needs many.
_OF_PART, _OF_PART_GPU = 1024, 65536
#: Members that are text together.
_ROWS = 1024

Columns = Mapping[str, np.ndarray]


def parts_of(count: int) -> list[tuple[int, int]]:
    """Return the number of the first member of each part, and of its members."""
    most = _OF_PART if os.environ.get("JAX_PLATFORMS", "cpu") == "cpu" else _OF_PART_GPU
    parts = -(-count // most)
    firsts = [k * count // parts for k in range(parts + 1)]
    return [(a, b - a) for a, b in itertools.pairwise(firsts)]


def run_members(runner: Runner, request: EnsembleRequest, sources: Sources) -> tuple[Ensemble, str]:
    """Run all members of an ensemble.

    Parameters
    ----------
    runner
        Runs the parts; a worker of a cluster gets several of them at a time.
    request, sources
        What is run.

    Returns
    -------
    tuple
        The members, without those of parts that have no answer; and the reason of one of these.

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
    return joined(sorted(parts, key=lambda part: part.member[0])), fault


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
    texts = [csv_export(member_rows({k: c[of] for k, c in columns.items()})) for of in slices]
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
