"""Guarded processes: foreign code runs in them, one job at a time, within budgets.

A crash, a hang or a memory blow-up costs the job in work and nothing else. The parent ends the
process, and the job has a reason in place of an answer.
"""

from __future__ import annotations

import math
import os
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar

import psutil

from bench.plugins.registry import explain

#: Time between two looks at the memory of a process.
_WATCH_SECONDS = 0.1

S = TypeVar("S")
#: Tells the parent that the job goes on to another phase, which has the whole budget of time.
Notify = Callable[[str], None]


@dataclass(frozen=True)
class NoAnswer:
    """The fate of a job that failed: the status of its run, and a sentence with the reason."""

    status: str
    message: str


class GuardedProcess:
    """A process that answers jobs, one at a time.

    A job is a function of a module. It is called with the state of the process and arguments, and
    must not return None.

    Parameters
    ----------
    prepare
        Makes the state, once, from a `Notify` and ``arguments``.
    arguments
        For ``prepare``.
    budget_s, memory_gib
        The most that one job may take. The time of ``prepare`` does not count.
    """

    def __init__(
        self,
        prepare: Callable[..., S],
        arguments: tuple = (),
        budget_s: float = math.inf,
        memory_gib: float = math.inf,
    ) -> None:
        context = get_context("spawn")
        self._budget_s, self._memory_gib = budget_s, memory_gib
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, prepare, arguments))
        self._process.daemon = True
        self._process.start()
        theirs.close()
        self._started, self._phase = time.monotonic(), "running"
        self.alive = True

    def start(self, job: Callable[..., Any], *arguments: Any) -> None:
        """Begin a job."""
        self._started, self._phase = time.monotonic(), "running"
        with suppress(OSError):  # it is dead, as take() will find
            self._pipe.send((job, arguments))

    def take(self) -> Any:
        """Return the answer of the job, NoAnswer if it has none, None while it is in work."""
        if not self._pipe.poll():
            excess = self._excess()
            if not excess:
                return None
            self.end()
            return NoAnswer(
                "budget_exceeded",
                f"Stopped while {self._phase} because {excess}; take larger steps or tolerances, "
                f"a shorter interval, or a larger budget.",
            )
        try:
            kind, answer = self._pipe.recv()
        except (EOFError, OSError):
            self._process.join()
            code = self._process.exitcode
            how = signal.Signals(-code).name if code and code < 0 else f"exit code {code}"
            self.end()
            return NoAnswer("crashed", f"The worker process died during the run ({how}).")
        if kind == "phase":
            # Restart the clock: imports and references are not the integrator's time.
            self._started, self._phase = time.monotonic(), answer
            return None
        return NoAnswer("crashed", answer) if kind == "failed" else answer

    def ask(self, job: Callable[..., Any], *arguments: Any) -> Any:
        """Do a job and return its answer, or NoAnswer."""
        self.start(job, *arguments)
        while (answer := self.take()) is None:
            wait_for_any([self])
        return answer

    def end(self) -> None:
        """Kill the process; nothing is lost that is not elsewhere."""
        if self.alive:
            self.alive = False
            self._process.kill()
            self._process.join()
            self._pipe.close()

    def _excess(self) -> str:
        """The budget that the job has exceeded, in words."""
        if time.monotonic() - self._started > self._budget_s:
            return f"it took longer than the time budget of {self._budget_s:g} s"
        with suppress(psutil.Error):
            if psutil.Process(self._process.pid).memory_info().rss > self._memory_gib * 2**30:
                return f"it used more memory than the budget of {self._memory_gib:g} GiB"
        return ""


def wait_for_any(processes: Iterable[GuardedProcess]) -> None:
    """Return when one of the processes has something to tell, or budgets should be looked at."""
    wait([process._pipe for process in processes], timeout=_WATCH_SECONDS)


# ---- in the process --------------------------------------------------------------------
def _serve(pipe: Connection, prepare: Callable[..., Any], arguments: tuple) -> None:
    """Answer jobs until the pipe closes."""
    os.dup2(2, 1)  # prints of a plugin must not mix with an answer in JSON
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    threading.Thread(target=_end_with_parent, daemon=True).start()

    def notify(phase: str) -> None:
        pipe.send(("phase", phase))

    state = prepare(notify, *arguments)
    notify("running")
    while True:
        try:
            job, given = pipe.recv()
        except EOFError:
            return
        try:
            pipe.send(("done", job(state, *given)))
        except BrokenPipeError:
            return
        except BaseException as error:
            if os.environ.get("STEPBENCH_TRACEBACK"):
                traceback.print_exc()
            pipe.send(("failed", explain(error)))


def _end_with_parent() -> None:
    parent = parent_process()
    if parent:
        parent.join()
        os._exit(1)
