"""Budgets of jobs: processor time, idle time, memory, and what they mean for the result."""

from __future__ import annotations

import math
import time
from collections import defaultdict
from dataclasses import dataclass
from typing import NamedTuple

from problems.usage import LONGEST_LOOK, Usage, idle_seconds, usage

#: Phases of a job; each has a budget of its own.
LOADING, PREPARING, REFERENCE = "loading", "preparing", "reference"
RUNNING, MEASURING = "running", "measuring"
#: The phase in which another process makes what is needed; it may be idle for `LEAST_SECONDS`.
WAITING = "waiting"
#: Processor time in s for loading plugins, and at least for each phase but that and a run.
LOADING_SECONDS, LEAST_SECONDS = 60.0, 120.0
#: Each phase but loading and running may take so many budgets of a run.
_MORE = 5
#: A process may be idle for so many budgets of a run, or at least so long, in s.
_IDLE, _LEAST_IDLE = 2, 10.0
#: However large its budget is, it may do nothing for so long, in s; a s of computing makes up for
#: `_REST` s. Threads that wait for each other do nothing for ever.
_STILL, _REST = 60.0, 100.0
#: A process may be halted by a signal, as its user or itself may send, so many idle times.
_STOPPED = 3
#: A job is given up as interrupted when it lasts so many times its budget, and so many s more,
#: without having computed or been idle: the machine did not let it run.
_LATE, _LEAST_LATE = 20, 60.0
#: Time in s between two comparisons with the limits: each takes longer than many a job.
_BETWEEN = 0.05
#: Neither steps nor tolerances change what a run holds in memory.
_LESS_MEMORY = (
    "take a smaller scene or ensemble, a method with sparse tangents, or a suite with a larger "
    "memory_gib"
)
#: Neither do they change how long a plugin loads.
_LOADS_AT_ONCE = "take what waits or computes out of its top level, or bodies out of its model"


@dataclass(frozen=True)
class Limits:
    """The most that one job may take.

    Parameters
    ----------
    budget_s
        Processor time of a run in s. Tracing and compiling, the reference of a scene, and the
        measurement of errors may each take five times as long, but at least `LEAST_SECONDS`.
    memory_gib
        Resident memory.
    processors
        Processors that a run keeps busy: so many times the budget is allowed.
    advice
        A clause that tells the user how to stay within the budget.
    """

    budget_s: float = math.inf
    memory_gib: float = math.inf
    processors: int = 1
    advice: str = ""

    def seconds(self, phase: str) -> float:
        """Return the processor time in s of a phase."""
        if phase == LOADING:
            return LOADING_SECONDS
        if phase == RUNNING:
            return self.budget_s * self.processors
        return max(LEAST_SECONDS, _MORE * self.budget_s)

    @property
    def idle_seconds(self) -> float:
        """Return the time in s that a process may do nothing."""
        return max(_LEAST_IDLE, _IDLE * self.budget_s)


class Excess(NamedTuple):
    """A limit that was passed: the status of the job, and the reason with advice as clauses."""

    status: str
    reason: str


def _over_budget(reason: str, advice: str) -> Excess:
    return Excess("budget_exceeded", f"{reason}; {advice}" if advice else reason)


@dataclass
class _Used:
    """Processor time, idle time in all and of late, time halted by a signal, and duration of a
    phase so far."""

    computed_s: float = 0.0
    idle_s: float = 0.0
    still_s: float = 0.0
    stopped_s: float = 0.0
    lasted_s: float = 0.0


class Meter:
    """Measures one job of a process against its limits, phase by phase.

    What a phase has used counts on when the job comes back to it: else foreign code could get a
    new budget by saying that a phase begins.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits, self._last, self._seen = limits, Usage(), 0.0
        self.phase = LOADING
        self.start()

    def start(self, process: int | None = None) -> None:
        """Begin a job, which has used nothing: jobs before it may have ended without a look.

        They are looked at now and then, as a look takes longer than many a job.
        """
        if process and time.monotonic() - self._seen >= _BETWEEN:
            self._last, self._seen = usage(process) or self._last, time.monotonic()
        self._used: defaultdict[str, _Used] = defaultdict(_Used)
        self._looked = self._compared = time.monotonic()

    def begin(self, phase: str, process: int | None = None) -> None:
        """Go on to a phase; the use so far belongs to the one before."""
        if process:
            self._count(process)
        self.phase = phase

    def _count(self, process: int) -> Usage | None:
        """Add the use since the last look to the phase; None if the process is gone."""
        now, use = time.monotonic(), usage(process)
        if use is None:
            return None
        passed, used = min(now - self._looked, LONGEST_LOOK), self._used[self.phase]
        computed = max(0.0, use.computed_s - self._last.computed_s)
        used.computed_s += computed
        used.lasted_s += passed
        if use.stopped:
            used.stopped_s += passed
        else:
            idle = idle_seconds(self._last, use, passed)
            used.idle_s += idle
            used.still_s = max(0.0, used.still_s + idle - _REST * computed)
        self._looked, self._last = now, use
        return use

    @property
    def is_due(self) -> bool:
        """Whether the job began, or was compared with its limits, some time ago."""
        return time.monotonic() - self._compared >= _BETWEEN

    def excess(self, process: int) -> Excess | None:
        """Look at a process; return the limit that it has passed, if any."""
        self._compared = time.monotonic()
        if (use := self._count(process)) is None:
            return None
        used = self._used[self.phase]
        allowed = self._limits.seconds(self.phase)
        advice = _LOADS_AT_ONCE if self.phase == LOADING else self._limits.advice
        if use.memory > self._limits.memory_gib * 2**30:  # first, as it takes time, too
            reason = f"it used more memory than the budget of {self._limits.memory_gib:g} GiB"
            return _over_budget(reason, _LESS_MEMORY)
        if used.computed_s > allowed:
            reason = f"it took more than {allowed:g} s of processor time, its budget"
            return _over_budget(reason, advice)
        idle = LEAST_SECONDS if self.phase == WAITING else self._limits.idle_seconds
        if used.idle_s > idle:
            return _over_budget(f"it did nothing for {idle:g} s: it sleeps or waits", advice)
        if used.still_s > _STILL and self.phase != WAITING:
            return Excess("budget_exceeded", f"it did nothing for {_STILL:g} s: it sleeps or waits")
        stopped = _STOPPED * idle
        if used.stopped_s > stopped:
            return Excess("interrupted", f"a signal had halted it for {stopped:g} s")
        if used.lasted_s > _LATE * allowed + _LEAST_LATE:
            return Excess(
                "interrupted", "the machine hardly let it run: it was halted, or busy with others"
            )
        return None
