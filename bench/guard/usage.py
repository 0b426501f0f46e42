"""Use of the machine by a process and all that it started: processor time, waiting, memory."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

_PROC = Path("/proc")


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
    """

    computed_s: float = 0.0
    queued_s: float = 0.0
    memory: int = 0
    stopped: bool = False


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
                )
        return found
    except (OSError, ValueError, IndexError):
        return None


def _linux(process: int) -> Usage:
    # The name, in brackets, may hold anything, brackets too.
    fields = (_PROC / str(process) / "stat").read_bytes().rpartition(b")")[2].split()
    ticks = sum(map(int, fields[11:15]))  # user, system, and both of children that were waited for
    queued = 0
    with suppress(OSError):  # a kernel without statistics of its scheduler
        for thread in (_PROC / str(process) / "task").iterdir():
            with suppress(FileNotFoundError):  # it has just ended
                queued += int((thread / "schedstat").read_bytes().split()[1])
    memory = int(fields[21]) * os.sysconf("SC_PAGE_SIZE")
    return Usage(ticks / os.sysconf("SC_CLK_TCK"), queued * 1e-9, memory, fields[0] in b"Tt")


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
        times = found.cpu_times()
        stopped = found.status() == psutil.STATUS_STOPPED
        return Usage(times.user + times.system, 0.0, found.memory_info().rss, stopped)
    except psutil.Error:
        return None
