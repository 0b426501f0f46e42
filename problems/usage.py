"""Use of the machine by a process and all that it started: processor time, waiting, memory."""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from typing import NamedTuple

_PROC = Path("/proc")
#: Longest time in s between two looks that counts: more passes if this process itself is halted.
LONGEST_LOOK = 1.0


class Usage(NamedTuple):
    """Use by a tree of processes so far.

    Attributes
    ----------
    computed_s
        Processor time in s.
    queued_s
        Time in s that threads were ready, and the processors busy with others.
    memory
        Resident memory in bytes.
    stopped
        Whether a signal has stopped the first process.
    ready
        Whether a thread computes now, or waits for a processor.
    """

    computed_s: float = 0.0
    queued_s: float = 0.0
    memory: int = 0
    stopped: bool = False
    ready: bool = False


def cores() -> int:
    """Return how many cores this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def computed_seconds() -> float:
    """Processor time in s of this process: of all of its threads, and of programs it waited for.

    XLA computes most of a program in a thread of its own, also where it has only one: a clock of
    the calling thread misses up to 99 % of a run.
    """
    others = getrusage(RUSAGE_CHILDREN)  # os.times() has them in hundredths of a second
    return time.process_time() + others.ru_utime + others.ru_stime


@contextmanager
def undisturbed() -> Iterator[None]:
    """Keep all threads on one processor, and old objects out of the search for garbage, meanwhile.

    XLA hands programs over between two threads. On two processors these wait for each other by
    computing, now and then, and a short program takes up to three times its time.
    """
    allowed = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    _keep_to(sorted(allowed)[:1])
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        _keep_to(allowed)


def _keep_to(processors: Collection[int]) -> None:
    for thread in (_PROC / "self/task").iterdir() if processors else ():
        with suppress(OSError):  # it has just ended
            os.sched_setaffinity(int(thread.name), processors)


def idle_seconds(before: Usage, after: Usage, passed: float) -> float:
    """Return for how many of the s between two looks a tree of processes was idle.

    Nothing tells how long threads and processes that have ended meanwhile had waited for a
    processor. So this time counts only if at the second look no thread waits for one or has it.
    """
    computed = max(0.0, after.computed_s - before.computed_s)
    queued = max(0.0, after.queued_s - before.queued_s)
    return 0.0 if after.ready else max(0.0, min(passed, LONGEST_LOOK) - computed - queued)


def usage(process: int) -> Usage | None:
    """Measure a tree of processes by the number of the first; None if that is gone."""
    try:
        if not (_PROC / "self/stat").exists():
            return _elsewhere(process)
        found = _linux(process)
        for child in _children(process):
            if more := usage(child):
                found = Usage(
                    found.computed_s + more.computed_s,
                    found.queued_s + more.queued_s,
                    found.memory + more.memory,
                    found.stopped,
                    found.ready or more.ready,
                )
        return found
    except (OSError, ValueError, IndexError):
        return None


def _linux(process: int) -> Usage:
    fields = _fields(_PROC / str(process))
    ticks = sum(map(int, fields[11:15]))  # user, system, and both of children that were waited for
    queued, ready = 0, False
    with suppress(OSError):  # a kernel without statistics of its scheduler
        for thread in (_PROC / str(process) / "task").iterdir():
            with suppress(FileNotFoundError, ProcessLookupError):  # it has just ended
                ready = ready or _fields(thread)[0] == b"R"
                queued += int((thread / "schedstat").read_bytes().split()[1])
    memory = int(fields[21]) * os.sysconf("SC_PAGE_SIZE")
    computed, stopped = ticks / os.sysconf("SC_CLK_TCK"), fields[0] in b"Tt"
    return Usage(computed, queued * 1e-9, memory, stopped, ready)


def _fields(task: Path) -> list[bytes]:
    # The name, in brackets, may hold anything, brackets too.
    return (task / "stat").read_bytes().rpartition(b")")[2].split()


def _children(process: int) -> list[int]:
    found: list[int] = []
    with suppress(OSError):
        for thread in (_PROC / str(process) / "task").iterdir():
            with suppress(FileNotFoundError):
                found += map(int, (thread / "children").read_bytes().split())
    return found


def _elsewhere(process: int) -> Usage | None:
    """Measure one process, as /proc is not there."""
    import psutil

    try:
        found = psutil.Process(process)
        times, status = found.cpu_times(), found.status()
        return Usage(
            times.user + times.system,
            memory=found.memory_info().rss,
            stopped=status == psutil.STATUS_STOPPED,
            ready=status == psutil.STATUS_RUNNING,
        )
    except psutil.Error:
        return None
