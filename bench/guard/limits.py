"""Budgets of jobs: processor time, memory, and doing nothing."""

from __future__ import annotations

import math
import time
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass

#: Phases of a job; each has a budget of its own.
LOADING, PREPARING, REFERENCE = "loading", "preparing", "reference"
RUNNING, MEASURING = "running", "measuring"
#: The phase in which another process makes what is needed: it may do nothing.
WAITING = "waiting"
#: Processor time in s for loading plugins, and at least for each phase but that and a run; these
#: may take so many budgets of a run.
LOADING_SECONDS, LEAST_SECONDS, _MORE = 60.0, 120.0, 5
#: However large its budget is, a job may do nothing for so long, in s; a s of computing makes up
#: for `_REST` s. Threads that wait for each other do nothing for ever.
STILL_SECONDS, _REST = 60.0, 100.0
#: Time in s between two looks at a process, and the most of it that counts: more passes if this
#: process itself is halted.
_BETWEEN, _LONGEST = 0.2, 1.0
#: Neither steps nor tolerances change the memory of a run, nor how long a plugin loads.
_LESS_MEMORY = (
    "take a smaller scene or ensemble, a method with sparse tangents, or a suite with a larger "
    "memory_gib"
)
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


def usage(process: int) -> tuple[float, int] | None:
    """Measure the processor time in s and the resident memory in bytes of a process and all that
    it started, by its number; None if it is gone."""
    import psutil

    try:
        first = psutil.Process(process)
        tree = [first, *first.children(recursive=True)]
    except psutil.Error:
        return None
    seconds, memory = 0.0, 0
    for each in tree:
        with suppress(psutil.Error):
            memory += each.memory_info().rss
            seconds += sum(each.cpu_times()[:4])  # its own, and of children that were waited for
    return seconds, memory


class Meter:
    """Measures one job of a process against its limits, phase by phase.

    A phase that begins again goes on counting.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits, self.phase = limits, LOADING
        self.start()

    def start(self) -> None:
        """Begin a job, which has used nothing yet."""
        self._used: defaultdict[str, float] = defaultdict(float)
        self._still, self._before = 0.0, math.inf
        self._looked = time.monotonic()

    def excess(self, process: int) -> str:
        """Return the limit that a process has passed, as a clause with advice, if any."""
        now = time.monotonic()
        if now - self._looked < _BETWEEN or (use := usage(process)) is None:
            return ""
        seconds, memory = use
        computed = max(0.0, seconds - self._before)  # jobs before are not charged to this one
        passed = 0.0 if self.phase == WAITING else min(now - self._looked, _LONGEST)
        self._looked, self._before = now, seconds
        self._used[self.phase] += computed
        self._still = max(0.0, self._still + passed - _REST * computed)
        if memory > self._limits.memory_gib * 2**30:
            reason = f"it used more memory than the budget of {self._limits.memory_gib:g} GiB"
            return f"{reason}; {_LESS_MEMORY}"
        if self._used[self.phase] > (allowed := self._limits.seconds(self.phase)):
            reason = f"it took more than {allowed:g} s of processor time, its budget"
        elif self._still > STILL_SECONDS:
            reason = f"it did nothing for {STILL_SECONDS:g} s: it sleeps or waits"
        else:
            return ""
        advice = _LOADS_AT_ONCE if self.phase == LOADING else self._limits.advice
        return f"{reason}; {advice}" if advice else reason
