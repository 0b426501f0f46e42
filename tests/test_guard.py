"""Guarded processes: fates of jobs, budgets, and nothing that is left behind."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import guarded_jobs as jobs
import numpy as np
import pytest

from bench.guard import limits
from bench.guard import process as process_module
from bench.guard.limits import PREPARING, RUNNING, WAITING, Limits, Meter
from bench.guard.process import GuardedProcess, NoAnswer, Refused
from bench.guard.wire import BrokenMessage, decode, encode, message, messages
from problems import usage
from problems.usage import Usage


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


def test_answers_come_back_as_data_of_the_stated_type(guarded):
    assert guarded().ask(jobs.add, 1, two=2) == 13
    np.testing.assert_array_equal(
        guarded().ask(jobs.numbers), [[1.0, np.nan], [np.inf, -0.0]], strict=True
    )


@pytest.mark.parametrize(
    ("job", "arguments", "status", "words"),
    [
        (jobs.raises, (), "crashed", "ValueError: so it goes (guarded_jobs.py, line"),
        (jobs.leaves, (), "crashed", "SystemExit: 0"),
        (jobs.an_object, (), "crashed", "object cannot be sent"),
        (jobs.another_type, (), "crashed", "Its answer cannot be read"),
        (jobs.sends_rubbish, (), "crashed", "Its answer cannot be read"),
        (jobs.exits, (), "crashed", "died while running (exit code 3)"),
        (jobs.ends_by, (signal.SIGSEGV,), "crashed", "died while running (SIGSEGV)"),
        (jobs.ends_by, (signal.SIGKILL,), "interrupted", "from outside while running (SIGKILL)"),
        (jobs.ends_by, (signal.SIGTERM,), "interrupted", "from outside while running (SIGTERM)"),
        (jobs.computes, (60.0,), "budget_exceeded", "more than 0.5 s of processor time"),
    ],
)
def test_a_job_that_fails_has_a_fate_and_the_next_one_an_answer(
    guarded, job, arguments, status, words
):
    fate = guarded().ask(job, *arguments)
    assert isinstance(fate, NoAnswer)
    assert (fate.status, fate.phase) == (status, "running")
    assert words in fate.message
    assert guarded().ask(jobs.add, 1) == 11


def test_a_job_that_takes_too_much_memory_is_told_so():
    process = GuardedProcess(jobs.prepare, (10,), Limits(60.0, 0.3))
    fate = process.ask(jobs.hoards)
    assert fate.status == "budget_exceeded"
    assert "budget of 0.3 GiB; take a smaller scene" in fate.message


def test_a_refusal_keeps_its_sentence(guarded):
    fate = guarded().ask(jobs.refuses)
    assert (type(fate), fate.message) == (Refused, "No such thing.")


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
    assert printed.startswith("firstxxx")
    assert printed.endswith("\N{REPLACEMENT CHARACTER}[31mlast")
    assert len(printed) < 5000
    guarded().ask(jobs.add, 1)
    assert guarded().printed() == ""


def test_a_process_starts_beside_a_thousand_open_files():
    """The numbers of its descriptors are above 1024, of which select() knows nothing."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 2000), hard))
    descriptors = [os.open(os.devnull, os.O_RDONLY) for _ in range(1100)]
    process = GuardedProcess(jobs.prepare, (10,))
    try:
        assert process.ask(jobs.add, 1) == 11
    finally:
        process.end()
        for descriptor in descriptors:
            os.close(descriptor)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_a_child_of_a_job_does_not_answer_for_it(guarded):
    assert guarded().ask(jobs.comes_back_twice) == 8
    assert guarded().ask(jobs.add, 1) == 11


def comes(condition: Callable[[], bool]) -> bool:
    """Whether a condition holds at last."""
    given_up = time.monotonic() + 60
    while not condition() and time.monotonic() < given_up:
        time.sleep(0.01)
    return condition()


def marked(process: GuardedProcess) -> list[int]:
    """The processes that were started by a guarded one, wherever they are now."""
    wanted, found = f"STEPBENCH_KEPT={process._mark}".encode(), []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if wanted in (entry / "environ").read_bytes():
                found.append(int(entry.name))
        except OSError:
            continue
    return found


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="needs /proc")
def test_children_of_a_dead_process_end_though_they_hold_its_pipes(guarded):
    process = guarded()
    fate = process.ask(jobs.leaves_children)  # they hold its pipes for 1000 s
    assert "exit code 4" in fate.message
    assert marked(process) == []


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="needs /proc")
def test_a_keeper_that_somebody_has_halted_keeps_nothing_alive(guarded, monkeypatch):
    monkeypatch.setattr(process_module, "_KEEPER_SECONDS", 0.2)
    process = guarded()
    assert process.ask(jobs.add, 1) == 11
    os.kill(process._keeper.pid, signal.SIGSTOP)
    process.end()
    assert comes(lambda: not marked(process))


def test_with_its_keeper_a_process_ends(guarded):
    process = guarded()
    assert process.ask(jobs.starts_a_child) == 1
    assert comes(lambda: len(marked(process)) == 3)  # keeper, process, child
    os.kill(process._keeper.pid, signal.SIGKILL)
    fate = process.ask(jobs.computes, 60.0)
    assert fate.status == "interrupted"
    assert comes(lambda: marked(process) == [])


def running(within: Limits) -> Meter:
    """A meter of a job that runs."""
    meter = Meter(within)
    meter.begin(RUNNING)
    return meter


# ---- budgets ---------------------------------------------------------------------------
class Clock:
    """Time and use of a process as a test wants them."""

    def __init__(self, monkeypatch):
        self.now, self.use = 0.0, Usage()
        monkeypatch.setattr(limits.time, "monotonic", lambda: self.now)
        monkeypatch.setattr(limits, "usage", lambda process: self.use)

    def run(self, meter: Meter, looks: int, **more: float):
        """Look ``looks`` times, a tenth of a second apart; return the first excess."""
        for _ in range(looks):
            self.now += 0.1
            self.use = self.use._replace(
                computed_s=self.use.computed_s + more.get("computed_s", 0.0),
                queued_s=self.use.queued_s + more.get("queued_s", 0.0),
                memory=int(more.get("memory", 0)),
                stopped=bool(more.get("stopped", False)),
                ready=bool(more.get("ready", False)),
            )
            if excess := meter.excess(1):
                return excess
        return None


@pytest.mark.parametrize(
    ("use", "status"),
    [
        ({"computed_s": 0.1}, "budget_exceeded"),
        ({"computed_s": 0.01, "queued_s": 0.09}, None),  # others have the processors
        ({"ready": True}, None),  # its threads that ended had waited for a processor
        ({}, "budget_exceeded"),  # it sleeps
        ({"stopped": True}, None),  # somebody has halted it
    ],
)
def test_a_budget_is_processor_time_and_no_load_or_halt_uses_it_up(monkeypatch, use, status):
    clock = Clock(monkeypatch)
    found = clock.run(running(Limits(budget_s=3.0)), 280, **use)
    assert (found and found.status) == status


def test_a_job_may_wait_for_what_another_process_makes_but_not_for_ever(monkeypatch):
    clock, meter = Clock(monkeypatch), running(Limits(budget_s=3.0))
    meter.begin(WAITING)
    assert clock.run(meter, 1100) is None
    assert clock.run(meter, 200) is not None


@pytest.mark.parametrize(
    ("phase", "computed", "ends"),
    [(RUNNING, 0.0, True), (PREPARING, 1e-5, True), (RUNNING, 2e-3, False), (WAITING, 0.0, False)],
)
def test_who_does_nothing_for_a_minute_ends_within_any_budget(monkeypatch, phase, computed, ends):
    clock, meter = Clock(monkeypatch), Meter(Limits(budget_s=1e6, advice="a larger --budget"))
    meter.begin(phase)
    found = clock.run(meter, 650, computed_s=computed)
    assert (found is not None) == ends
    if found:
        assert found.reason == "it did nothing for 60 s: it sleeps or waits"


def test_who_takes_too_much_memory_is_not_told_to_take_larger_steps(monkeypatch):
    clock, within = Clock(monkeypatch), Limits(1.0, 1.0, advice="take larger steps")
    found = clock.run(running(within), 1, computed_s=9.0, memory=2**31)
    assert found is not None
    assert found.reason.startswith("it used more memory")
    assert "; take a smaller scene" in found.reason


@pytest.mark.parametrize("use", [{}, {"computed_s": 0.1}])
def test_who_loads_for_too_long_is_not_told_to_take_larger_steps(monkeypatch, use):
    clock, within = Clock(monkeypatch), Limits(3.0, advice="take larger steps")
    found = clock.run(Meter(within), 700, **use)
    assert found is not None
    assert found.reason.endswith("top level, or bodies out of its model")


def test_a_machine_that_lets_nothing_run_interrupts(monkeypatch):
    clock = Clock(monkeypatch)
    found = clock.run(running(Limits(budget_s=3.0)), 1250, queued_s=0.1)
    assert found is not None
    assert found.status == "interrupted"
    assert clock.now == pytest.approx(120.1, abs=0.2)


def test_a_halt_of_this_process_counts_a_second(monkeypatch):
    clock = Clock(monkeypatch)
    meter = running(Limits(budget_s=3.0))
    clock.now += 3600.0
    assert meter.excess(1) is None


def test_who_announces_a_phase_again_and_again_gains_no_time(monkeypatch):
    clock, meter = Clock(monkeypatch), running(Limits(budget_s=3.0))
    for _ in range(1250):
        clock.now += 0.1
        clock.use = clock.use._replace(computed_s=clock.use.computed_s + 0.1)
        meter.begin(PREPARING, 1)
    found = meter.excess(1)
    assert found is not None
    assert "more than 120 s of processor time" in found.reason


def test_use_of_this_process_and_its_children_is_seen():
    before = usage.usage(os.getpid())
    assert before is not None
    while time.process_time() < 0.1:
        pass
    after = usage.usage(os.getpid())
    assert after is not None
    assert after.computed_s >= before.computed_s > 0
    assert after.memory > 2**20
    assert after.ready  # it asks
    with subprocess.Popen(["sleep", "1000"]) as idle:
        assert comes(lambda: (use := usage.usage(idle.pid)) and not use.ready)
        idle.kill()
    assert usage.usage(2**22 + 1) is None


def test_a_thread_that_ended_between_two_looks_does_not_make_a_process_idle(tmp_path, monkeypatch):
    """Under load each thread of a job waits for a processor longer than it has it."""
    monkeypatch.setattr(usage, "_PROC", tmp_path)
    (tmp_path / "self").mkdir()
    (tmp_path / "self/stat").touch()
    looks, clock = [], [0.0]
    monkeypatch.setattr(limits.time, "monotonic", lambda: clock[0])
    meter = running(Limits(budget_s=3.0))
    for look in range(300):
        clock[0] += 0.1
        shutil.rmtree(tmp_path / "7", ignore_errors=True)
        for name, state in ((7, "S"), (look + 8, "R")):  # each thread is a new one
            task = tmp_path / "7" / "task" / str(name)
            task.mkdir(parents=True)
            (task / "stat").write_text(f"{name} (a) b) {state} {'0 ' * 50}")
            (task / "schedstat").write_text("0 90000000 1")
        shutil.copy(tmp_path / "7/task/7/stat", tmp_path / "7/stat")
        looks.append(meter.excess(7))
    assert not any(looks)


# ---- messages --------------------------------------------------------------------------
def test_messages_come_in_pieces_of_any_size():
    sent = message("done", [1, 2]) + message("phase", ("running", "x"))
    for size in (1, 3, 7, len(sent)):
        inbox, found = bytearray(), []
        for k in range(0, len(sent), size):
            inbox += sent[k : k + size]
            found += messages(inbox)
        assert [m.kind for m in found] == ["done", "phase"]
        assert decode(found[0].content, list[int]) == [1, 2]


@pytest.mark.parametrize("content", [b"\xff" * 20, b"\x03" + 7 * b"\0" + b"abc"])
def test_bytes_that_are_no_message_are_told(content):
    with pytest.raises(BrokenMessage):
        list(messages(bytearray(content)))


@pytest.mark.parametrize(
    "value", [b"abc", ["<f8", [3], b"12"], ["|O", [1], b"12345678"], ["<f8", [-1], b""]]
)
def test_what_is_no_array_of_numbers_is_told(value):
    with pytest.raises(BrokenMessage):
        decode(encode(value), np.ndarray)


def test_who_closes_its_output_keeps_nobody_awake(guarded):
    guarded().start(jobs.closes_its_output, 0.5)
    looks, begun = 0, time.monotonic()
    while guarded().poll() is None:
        process_module.wait_for_any([guarded()])
        looks += 1
    assert looks < 5 + (time.monotonic() - begun) / process_module._WATCH_SECONDS
