"""Guarded processes: fates of jobs, budgets, and nothing that is left behind."""

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
        (jobs.sleeps, "2 s: it sleeps or waits; have it compute or return"),
    ):
        fate = GuardedProcess(jobs.prepare, (10,), Limits(60.0, 0.3, advice="so it goes")).ask(job)
        assert fate.status == "budget_exceeded"
        assert words in fate.message
    fate = GuardedProcess(jobs.raises, ()).ask(jobs.add, 1)
    assert fate.phase == LOADING
    assert "while loading this program (exit code 1). Its last words: ValueError" in fate.message


def test_a_phase_has_a_budget_of_its_own_and_prints_are_cut_and_shown_as_text(guarded, monkeypatch):
    process, told = guarded(), []
    process.on_phase = lambda *phase: told.append(phase)
    assert process.ask(jobs.computes_a_reference, 0.8) == 1
    assert ("reference", "making the reference of x") in told
    process.ask(jobs.prints)
    printed = process.printed()
    assert printed.startswith("... xxx")
    assert printed.endswith("\N{REPLACEMENT CHARACTER}[31mlast")
    assert len(printed) < 5000
    process.ask(jobs.add, 1)
    assert process.printed() == ""
    monkeypatch.setattr(limits, "LEAST_SECONDS", 0.2)
    monkeypatch.setattr(limits, "_MORE", 0.1)
    fate = guarded().ask(jobs.computes_a_reference, 60.0)
    assert (fate.status, fate.phase) == ("budget_exceeded", "reference")
    assert fate.message.startswith("Stopped while making the reference of x because")


# ---- nothing that is left behind -----------------------------------------------------------
def comes(condition: Callable[[], bool]) -> bool:
    """Whether a condition holds at last."""
    given_up = time.monotonic() + 60
    while not condition() and time.monotonic() < given_up:
        time.sleep(0.01)
    return condition()


def test_all_that_a_process_started_ends_with_it_and_holds_no_answer(guarded):
    process = guarded()
    children = process.ask(jobs.starts_children)
    assert all(map(psutil.pid_exists, children))
    process.end()
    assert comes(lambda: not any(map(psutil.pid_exists, [process.pid, *children])))
    process = guarded()  # a child of it holds the pipe
    assert "exit code 4" in process.ask(jobs.leaves_a_child).message
    child = int(process.printed())
    assert comes(lambda: not psutil.pid_exists(child))


def test_a_process_ends_with_the_program_that_started_it():
    """Though that is killed, and though it computes."""
    code = (
        "import guarded_jobs as jobs, os, signal\n"
        "from bench.running.process import GuardedProcess; "
        "p = GuardedProcess(jobs.prepare, (10,)); print(p.pid, flush=True); "
        "p.on_phase = lambda phase, _: phase == 'running' and os.kill(os.getpid(), 9); "
        "p.ask(jobs.computes, 600.0)"
    )
    path = os.pathsep.join([os.path.dirname(jobs.__file__), *sys.path])
    given = os.environ | {"PYTHONPATH": path}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=given)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert comes(lambda: not psutil.pid_exists(int(done.stdout)))


# ---- budgets -------------------------------------------------------------------------------
@pytest.fixture
def looks(monkeypatch):
    """A function of a meter that looks so many times, some s apart, in each of which the process
    computes, at a memory in bytes; it returns the excess."""
    now, used = [0.0], [0.0, 0]
    monkeypatch.setattr(limits.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(limits, "usage", lambda process: tuple(used))

    def look(meter, count, computed=0.0, apart=0.5, memory=0):
        for _ in range(count):
            now[0], used[:] = now[0] + apart, (used[0] + computed, memory)
            if excess := meter.excess(1):
                return excess
        return ""

    return look


def metered(within: Limits, phase: str = RUNNING) -> Meter:
    meter = Meter(within)
    meter.phase = phase
    return meter


def test_a_budget_is_processor_time_or_memory(looks):
    meter = metered(Limits(3.0, advice="so it goes"))
    assert looks(meter, 1, apart=3600.0) == ""  # this process was halted
    assert looks(meter, 100, 0.01) == ""  # others have the processors
    said = "it took more than 3 s of processor time, its budget"
    assert looks(meter, 100, 0.5) == f"{said}; so it goes"
    loading = metered(Limits(3.0, advice="so it goes"), LOADING)
    assert looks(loading, 200, 0.5).endswith("processor time, its budget")
    said = looks(metered(Limits(1.0, 1.0, advice="take larger steps")), 2, 9.0, memory=2**31)
    assert said.startswith("it used more memory than the budget of 1 GiB; take a smaller scene")


def test_who_does_nothing_for_a_minute_ends_within_any_budget(looks):
    for phase, computed, ends in (
        (RUNNING, 0.0, True),
        (PREPARING, 1e-5, True),
        (RUNNING, 1e-2, False),
    ):
        meter = metered(Limits(1e6), phase)
        assert looks(meter, 119, computed) == ""
        assert ("it did nothing for 60 s" in looks(meter, 20, computed)) == ends


def test_a_phase_that_begins_again_goes_on_counting_and_a_job_begins_anew(looks):
    meter, found = metered(Limits(3.0)), ""
    looks(meter, 1)
    for phase in (PREPARING, RUNNING) * 3:
        assert not found
        meter.phase = phase
        found = looks(meter, 1, 1.1)
    assert "3 s of processor time" in found
    for _ in range(10):  # what short jobs have used is not charged to the next
        meter.start()
        assert looks(meter, 1, 2.9) == ""


def test_use_of_this_process_and_its_children_is_seen():
    before = usage(os.getpid())
    assert before is not None

    def grown():  # the machine may take memory back from this process meanwhile
        seconds, size = usage(os.getpid()) or before
        return seconds > before[0] + 0.3 and size > before[1] + 2**26

    with subprocess.Popen([sys.executable, "-c", "x = [0] * 3 * 10**7\nwhile True: pass"]) as child:
        assert comes(grown)
        child.kill()
    assert usage(2**22 + 1) is None
