"""Guarded processes: foreign code runs in them, one job at a time, within budgets.

A crash, a hang or a run that takes all memory costs the job in work and nothing else. A process
leads a group of its own, which is killed when it is no longer wanted, and which kills itself when
this program is gone.
"""

from __future__ import annotations

import importlib
import io
import json
import math
import os
import pickle
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections import defaultdict
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, Pipe, wait
from typing import Any

# The libraries of this program are imported late: a process may be started before that.

#: Phases of a job; each has a budget of its own.
LOADING, PREPARING, REFERENCE = "loading", "preparing", "reference"
RUNNING, MEASURING = "running", "measuring"
#: Tells the parent that a job goes on to another phase, with words on it.
Notify = Callable[[str, str], None]
#: Time in s between two looks for answers, and until a process that has closed its pipe has ended.
_BETWEEN, _ENDING = 0.1, 1.0
#: The last bytes of the output of a job that are shown.
_SHOWN_BYTES = 2000
#: Signals that end a process because of its own deeds; others come from outside.
_OWN_FAULTS = frozenset({"SIGSEGV", "SIGABRT", "SIGBUS", "SIGFPE", "SIGILL", "SIGSYS", "SIGTRAP"})
_SERVE = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from bench.running.process import serve; serve(int(sys.argv[2]))"
)
#: Processor time in s for loading plugins, and at least for each phase but that and a run; these
#: may take so many budgets of a run.
LOADING_SECONDS, LEAST_SECONDS, _MORE = 60.0, 120.0, 5
#: However large its budget is, a job may do nothing for so long, in s, as threads do that wait for
#: each other; a s of computing makes up for `_REST` s.
STILL_SECONDS, _REST = 60.0, 100.0
#: Time in s between two looks at a process, and the most of it that counts: more passes if this
#: process itself is halted.
_LOOKS, _LONGEST = 0.2, 1.0
#: Neither steps nor tolerances change the memory of a run.
_LESS_MEMORY = (
    "take a smaller scene, a method with sparse tangents, or a suite with a larger memory_gib"
)


# ---- budgets -----------------------------------------------------------------------------
@dataclass(frozen=True)
class Limits:
    """The most that one job may take.

    ``budget_s`` is the processor time of a run in s; tracing and compiling, the reference of a
    scene, and the measurement of errors may each take five times as long, but at least
    `LEAST_SECONDS`. ``memory_gib`` is resident memory. ``advice`` is a clause on how to stay within
    the budget.
    """

    budget_s: float = math.inf
    memory_gib: float = math.inf
    advice: str = ""

    def seconds(self, phase: str) -> float:
        """Return the processor time in s of a phase."""
        if phase == RUNNING:
            return self.budget_s
        return LOADING_SECONDS if phase == LOADING else max(LEAST_SECONDS, _MORE * self.budget_s)


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
        if now - self._looked < _LOOKS or (use := usage(process)) is None:
            return ""
        seconds, memory = use
        computed = max(0.0, seconds - self._before)  # jobs before are not charged to this one
        passed = min(now - self._looked, _LONGEST)
        self._looked, self._before = now, seconds
        self._used[self.phase] += computed
        self._still = max(0.0, self._still + passed - _REST * computed)
        allowed = self._limits.seconds(self.phase)
        advice = "" if self.phase == LOADING else self._limits.advice
        if memory > self._limits.memory_gib * 2**30:
            reason = f"it used more memory than the budget of {self._limits.memory_gib:g} GiB"
            advice = _LESS_MEMORY
        elif self._used[self.phase] > allowed:
            reason = f"it took more than {allowed:g} s of processor time, its budget"
        elif self._still > STILL_SECONDS:
            reason = f"it did nothing for {STILL_SECONDS:g} s: it sleeps or waits"
            advice = "have it compute or return"
        else:
            return ""
        return f"{reason}; {advice}" if advice else reason


# ---- jobs --------------------------------------------------------------------------------
@dataclass(frozen=True)
class NoAnswer:
    """The fate of a job that failed, with a sentence on the reason.

    ``status`` is "crashed", "budget_exceeded", or "interrupted" if the job is not to blame;
    ``phase`` is the one in which it ended; a job has ``refused`` arguments that the user gave.
    """

    status: str
    message: str
    phase: str = ""
    refused: bool = False


class GuardedProcess:
    """A process that answers jobs, one at a time.

    A job is a function of a module. It is called with the state of the process and arguments, and
    must not return None. ``prepare`` makes the state, once, from a `Notify` and ``arguments``.
    ``on_phase`` is called with the phase to which the job goes on, and words on it.
    """

    def __init__(
        self, prepare: Callable[..., Any], arguments: tuple = (), limits: Limits | None = None
    ) -> None:
        self._process, self._pipe, self._output = _ahead.pop() if _ahead else _started()
        self._meter, self._words = Meter(limits or Limits()), "this program"
        self.on_phase: Callable[[str, str], None] = lambda phase, words: None
        self.alive, self.pid = True, self._process.pid
        self._send((prepare, arguments))

    def start(self, job: Callable[..., Any], *arguments: Any, **named: Any) -> None:
        """Begin a job."""
        self._meter.start()
        self._output.seek(0)  # its own place, too: it is the same open file
        self._output.truncate()
        self._send((job, arguments, named))

    def poll(self) -> Any:
        """Return the answer of the job, NoAnswer if it has none, None while it is in work."""
        try:
            ended = self._process.poll() is not None  # asked first: it may have answered before
            while self._pipe.poll():
                kind, content = self._pipe.recv()
                if kind == "done":
                    return content
                if kind != "phase":
                    return NoAnswer("crashed", content, self._meter.phase, kind == "refused")
                self._meter.phase, self._words = content
                self.on_phase(*content)
        except (OSError, EOFError):  # the end of what it said
            ended = True
        except Exception as error:  # of a class that only the process knows, say
            return self._ended("crashed", f"Its answer cannot be read: {error}.")
        doing = f"{'loading ' if self._meter.phase == LOADING else ''}{self._words}"
        if ended:
            return self._died(doing)
        if excess := self._meter.excess(self.pid):
            return self._ended("budget_exceeded", f"Stopped while {doing} because {excess}.")
        return None

    def ask(self, job: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        """Do a job and return its answer, or NoAnswer."""
        self.start(job, *arguments, **named)
        while (answer := self.poll()) is None:
            wait_for_any([self])
        return answer

    def printed(self) -> str:
        """Return the end of what the job in work, or the last one, printed."""
        from problems.base.text import shortened

        number = self._output.fileno()
        beyond = max(0, os.fstat(number).st_size - _SHOWN_BYTES)
        text = os.pread(number, _SHOWN_BYTES, beyond).decode(errors="replace").strip()
        return shortened(f"... {text}" if beyond else text)

    def end(self) -> None:
        """Kill the process and its group; nothing is lost that is not elsewhere."""
        if self.alive:
            self.alive = False
            _running.discard(self.pid)
            with suppress(OSError):
                os.killpg(self.pid, signal.SIGKILL)
            self._process.wait()
            self._pipe.close()

    def _send(self, task: tuple[Any, ...]) -> None:
        with suppress(OSError):  # it is dead, as poll() will find
            self._pipe.send(task)

    def _died(self, doing: str) -> NoAnswer:
        with suppress(subprocess.TimeoutExpired):  # it has closed its pipe, but not ended
            self._process.wait(_ENDING)
        self.end()
        code = self._process.returncode
        how = f"exit code {code}"
        if code < 0:
            with suppress(ValueError):
                how = signal.Signals(-code).name
            if how not in _OWN_FAULTS:
                words = f"The process was killed from outside while {doing} ({how})."
                return self._ended("interrupted", words)
        last = self.printed().splitlines()[-1:]
        said = f" Its last words: {last[0][-300:]}" if last else ""
        return self._ended("crashed", f"The process died while {doing} ({how}).{said}")

    def _ended(self, status: str, text: str) -> NoAnswer:
        self.end()
        return NoAnswer(status, text, self._meter.phase)


def wait_for_any(processes: Iterable[GuardedProcess]) -> None:
    """Return when one of the processes has something to tell, or budgets should be looked at."""
    wait([process._pipe for process in processes], timeout=_BETWEEN)


# ---- processes ---------------------------------------------------------------------------
#: Numbers of processes that live, and processes that wait for what they have to do.
_running: set[int] = set()
_ahead: list[tuple[subprocess.Popen, Connection, Any]] = []


def start_ahead(module: str) -> None:
    """Start the process of the next `GuardedProcess`, and have it load a module and JAX."""
    with suppress(OSError):  # no process may be started; who needs one will say it
        _ahead.append(_started())
        _ahead[0][1].send((_load_libraries, (module,)))


def end_all() -> None:
    """Kill all processes, as this program ends."""
    for process in [*_running]:
        with suppress(OSError):
            os.killpg(process, signal.SIGKILL)


def _started() -> tuple[subprocess.Popen, Connection, Any]:
    ours, theirs = Pipe()
    output = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - as long as the process
    process = subprocess.Popen(
        [sys.executable, "-c", _SERVE, json.dumps(sys.path), str(theirs.fileno())],
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=output,
        pass_fds=(theirs.fileno(),),
        start_new_session=True,  # signals of the terminal are for this process alone
    )
    theirs.close()
    _running.add(process.pid)
    return process, ours, output


# ---- inside a process --------------------------------------------------------------------
def serve(descriptor: int) -> None:
    """Answer jobs until the program that started this process is gone."""
    pipe, state = Connection(descriptor), None
    os.set_inheritable(descriptor, False)  # by programs that a plugin starts
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    threading.Thread(target=_end_with_parent, args=(descriptor,), daemon=True).start()

    def notify(phase: str, words: str) -> None:
        pipe.send(("phase", (phase, words)))

    with suppress(EOFError, ConnectionError):
        while True:
            job, arguments, *named = pipe.recv()
            if named:
                notify(RUNNING, "running")
                pipe.send_bytes(_answered(job, state, arguments, *named))
                continue
            try:
                notify(LOADING, "this program")
                state = job(notify, *arguments)
            except Exception as error:
                from bench.plugins.registry import why

                sys.exit(why(error))  # its last words are the reason
    os._exit(0)


def _end_with_parent(descriptor: int) -> None:
    """Wait until the other end of the pipe is closed, whatever this process is doing."""
    watched = select.poll()
    watched.register(descriptor, 0)
    watched.poll()
    os.killpg(0, signal.SIGKILL)


def _answered(job: Callable[..., Any], state: Any, given: tuple, named: dict[str, Any]) -> bytes:
    """Do a job; return the message with its answer, or with the reason why it has none."""
    try:
        answer = job(state, *given, **named)
        sys.stdout.flush()
        return _packed("done", answer)
    except BaseException as error:  # a plugin may raise anything
        from bench.plugins.registry import PluginError, why
        from problems.base.checks import FalseAnswer
        from problems.base.spec import SpecError
        from problems.base.text import said

        if isinstance(error, SpecError) and not isinstance(error, FalseAnswer | PluginError):
            return _packed("refused", f"{said(error)}.")  # the user is to blame
        if os.environ.get("STEPBENCH_TRACEBACK"):
            traceback.print_exc()
        return _packed("failed", why(error))


class _Pickler(pickle.Pickler):
    """Writes scalars of NumPy as Python's numbers, which every writer of files knows."""

    def reducer_override(self, value: Any) -> Any:
        import numpy as np

        if isinstance(value, np.generic):
            return type(value.item()), (value.item(),)
        return NotImplemented


def _packed(kind: str, content: Any) -> bytes:
    buffer = io.BytesIO()
    _Pickler(buffer, pickle.HIGHEST_PROTOCOL).dump((kind, content))
    return buffer.getvalue()


def _load_libraries(notify: Notify, module: str) -> None:
    """Load a module of this program, and JAX, which takes most of the time."""
    importlib.import_module(module)
    from problems.base.runtime import jax

    with suppress(Exception):  # whoever runs something is told
        jax.jit  # noqa: B018
