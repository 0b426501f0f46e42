"""Ensembles in shards: the same bits whoever runs them, and nothing lost that is finished."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import psutil
import pytest

from bench.guard.process import NoAnswer
from bench.plugins.facts import Sources
from bench.plugins.registry import Registry
from bench.running.worker import Worker
from bench.sweeps import jobs, parts
from bench.sweeps.ensemble import ensemble
from bench.sweeps.jobs import EnsembleRequest
from bench.sweeps.parts import EnsembleResults, KeptParts, TemporaryParts
from bench.sweeps.shards import ShardRun
from bench.sweeps.variation import drawn, find_range
from integrators import Steps
from problems.spec import SpecError

REGISTRY = Registry()
COUNT, VARY, END = 40, ("k:0.8..1.2", "h:0.05..2.5"), 100.0
KILLED = NoAnswer(status="interrupted", message="It was killed.")


class Quiet:
    """A progress that nobody sees."""

    def __getattr__(self, name):
        return lambda *_: None


class Here:
    """A runner in this process; the last group is answered first."""

    def __init__(self, faults=()):
        self.faults, self.asked, self.sizes = list(faults), [], []

    def run(self, groups):
        self.sizes.append([len(group) for group in groups])
        for task in [task for group in groups for task in group][::-1]:
            if task.job is jobs.shard_job:
                self.asked.append(task.arguments[1])
                if self.faults:
                    fault = self.faults.pop(0)
                    if fault:
                        yield task, fault
                        continue
            yield task, task.job(Worker(REGISTRY), *task.arguments)


@pytest.fixture
def asked(monkeypatch):
    monkeypatch.setattr(jobs, "_OF_SHARD", {"cpu": 16})
    given = dict.fromkeys(("step", "pattern", "rtol", "atol"))
    # Undamped and explicit: some of the steps are too large, and their members diverge.
    runs = "spring_mass[b=0]", "newmark[beta=0]", given, END, 1e9
    return EnsembleRequest(*runs, COUNT, VARY, 7)


def run_all(request, store, runner=None):
    runner = runner or Here()
    run = ShardRun(runner, request, Sources(), Quiet())
    run.complete(runner, store, 1)
    return run, EnsembleResults((store, run.lost), run.plan.shards, run.plan.ranges)


def whole(results):
    tables = list(results.parts())
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


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
    assert (drawn(ranges, 1, 0, 9)["k"] != drawn(ranges, 2, 0, 9)["k"]).all()


def test_shards_in_any_order_are_the_ensemble_in_one_process(asked):
    run, results = run_all(asked, TemporaryParts())
    assert run.plan.shards == 3
    assert run.members == COUNT
    scene = REGISTRY.problem("spring_mass[b=0]")
    values = drawn(run.plan.ranges, 7, 0, COUNT)
    found = ensemble(scene, REGISTRY.integrator("newmark[beta=0]"), values, Steps(0.1), END)
    table = whole(results)
    for name, column in found.columns().items():
        assert (table[name] == column).all() or np.array_equal(table[name], column, equal_nan=True)
    good = np.array(found.status) == "ok"
    assert list(results.summary()) == ["q1", "v1", "a1", "x1", "xdot1", "y1", "y2"]
    assert results.summary()["q1"]["max"] == found.values["q1"][good].max()
    assert results.statuses == Counter(found.status)
    assert set(results.statuses) == {"ok", "diverged"}
    counts = {n.removeprefix("work_"): c for n, c in found.values.items() if n[:5] == "work_"}
    assert results.work == {name: column.sum() for name, column in counts.items()}
    first = found.status.index("diverged")
    assert results.first["diverged"] == (first, found.message[first])


def test_summaries_hold_a_few_columns_at_a_time(asked, monkeypatch):
    _, results = run_all(asked, TemporaryParts())
    together = results.summary()
    monkeypatch.setattr(parts, "_MOST_BYTES", 1)
    assert results.summary() == together


def test_a_shard_that_is_killed_is_run_again_and_one_that_dies_is_lost_alone(asked):
    dies = NoAnswer(status="crashed", message="The process died.")
    runner = Here([None, KILLED, dies])
    run, results = run_all(asked, TemporaryParts(), runner)
    assert runner.asked == [26, 13, 0, 13]
    assert run.lost.numbers() == {0}
    assert results.statuses["crashed"] == 13
    assert results.first["crashed"] == (0, "The process died.")
    table = whole(results)
    assert table["member"].tolist() == list(range(COUNT))
    assert (table["k"] == drawn(run.plan.ranges, 7, 0, COUNT)["k"]).all()
    assert np.isnan(table["q1"][:13]).all()
    assert (table["work_steps"][:13] == 0).all()
    with pytest.raises(SpecError, match="It was killed"):
        run_all(asked, TemporaryParts(), Here([None, None, *3 * [KILLED]]))
    run, _ = run_all(asked, TemporaryParts(), Here([dies]))  # before any has succeeded
    assert (run.lost.numbers(), run.members) == ({2}, 26)
    with pytest.raises(SpecError, match="The process died"):
        run_all(asked, TemporaryParts(), Here(3 * [dies]))


def test_another_call_runs_what_is_missing(asked, tmp_path):
    folder = tmp_path / "members.csv.parts"
    about = {"seed": 7}
    with pytest.raises(SpecError, match="It was killed"):
        run_all(asked, KeptParts(folder, about), Here([None, None, *3 * [KILLED]]))
    with np.load(folder / "part-000002.npz") as readable:
        assert readable["member"].tolist() == list(range(26, 40))
    with pytest.raises(SpecError, match="holds members of another ensemble"):
        KeptParts(folder, {"seed": 8})
    (folder / "part-000001.npz").write_bytes(b"")  # a power cut
    runner, kept = Here(), KeptParts(folder, about)
    _, results = run_all(asked, kept, runner)
    assert runner.asked == [13, 0]
    _, fresh = run_all(asked, TemporaryParts())
    again, before = whole(results), whole(fresh)
    assert all(np.array_equal(again[n], before[n], equal_nan=n[0] in "qvaxy") for n in before)
    kept.remove()
    assert not folder.exists()


# ---- the command -------------------------------------------------------------------------
LINE = ("solve", "spring_mass", "generalized_alpha", "--t-end", "50", "--step", "0.1")
LONG = (*LINE, "--vary", "k:0.8..1.2", "--vary", "b:0.1..0.2", "--ensemble", "10000")


def started(*arguments, **more):
    command = [str(Path(sys.executable).with_name("stepbench")), *map(str, arguments)]
    return subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def finished(*arguments):
    process = started(*arguments)
    said, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    return said


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The members of one process."""
    file = tmp_path_factory.mktemp("alone") / "members.csv"
    assert "10000 ok" in finished(*LONG, "--jobs", 1, "-o", file)
    return file.read_bytes()


@pytest.mark.long
def test_a_cluster_that_loses_a_worker_gives_the_bits_of_one_process(alone, tmp_path):
    distributed = pytest.importorskip("distributed")
    file = tmp_path / "members.csv"
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        process = started(*LONG, "--cluster", cluster.scheduler_address, "-o", file)
        some = tmp_path / "members.csv.parts"
        while not list(some.glob("part-*.npz")):
            assert process.poll() is None, process.communicate()
            time.sleep(0.02)
        killed = next(iter(cluster.workers.values())).pid
        os.kill(killed, signal.SIGKILL)
        said, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    assert "10000 ok" in said
    assert file.read_bytes() == alone
    assert not some.exists()


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_command_that_is_ended_goes_on(alone, tmp_path, number):
    file, some = tmp_path / "members.csv", tmp_path / "members.csv.parts"
    process = started(*LONG, "-o", file)
    while len(list(some.glob("part-*.npz"))) < 2:
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == (130 if number == signal.SIGINT else -9)
    if number == signal.SIGINT:
        assert "Finished members are stored; the same command goes on." in errors
    before = {path.name: path.stat().st_mtime_ns for path in some.glob("part-*.npz")}
    assert 2 <= len(before) < 10
    for name in before:
        with np.load(some / name) as part:
            assert (part["status"] == "ok").all()
    missing = sum(len(np.load(some / name)["k"]) for name in before)
    said = " ".join(finished(*LONG, "-o", file).split())
    assert f"{10_000 - missing} members run now" in said
    assert file.read_bytes() == alone


@pytest.mark.long
def test_a_worker_that_is_killed_costs_nothing(alone, tmp_path):
    file, some = tmp_path / "members.csv", tmp_path / "members.csv.parts"
    process = started(*LONG, "-o", file)
    while not list(some.glob("part-*.npz")):
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    family = psutil.Process(process.pid).children(recursive=True)
    workers = [p for p in family if "serve(int" in " ".join(p.cmdline())]
    workers[-1].kill()
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    assert file.read_bytes() == alone


@pytest.mark.long
def test_the_command_takes_as_much_memory_for_many_members(tmp_path):
    def peak(count):
        line = [*LONG[:-1], count, "-o", tmp_path / f"{count}.parquet"]
        process, most = started(*line), [0]

        def watch():
            while process.poll() is None:
                most[0] = max(most[0], _resident(process.pid))
                time.sleep(0.02)

        watcher = threading.Thread(target=watch)
        watcher.start()
        _, errors = process.communicate(timeout=600)
        watcher.join()
        assert process.returncode == 0, errors
        return most[0]

    few, many = peak(2_000), peak(40_000)
    # 38 000 members have 38 000 x 20 columns x 8 bytes = 6 MB; a row of Python takes 2 kB.
    assert many < few + 2**25


def _resident(process):
    try:
        return psutil.Process(process).memory_info().rss
    except psutil.Error:
        return 0


def test_a_table_with_lost_members_is_written_and_the_command_fails(
    asked, tmp_path, monkeypatch, stepbench
):
    dies = NoAnswer(status="crashed", message="The process died.")

    def _run(*_):
        parts = TemporaryParts()
        return run_all(asked, parts, Here([None, dies]))[0], parts

    monkeypatch.setattr("bench.commands.sweeps._run", _run)
    given = ("--vary", "k:0.8..1.2", "--ensemble", "40", "--step", "0.1")
    result = stepbench("solve", "spring_mass", "newmark", *given, "-o", tmp_path / "all.csv")
    assert result.exit_code == 1
    assert "Not complete: 1 of 3 shards were lost; the same command" in result.output
    assert len((tmp_path / "all.csv").read_text().splitlines()) == 41
