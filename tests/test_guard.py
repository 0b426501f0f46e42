"""Guarded processes: fates of jobs, budgets, and nothing that is left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable

import guarded_jobs as jobs
import numpy as np
import psutil
import pytest

from bench.running import process as limits
from bench.running.process import (
    LOADING,
    PREPARING,
    RUNNING,
    WAITING,
    GuardedProcess,
    Limits,
    Meter,
    NoAnswer,
    usage,
)

#: Job, arguments, status and words of what it costs.
FATES = [
    (jobs.raises, (), "crashed", "ValueError: so it goes (guarded_jobs.py, line"),
    (jobs.a_function_of_its_own, (), "crashed", "local object"),
    (jobs.exits, (), "crashed", "died while running (exit code 3). Its last words: it said so"),
    (jobs.ends_by, (signal.SIGSEGV,), "crashed", "died while running (SIGSEGV)"),
    (jobs.ends_by, (signal.SIGKILL,), "interrupted", "from outside while running (SIGKILL)"),
    (jobs.computes, (60.0,), "budget_exceeded", "more than 0.5 s of processor time"),
]


@pytest.fixture(scope="module")
def guarded():
    """A function that gives a process, a new one if the last has ended."""
    made: list[GuardedProcess] = []

    def process() -> GuardedProcess:
        if not made or not made[-1].alive:
            made.append(GuardedProcess(jobs.prepare, (10,), Limits(0.5, 0.3)))
        return made[-1]

    yield process
    made[-1].end()


def test_answers_come_back_with_numbers_of_python(guarded):
    assert guarded().ask(jobs.add, 1, two=2) == 13
    array, scalars = guarded().ask(jobs.numbers)
    np.testing.assert_array_equal(array, [[1.0, np.nan], [np.inf, -0.0]], strict=True)
    assert [type(scalar) for scalar in scalars] == [float, int, bool]


def test_a_job_that_fails_has_a_fate_and_the_next_one_an_answer(guarded):
    for job, arguments, status, words in FATES:
        fate = guarded().ask(job, *arguments)
        assert isinstance(fate, NoAnswer), job
        assert (fate.status, fate.phase) == (status, "running"), fate
        assert words in fate.message
        assert guarded().ask(jobs.add, 1) == 11
    refusal = guarded().ask(jobs.refuses)
    assert (refusal.refused, refusal.message) == (True, "No such thing.")


def test_a_job_that_takes_too_much_or_does_nothing_or_is_not_prepared_is_told_so(monkeypatch):
    monkeypatch.setattr(limits, "STILL_SECONDS", 2.0)
    for job, words in (
        (jobs.hoards, "budget of 0.3 GiB; take a smaller scene"),
        (jobs.sleeps, "did nothing for 2 s: it sleeps or waits; so it goes"),
    ):
        fate = GuardedProcess(jobs.prepare, (10,), Limits(60.0, 0.3, advice="so it goes")).ask(job)
        assert fate.status == "budget_exceeded"
        assert words in fate.message
    fate = GuardedProcess(jobs.raises, ()).ask(jobs.add, 1)
    assert fate.phase == LOADING
    assert "while loading this program (exit code 1). Its last words: ValueError" in fate.message


def test_a_phase_has_a_budget_of_its_own(guarded, monkeypatch):
    process, told = guarded(), []
    process.on_phase = lambda *phase: told.append(phase)
    assert process.ask(jobs.computes_a_reference, 0.8) == 1
    assert ("reference", "making the reference of x") in told
    monkeypatch.setattr(limits, "LEAST_SECONDS", 0.2)
    monkeypatch.setattr(limits, "_MORE", 0.1)
    fate = guarded().ask(jobs.computes_a_reference, 60.0)
    assert (fate.status, fate.phase) == ("budget_exceeded", "reference")
    assert fate.message.startswith("Stopped while making the reference of x because")


def test_prints_are_cut_and_shown_as_text(guarded):
    guarded().ask(jobs.prints)
    printed = guarded().printed()
    assert printed.startswith("... xxx")
    assert printed.endswith("\N{REPLACEMENT CHARACTER}[31mlast")
    assert len(printed) < 5000
    guarded().ask(jobs.add, 1)
    assert guarded().printed() == ""


# ---- nothing that is left behind -----------------------------------------------------------
def comes(condition: Callable[[], bool]) -> bool:
    """Whether a condition holds at last."""
    given_up = time.monotonic() + 60
    while not condition() and time.monotonic() < given_up:
        time.sleep(0.01)
    return condition()


def test_all_that_a_process_started_ends_with_it(guarded):
    process = guarded()
    children = process.ask(jobs.starts_children)
    assert all(map(psutil.pid_exists, children))
    process.end()
    assert comes(lambda: not any(map(psutil.pid_exists, [process.pid, *children])))


def test_a_child_that_holds_the_pipe_of_a_dead_process_does_not_hold_its_answer(guarded):
    process = guarded()
    fate = process.ask(jobs.leaves_a_child)
    assert "exit code 4" in fate.message
    child = int(process.printed())
    assert comes(lambda: not psutil.pid_exists(child))


def test_a_process_ends_with_the_program_that_started_it(tmp_path):
    """Though that is killed, and though it computes."""
    code = (
        "import guarded_jobs as jobs, os, signal\n"
        "from bench.running.process import GuardedProcess; "
        "p = GuardedProcess(jobs.prepare, (10,)); print(p.pid, flush=True); "
        "p.on_phase = lambda phase, _: phase == 'running' and os.kill(os.getpid(), 9); "
        "p.ask(jobs.computes, 600.0)"
    )
    path = os.pathsep.join([os.path.dirname(jobs.__file__), *sys.path])
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert comes(lambda: not psutil.pid_exists(int(done.stdout)))


# ---- budgets -------------------------------------------------------------------------------
class Watched:
    """A meter, and time and use of its process as a test wants them."""

    def __init__(self, monkeypatch, within: Limits, phase: str = RUNNING) -> None:
        self.now, self.seconds, self.memory = 0.0, 0.0, 0
        monkeypatch.setattr(limits.time, "monotonic", lambda: self.now)
        monkeypatch.setattr(limits, "usage", lambda process: (self.seconds, self.memory))
        self.meter = Meter(within)
        self.meter.phase = phase

    def pass_by(self, looks: int, computed: float = 0.0, apart: float = 0.5) -> str:
        """Look so many times, some s apart, in each of which it computes; return the excess."""
        for _ in range(looks):
            self.now += apart
            self.seconds += computed
            if excess := self.meter.excess(1):
                return excess
        return ""


def test_a_budget_is_processor_time(monkeypatch):
    watched = Watched(monkeypatch, Limits(3.0, advice="so it goes"))
    assert watched.pass_by(1, apart=3600.0) == ""  # this process was halted
    assert watched.pass_by(100, 0.01) == ""  # others have the processors
    excess = watched.pass_by(100, 0.5)
    assert excess == "it took more than 3 s of processor time, its budget; so it goes"
    loading = Watched(monkeypatch, Limits(3.0, advice="so it goes"), LOADING)
    assert loading.pass_by(200, 0.5).endswith("processor time, its budget")
    large = Watched(monkeypatch, Limits(1.0, 1.0, advice="take larger steps"))
    large.memory = 2**31
    excess = large.pass_by(2, 9.0)
    assert excess.startswith("it used more memory than the budget of 1 GiB; take a smaller scene")


def test_who_does_nothing_for_a_minute_ends_within_any_budget(monkeypatch):
    for phase, computed, ends in (
        (RUNNING, 0.0, True),
        (PREPARING, 1e-5, True),
        (RUNNING, 1e-2, False),
        (WAITING, 0.0, False),  # another process makes what it waits for
    ):
        watched = Watched(monkeypatch, Limits(1e6), phase)
        assert watched.pass_by(119, computed) == ""
        assert ("it did nothing for 60 s" in watched.pass_by(20, computed)) == ends


def test_a_phase_that_begins_again_goes_on_counting_and_a_job_begins_anew(monkeypatch):
    watched, found = Watched(monkeypatch, Limits(3.0)), ""
    watched.pass_by(1)
    for phase in (PREPARING, RUNNING) * 3:
        assert not found
        watched.meter.phase = phase
        found = watched.pass_by(1, 1.1)
    assert "3 s of processor time" in found
    for _ in range(10):  # what short jobs have used is not charged to the next
        watched.meter.start()
        assert watched.pass_by(1, 2.9) == ""


def test_use_of_this_process_and_its_children_is_seen():
    before = usage(os.getpid())
    assert before is not None
    with subprocess.Popen([sys.executable, "-c", "x = [0] * 10**7\nwhile True: pass"]) as child:
        assert comes(lambda: (usage(os.getpid()) or before)[0] > before[0] + 0.3)
        more = usage(os.getpid())
        child.kill()
    assert more is not None
    assert more[1] > before[1] + 2**26
    assert usage(2**22 + 1) is None
