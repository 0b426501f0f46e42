"""Processes that are killed or halted at random moments: nothing is left, and one cell is lost."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from busy_methods import BUSY
from processes import Started, end_all, promised_seconds

attack = pytest.mark.attack
KILL, STOP, CONT = signal.SIGKILL, signal.SIGSTOP, signal.SIGCONT
PROFILE = """
samples = 2
[[study]]
problems = ["oscillator"]
integrators = ["newmark", "busy[how={how}]"]
steps = [0.1, 0.05]
"""
CELLS = 4
RUN = ("run", "busy.toml", "--plugins", "busy.py", "--out", "out")
HOWS = ("locks_in_turns", "spins", "child")
#: The kill that the long tests try, without the second run.
QUICK = ("worker", "locks_in_turns")
#: In s.
LONG_HALT = 12.0


@pytest.fixture
def folder(tmp_path) -> Iterator[Path]:
    shutil.copy(Path(__file__).with_name("busy_methods.py"), tmp_path / "busy.py")
    write_profile(tmp_path, "well")
    yield tmp_path
    end_all()


def write_profile(folder: Path, how: str) -> None:
    (folder / "busy.toml").write_text(PROFILE.format(how=how))


def held(folder: Path, how: str, *more: str) -> tuple[Started, int]:
    """A run with a method that does its worst, and the worker in which it is."""
    write_profile(folder, how)
    (folder / "HOLD").touch()
    process, told = Started(folder, *RUN, *more), folder / "HELD"
    process.wait_for(lambda: told.exists() and told.read_text())
    if how == "child":
        process.wait_for(lambda: busy_children(process))
    time.sleep(random.Random(how).uniform(0, 0.5))
    return process, int(told.read_text())


def busy_children(process: Started) -> list[int]:
    lines = {p: Path(f"/proc/{p}/cmdline") for p in process.family()}
    return [p for p, line in lines.items() if line.exists() and BUSY.encode() in line.read_bytes()]


def check_goes_on(folder: Path, measured: int) -> None:
    """The same command measures so many cells again, and no others."""
    again = Started(folder, *RUN)
    assert again.finish() == 0, again.said
    assert f"{CELLS} ok" in again.said
    assert f"{measured} measured now, {CELLS - measured} kept from before" in again.said


# ---- kill -9 of the command --------------------------------------------------------------------
@attack
@pytest.mark.parametrize("how", HOWS)
def test_a_killed_command_leaves_nothing_and_goes_on(folder, how):
    process, _ = held(folder, how)
    os.kill(process.pid, KILL)
    process.process.wait(promised_seconds())
    process.check_nothing_left()
    shown = Started(folder, "report", "out", "--json", "-o", "rows.json")
    assert shown.finish() == 0, shown.said
    check_goes_on(folder, CELLS - len(json.loads((folder / "rows.json").read_text())))


# ---- kill -9 of what it started ------------------------------------------------------------------
@pytest.mark.parametrize(
    ("role", "how"),
    [
        pytest.param(*QUICK, marks=pytest.mark.long),
        *(
            pytest.param(role, how, marks=attack)
            for role, how in (("worker", "spins"), ("worker", "child"), ("terminated", "child"))
        ),
    ],
)
def test_a_killed_worker_costs_one_cell(folder, role, how):
    process, worker = held(folder, how)
    before = busy_children(process)
    os.kill(worker, signal.SIGTERM if role == "terminated" else KILL)
    late = time.monotonic() + promised_seconds()
    while set(before) & set(process.family()):
        assert time.monotonic() < late, "what the worker started is left"
        time.sleep(0.02)
    assert process.finish() == 1, process.said
    assert f"{CELLS - 1} ok" in process.said
    assert "Not complete: 1 run interrupted" in process.said
    if (role, how) != QUICK:
        check_goes_on(folder, 1)


@attack
@pytest.mark.parametrize("name", ["map", "stability"])
def test_a_command_whose_worker_is_killed_says_so(folder, name):
    from test_signals import ENDLESS

    process = Started(folder, *ENDLESS[name].split())
    process.wait_for(lambda: process.family("worker"))
    time.sleep(random.Random(name).uniform(0, 3))
    os.kill(process.family("worker")[0], KILL)
    assert process.finish() == 1, process.said
    assert "killed from outside" in process.said


@attack
@pytest.mark.parametrize("number", [KILL, signal.SIGINT])
def test_workers_of_a_cluster_stop_when_the_command_has_ended(folder, number):
    distributed = pytest.importorskip("distributed")
    write_profile(folder, "spins")
    (folder / "HOLD").touch()
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        process = Started(folder, *RUN, "--cluster", cluster.scheduler_address)
        process.wait_for(lambda: (folder / "HELD").exists() and (folder / "HELD").read_text())
        worker = psutil.Process(int((folder / "HELD").read_text()))
        process.process.send_signal(number)
        process.process.wait(promised_seconds())
        assert "Traceback" not in process.said
        worker.wait(2 * promised_seconds())
        process.check_nothing_left()


# ---- halts and load ------------------------------------------------------------------------------
@attack
@pytest.mark.parametrize("who", ["worker", "command"])
def test_a_halt_changes_no_verdict(folder, who):
    process, worker = held(folder, "well", "--budget", "1")
    stopped = worker if who == "worker" else process.pid
    os.kill(stopped, STOP)
    time.sleep(LONG_HALT)
    os.kill(stopped, CONT)
    (folder / "HELD").unlink()
    assert process.finish() == 0, process.said
    assert f"{CELLS} ok" in process.said


@attack
def test_a_busy_machine_changes_no_verdict(folder):
    write_profile(folder, "computes")
    others = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(6)]
    try:
        process = Started(folder, *RUN, "--budget", "1")
        assert process.finish() == 0, process.said
    finally:
        for other in others:
            other.kill()
            other.wait()
    assert f"{CELLS} ok" in process.said
