"""Timing samples: rounds, and intervals of their medians."""

from __future__ import annotations

import gc
import math
import os
import subprocess
import sys
import time
from functools import partial
from threading import Event, Thread
from types import SimpleNamespace

import msgspec
import pytest
from helpers import cell_of
from small_stores import NO_ROWS, a_record

from bench.plugins.fingerprint import environment
from bench.plugins.registry import Registry
from bench.results.store import Store
from bench.results.timings import by_round, median_interval, quotient
from bench.running.inventory import Inventory
from bench.running.plan import ProfileFile, StudyFile, make_suite
from bench.running.process import Limits
from bench.running.runner import Runner, cell_task
from bench.running.session import time_suite
from bench.running.worker import Worker
from integrators.resolutions import Steps


def test_the_interval_of_the_median_is_that_of_the_sign_test():
    """Ranks from a table: n = 6 to 8: 1; 9 to 11: 2; 12 to 14: 3; 15, 16: 4; 20: 6; 25: 8."""
    table = {6: 1, 7: 1, 8: 1, 9: 2, 11: 2, 12: 3, 14: 3, 15: 4, 16: 4, 20: 6, 25: 8}
    for n, place in table.items():
        assert median_interval(range(n, 0, -1)) == (place, n + 1 - place)
    assert median_interval([3.0, 1.0, 2.0]) == (1.0, 3.0)


PENDULUM = cell_of(Registry([]), "pendulum", "newmark", 1.0, Steps(0.1))


def sample_of(execute):
    """A timing sample of this function, as a run of a worker."""
    worker = Worker(Registry([]))
    worker.prepared[PENDULUM.key] = SimpleNamespace(execute=execute)
    return worker.time(PENDULUM)


class _Clock(Runner):
    """A runner whose worker tells when it was asked."""

    def __init__(self, seconds=None):
        super().__init__(1, Limits(1.0, 1.0))
        self.seconds, self.asked = seconds or {}, []

    def _timekeeper(self, task):
        def ask(job, cell):
            self.asked.append(cell.key)
            return self.seconds.get(cell.key, 1e-3)

        return SimpleNamespace(ask=ask)


def test_the_cells_of_a_scene_are_neighbours_in_every_round():
    cells = [
        cell_of(Registry([]), scene, name, 1.0, Steps(h, (1.0,)))
        for h in (0.1, 0.05)
        for name in ("newmark", "hht")
        for scene in ("pendulum", "oscillator")
    ]
    long, known = cells[1].key, cells[2].key
    runner = _Clock({long: 0.6})
    tasks = [cell_task(Worker.time, cell) for cell in cells]
    taken = list(runner.time(tasks, 7, {known: dict.fromkeys((0, 1, 3), 1e-3)}))
    for number in range(7):
        scenes = [task.scene for task, n, _ in taken if n == number]
        assert scenes == sorted(scenes, key="pendulum oscillator".index)
    counts = {cell.key: runner.asked.count(cell.key) for cell in cells}
    # Samples that are there are not taken again; a long run stops after a second.
    assert counts == dict.fromkeys(counts, 7) | {long: 2, known: 4}
    assert [n for _, n, _ in taken] == sorted(n for _, n, _ in taken)
    assert [n for task, n, _ in taken if task.label == known] == [2, 4, 5, 6]


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="the system cannot do it")
def test_a_sample_has_one_processor_and_no_old_garbage_to_look_through():
    whole, seen = os.sched_getaffinity(0), []
    stop = Event()
    thread = Thread(target=stop.wait)
    thread.start()

    def execute():
        compute()
        seen.append((os.sched_getaffinity(0), os.sched_getaffinity(thread.native_id)))
        seen.append(gc.get_freeze_count() > 1000)

    try:
        sample_of(execute)
        after = os.sched_getaffinity(0), os.sched_getaffinity(thread.native_id)
    finally:
        stop.set()
        thread.join()
    assert seen[::2] == [({min(whole)}, {min(whole)})] * (len(seen) // 2)
    assert all(seen[1::2])
    assert after == (whole, whole)
    assert gc.get_freeze_count() == 0


def compute():
    begun = time.process_time()
    while time.process_time() < begun + 0.005:
        pass


def compute_elsewhere():
    thread = Thread(target=compute)
    thread.start()
    thread.join()


def start_a_program():
    subprocess.run([sys.executable, "-S", "-c", "sum(range(10**6))"], check=True)


def test_a_sample_counts_what_a_run_computes_and_not_what_it_waits(monkeypatch):
    """A starved process waits, too; threads and programs of the run compute for it."""
    for execute, low, high in [
        (partial(time.sleep, 0.05), 0.0, 0.04),
        (compute_elsewhere, 0.005, math.inf),
        (start_a_program, 0.005, math.inf),
    ]:
        monkeypatch.setattr("bench.running.measure.TIMING_SECONDS", 0.1)
        assert low <= sample_of(execute) < high


class _Machine:
    """A processor whose clock takes ``cost`` s to read and goes in ``ticks`` of s; every ``often``
    s of its time another process disturbs it for 2 ms."""

    def __init__(self, monkeypatch, cost=1.5e-6, ticks=0.0, often=math.inf):
        self.now, self.cost, self.ticks, self.often = 0.0, cost, ticks, often
        self.runs = 0
        monkeypatch.setattr("time.process_time", self.read)

    def compute(self, seconds):
        disturbed = (self.now + seconds) // self.often - self.now // self.often
        self.now += seconds + 2e-3 * disturbed

    def read(self):
        self.compute(self.cost)
        return self.now // self.ticks * self.ticks if self.ticks else self.now

    def sample(self, seconds):
        """A timing sample of a run that takes so many s."""

        def execute():
            self.runs += 1
            self.compute(seconds)

        return sample_of(execute)


def test_a_sample_is_the_least_run_whatever_disturbs_others_and_however_short(monkeypatch):
    for often in [2.5e-3, 7e-3, math.inf]:
        for seconds in [2e-7, 3e-6, 4e-5, 3e-4, 2e-3, 9e-3]:
            machine = _Machine(monkeypatch, often=max(often, 1.5 * seconds))
            # Reading the clock takes a part of a reading, which has to be long enough for that.
            assert machine.sample(seconds) == pytest.approx(seconds, rel=0.04)
    assert 1e-5 < _Machine(monkeypatch, ticks=4e-3).sample(3e-5) < 1e-4  # it hardly moves
    for seconds, runs in [(4e-3, 3), (9e-3, 3), (2e-2, 2), (0.1, 1)]:
        machine = _Machine(monkeypatch)
        machine.sample(seconds)
        assert machine.runs == runs  # repeated while that is cheap


def two_records(tmp_path, one, two):
    """Records of two cells with samples (round, seconds, invocation), as a store gives them."""
    with Store(tmp_path, create=True) as store:
        for key, samples in (("one", one), ("two", two)):
            store.save(a_record(key, environment=7), NO_ROWS)
            for sample in samples:
                store.add_sample(key, *sample)
        return store.records().values()


def test_samples_are_paired_by_their_round_and_not_by_their_place(tmp_path):
    # Each round is another time of the machine; the second cell takes three times as long.
    one = [(n, 10.0**-n, 1) for n in (0, 1, 3, 4, 5, 6, 7)]
    two = [(n, 3 * 10.0**-n, 1) for n in range(8)]
    found = quotient(*map(by_round, two_records(tmp_path, one, two)))
    assert found == pytest.approx((3.0, 3.0, 3.0, 1.1))


def test_times_are_compared_within_rounds_or_else_by_both_intervals():
    busy, factors = [1.0, 2.0, 5.0, 3.0, 1.5, 1.2, 7.0], [1.0, 1.0, 1.0, 1.0, 1.0, 1.2, 0.9]
    slower = [2 * f * s for f, s in zip(factors, busy, strict=True)]
    one, two, later = (
        {(invocation, k): s for k, s in enumerate(samples)}
        for invocation, samples in ((1, busy), (1, slower), (2, slower))
    )
    found, apart = quotient(one, two), quotient(one, later)
    assert found == pytest.approx((2.0, 1.8, 2.4, 1.1))
    assert apart == pytest.approx((2.0, 2.0 / 7.0, 2 * 6.3 / 1.0, 1.1))
    assert (found.differs, apart.differs) == (True, False)
    assert quotient({(1, 0): 1e-3}, {(2, 0): 3e-3}) is None  # one short sample each says nothing


def test_the_rounds_that_are_missing_are_taken_once(tmp_path):
    for taken in [(0, 1, 3), (0, 3, 4), (0, 2, 3, 4, 8)]:
        study = StudyFile(problems=["pendulum"], integrators=["newmark"], steps=[0.01])
        suite = make_suite("x", ProfileFile(study=[study], samples=5), Inventory())
        (cell,) = suite.cells.values()
        runner = _Clock()
        with Store(tmp_path / str(taken), create=True) as store:
            machine = environment()
            store.keep(machine)
            first = machine.number
            record = cell.record("ok")
            record.environment = first
            store.save(record, NO_ROWS)
            for number in taken:
                store.add_sample(cell.key, number, 1e-3, first)
            later = msgspec.structs.replace(machine, date="later")
            store.keep(later)
            second = later.number
            for _ in range(2):
                time_suite(suite, store, runner)
            (found,) = store.records().values()
        missing = set(range(5)) - set(taken)
        assert found.rounds == sorted(
            [(first, n) for n in taken] + [(second, n) for n in missing], key=lambda place: place[1]
        )
        assert len(runner.asked) == len(missing)


def test_long_runs_that_may_win_get_as_many_samples_as_an_interval_takes(tmp_path):
    """A run of 0.4 s has three samples in a second; times are told apart from six on."""
    found = {  # step: error in q and in a, s, number of samples
        0.1: (1e-2, 1e-2, 1e-3, 6),
        0.05: (1e-2, 1e-1, 0.4, 3),  # another run has errors as small in a four-hundredth
        0.04: (1e-1, 1e-3, 0.4, 6),
        0.02: (2e-1, 1e-3, 0.7, 6),  # the other one takes more than half of its time
        0.01: (2e-1, 1e-3, 0.9, 2),
        0.005: (1e-5, 1e-5, 1.5, 1),  # six of these would last too long
        0.004: (None, None, 0.4, 3),
    }
    study = StudyFile(problems=["pendulum"], integrators=["newmark"], steps=[*found])
    runner = _Clock()
    suite = make_suite("x", ProfileFile(study=[study], samples=7), Inventory())
    cells = {cell.resolution.h: cell for cell in suite.cells.values()}
    with Store(tmp_path, create=True) as store:
        store.keep(environment())
        for h, (q, a, seconds, _) in found.items():
            record = cells[h].record("ok")
            record.errors = {"q": {"max": q}, "a": {"max": a}}
            store.save(record, NO_ROWS)
            runner.seconds[record.key] = seconds
        for _ in range(2):
            time_suite(suite, store, runner)
        counts = {r.h: len(r.run_s) for r in store.records().values()}
    assert counts == {h: n + (h == 0.1) for h, (*_, n) in found.items()}
    assert len(runner.asked) == sum(counts.values())
