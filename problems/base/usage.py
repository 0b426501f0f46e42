"""Processors and processor time of this process."""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage


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
    for thread in Path("/proc/self/task").iterdir() if processors else ():
        with suppress(OSError):  # it has just ended
            os.sched_setaffinity(int(thread.name), processors)
