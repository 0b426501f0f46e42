"""Members of ensembles: the same bits whoever runs them, and tables of those that were run."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from bench.plugins.registry import Registry, Sources
from bench.running.cluster import ClusterRunner
from bench.running.process import NoAnswer
from bench.running.progress import Progress
from bench.running.worker import Worker
from bench.sweeps import ensemble as members
from bench.sweeps.ensemble import EnsembleRequest, ensemble, parts_of, run_members
from bench.sweeps.variation import Quantity, Range, find_range
from integrators import Steps
from problems.base.spec import SpecError

REGISTRY = Registry()
COUNT, VARY, END = 40, ("k:0.8..1.2", "h:0.05..2.5"), 100.0
DIED = NoAnswer(status="crashed", message="The process died.")


class Here:
    """A runner in this process; the last part is answered first."""

    progress = Progress()

    def __init__(self, *faults):
        self.faults, self.sizes = list(faults), []

    def run(self, groups):
        self.sizes = [len(group) for group in groups]
        for task in [task for group in groups for task in group][::-1]:
            fault = self.faults.pop(0) if self.faults else None
            yield task, fault or task.job(Worker(REGISTRY), *task.arguments)


@pytest.fixture
def asked(monkeypatch):
    monkeypatch.setattr(members, "_OF_PART", 16)
    given = dict.fromkeys(("step", "pattern", "rtol", "atol"))
    # Undamped and explicit: some of the steps are too large, and their members diverge.
    runs = "spring_mass[b=0]", "newmark[beta=0]", given, END
    return EnsembleRequest(*runs, COUNT, VARY, 7)


def drawn(ranges, seed, first, count):
    """The values of the ``first`` members and of those that follow."""
    of = enumerate(ranges.items())
    return {name: one.draw(seed, place, first, count) for place, (name, one) in of}


def run_all(request, *faults):
    return run_members(Here(*faults), request, Sources())


def test_a_member_has_its_values_however_members_are_divided():
    scene, method = REGISTRY.problem("spring_mass"), REGISTRY.integrator("newmark")
    ranges = {n: find_range(n, scene, method, r) for n, r in {"k": (1, 2), "h": (1e-3, 1)}.items()}
    together = drawn(ranges, 2**70, 0, 1000)
    firsts = [0, 1, 3, 4, 10, 517, 998, 1000]
    for name, values in together.items():
        pieces = [
            drawn(ranges, 2**70, first, after - first)[name] for first, after in pairwise(firsts)
        ]
        assert (np.concatenate(pieces) == values).all()
        low, high = ranges[name].low, ranges[name].high
        part = np.log(values / low) / np.log(high / low) if name == "h" else (values - low)
        # Evenly spread: each tenth of the range has about a tenth of the values.
        assert np.histogram(part, np.linspace(0, 1, 11))[0] == pytest.approx(100, abs=40)
    assert abs(np.corrcoef(together["k"], together["h"])[0, 1]) < 0.1
    of = Range(Quantity("k", "scene", "k"), 0.0, 1.0)
    assert (of.draw(1, 0, 0, 9) != of.draw(2, 0, 0, 9)).all()
    assert (of.draw(5, 1, 0, 9) != of.draw(5 + 2**32, 0, 0, 9)).all()


def test_parts_in_any_order_are_the_ensemble_in_one_program(asked):
    found, fault = run_all(asked)
    scene, method = REGISTRY.problem("spring_mass[b=0]"), REGISTRY.integrator("newmark[beta=0]")
    ranges = {
        "k": find_range("k", scene, method, (0.8, 1.2)),
        "h": find_range("h", scene, method, (0.05, 2.5)),
    }
    wanted = ensemble(scene, method, drawn(ranges, 7, 0, COUNT), Steps(0.1), END)
    assert fault == ""
    assert (found.problem, found.integrator) == (wanted.problem, wanted.integrator)
    for name, column in wanted.values.items():
        equal_nan = column.dtype.kind == "f"
        assert np.array_equal(found.values[name], column, equal_nan=equal_nan), name
    assert set(found.status) == {"ok", "diverged"}
    good = np.array(found.status) == "ok"
    assert list(found.summary()) == ["q1", "v1", "a1", "x1", "xdot1", "y1", "y2"]
    assert found.summary()["q1"]["max"] == wanted.values["q1"][good].max()
    assert found.work["steps"] == wanted.values["work_steps"].sum()


def test_a_part_that_dies_is_missing_alone_and_the_command_fails(
    asked, tmp_path, monkeypatch, stepbench
):
    found, fault = run_all(asked, None, DIED)
    assert fault.endswith("members 13 to 25: The process died.")
    assert found.values["member"].tolist() == [*range(13), *range(26, 40)]
    with pytest.raises(SpecError, match="members 26 to 39: The process died"):
        run_all(asked, DIED)  # before any has succeeded
    line = "solve", "spring_mass", "newmark", "--vary", "k:0.8..1.2", "--ensemble", "40"
    monkeypatch.setattr("bench.running.runner.Runner.run", Here(None, DIED).run)
    file = tmp_path / "all.csv"
    result = stepbench(*line, "--step", "0.1", "-o", file)
    assert result.exit_code == 1
    output = " ".join(result.output.split())
    assert "Not complete: 13 of 40 members are missing" in output
    assert "The process died" in output
    assert len(file.read_text().splitlines()) == 1 + 27


def test_a_cluster_gets_parts_in_groups_that_all_its_threads_share_and_a_gpu_large_ones(
    asked, monkeypatch
):
    assert parts_of(COUNT) == [(0, 13), (13, 13), (26, 14)]
    monkeypatch.setenv("JAX_PLATFORMS", "cuda")
    assert parts_of(100_000) == [(0, 50_000), (50_000, 50_000)]
    pair = SimpleNamespace(_client=SimpleNamespace(nthreads=lambda: {"a": 1, "b": 1}))
    for count, together in (1, 1), (15, 1), (16, 2), (1000, 16):
        assert ClusterRunner.together(pair, count) == together


def test_a_file_holds_the_members_and_what_is_not_finite_is_no_value(asked, tmp_path):
    found, file = run_all(asked)[0], tmp_path / "members.csv"
    found.values["q1"][:2] = np.inf, np.nan
    found.write(file)
    table = pd.read_csv(file)
    assert table["member"].tolist() == list(range(COUNT))
    for name, column in found.values.items():
        if column.dtype.kind == "f":
            good = np.isfinite(column)
            assert table[name].notna().tolist() == good.tolist()
            assert table[name][good].tolist() == pytest.approx(column[good].tolist(), rel=1e-15)
        else:
            assert table[name].fillna("").tolist() == column.tolist()


# ---- the command -------------------------------------------------------------------------
LINE = ("solve", "spring_mass", "generalized_alpha", "--t-end", "50", "--step", "0.1")
LONG = (*LINE, "--vary", "k:0.8..1.2", "--vary", "b:0.1..0.2", "--ensemble", "10000")


def started(*arguments):
    command = [str(Path(sys.executable).with_name("stepbench")), *map(str, arguments)]
    return subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


@pytest.mark.long
def test_a_cluster_gives_the_bits_of_this_machine(tmp_path):
    distributed = pytest.importorskip("distributed")
    files = [tmp_path / name for name in ("here.csv", "there.csv")]
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        for file, more in zip(files, ((), ("--cluster", cluster.scheduler_address)), strict=True):
            process = started(*LONG, *more, "-o", file)
            said, errors = process.communicate(timeout=300)
            assert process.returncode == 0, errors
            assert "10000 ok" in said
    assert files[0].read_bytes() == files[1].read_bytes()
    assert sorted(tmp_path.iterdir()) == files


@pytest.mark.long
def test_a_command_that_is_ended_leaves_no_file(tmp_path):
    process = started(*LONG[:-1], "100000", "-o", tmp_path / "members.csv")
    while not re.search("members: [1-9]", line := process.stderr.readline()):
        assert line, process.communicate()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "of 100000 members had been run; none is kept." in errors
    assert not list(tmp_path.iterdir())
