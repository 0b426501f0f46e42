"""Budgets of jobs: what counts on, what is not charged, and a process that is halted."""

from __future__ import annotations

from bench.guard import limits
from bench.guard.limits import PREPARING, RUNNING, Limits, Meter
from problems.usage import Usage


def test_a_phase_that_begins_again_goes_on_counting(monkeypatch):
    spent = iter(range(100))
    monkeypatch.setattr(limits, "usage", lambda process: Usage(computed_s=float(next(spent))))
    meter = Meter(Limits(budget_s=3.0))
    found = []
    for phase in (PREPARING, RUNNING) * 3:  # each call for the use finds a second more
        meter.begin(phase, 1)
        found.append(meter.excess(1))
    assert found[:-1] == [None] * 5
    assert "3 s of processor time" in found[-1].reason
    meter.start()  # the next job has a budget of its own
    meter.begin(RUNNING, 1)
    assert meter.excess(1) is None


def test_what_short_jobs_have_used_is_not_charged_to_the_next(monkeypatch):
    spent = [0.0]
    monkeypatch.setattr(limits, "usage", lambda process: Usage(computed_s=spent[0]))
    monkeypatch.setattr(limits.time, "monotonic", lambda: spent[0])
    meter = Meter(Limits(budget_s=3.0))
    meter.begin(RUNNING, 1)
    for _ in range(10):  # jobs of 1 s that answer before anybody looks
        meter.start(1)
        spent[0] += 1.0
    meter.start(1)
    assert meter.excess(1) is None
    spent[0] += 4.0
    assert "3 s of processor time" in meter.excess(1).reason


def test_a_job_shorter_than_a_look_costs_none(monkeypatch):
    looks = []
    monkeypatch.setattr(limits, "usage", lambda process: looks.append(process) or Usage())
    monkeypatch.setattr(limits.time, "monotonic", lambda: 1.0)
    meter = Meter(Limits(budget_s=3.0))
    for _ in range(100):
        meter.start(1)
    assert looks == [1]


def test_a_process_that_halts_itself_is_given_up(monkeypatch):
    times = iter(range(100))
    monkeypatch.setattr(limits, "usage", lambda process: Usage(stopped=True))
    monkeypatch.setattr(limits.time, "monotonic", lambda: float(next(times)))
    meter = Meter(Limits(budget_s=1.0))
    meter.begin(RUNNING, 1)
    found = [meter.excess(1) for _ in range(31)]
    assert found[:-1] == [None] * 30
    assert found[-1].status == "interrupted"
    assert "halted it for 30 s" in found[-1].reason
