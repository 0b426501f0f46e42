"""Guarded processes: foreign code runs in them, one job at a time, within budgets.

A crash, a hang or a memory blow-up costs the job in work and nothing else. The process has a
keeper (`problems.keeper`), which ends it with all that it started, whatever happens to us.
"""

from __future__ import annotations

import fcntl
import json
import os
import pickle
import secrets
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

import msgspec

from bench.guard import wire
from bench.guard.limits import LOADING, Limits, Meter
from problems import keeper
from problems.plain_text import shortened
from problems.spec import SpecError

#: Time in s between two looks at the use of a process.
_WATCH_SECONDS = 0.1
#: A keeper needs less than this, in s, to end what it keeps.
_KEEPER_SECONDS = 15.0
#: Of the output of a job so many bytes are kept: the first ones, and the last ones.
_KEPT_BYTES = 1000
#: Size of the pipe for output: whoever prints much must not seem to be idle while we look around.
_PIPE_BYTES = 2**20
#: Pieces that are taken at a look: a process may write faster than we read, without an end.
_MOST_PIECES = 64
#: Signals that end a process because of its own deeds; others come from outside.
_OWN_FAULTS = frozenset({"SIGSEGV", "SIGABRT", "SIGBUS", "SIGFPE", "SIGILL", "SIGSYS", "SIGTRAP"})
#: Variable by which everything that a guarded process started is known.
_MARK = "STEPBENCH_KEPT"
_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "sys.tracebacklimit = 0; from bench.guard.serve import serve; del sys.tracebacklimit; "
    "serve(int(sys.argv[2]))"
)


class NoAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """The fate of a job that failed.

    Attributes
    ----------
    status
        "crashed", "budget_exceeded", or "interrupted" if the job is not to blame.
    message
        A sentence with the reason.
    phase
        The phase in which it ended, one of `bench.guard.limits`, with words on it.
    """

    status: str
    message: str
    phase: str = ""
    words: str = ""


class Refused(NoAnswer, frozen=True, kw_only=True):
    """A job refused its arguments, with a sentence for the user."""


class GuardedProcess:
    """A process that answers jobs, one at a time.

    A job is a function of a module, whose return annotation tells the type of its answer. It is
    called with the state of the process and arguments, and must not return None.

    Parameters
    ----------
    prepare
        Makes the state, once, from a `Notify` and ``arguments``.
    arguments
        For ``prepare``.
    limits
        The most that one job may take.

    Attributes
    ----------
    on_phase
        Called with the phase to which the job goes on, and words on it.
    """

    def __init__(
        self, prepare: Callable[..., Any], arguments: tuple = (), limits: Limits | None = None
    ) -> None:
        self._pipe, theirs = socket.socketpair()
        self._control, keepers = socket.socketpair()
        self._output, writing = os.pipe()
        with suppress(AttributeError, OSError):  # not on Linux, or the user has too many
            fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
        self._mark = secrets.token_hex(8)
        kept = str(theirs.fileno())
        command = [sys.executable, "-c", _START, json.dumps(sys.path), kept]
        keeping = [sys.executable, "-I", "-S", keeper.__file__, str(keepers.fileno()), kept]
        try:
            self._keeper = subprocess.Popen(
                [*keeping, *command],
                stdin=subprocess.DEVNULL,
                stdout=writing,
                stderr=writing,
                pass_fds=(keepers.fileno(), theirs.fileno()),
                start_new_session=True,  # signals of the terminal are for this process alone
                env=os.environ | {_MARK: self._mark},
            )
        except BaseException:  # no processes or no memory are left
            for end in (self._pipe, self._control):
                end.close()
            os.close(self._output)
            raise
        finally:
            for end in (theirs, keepers):
                end.close()
            os.close(writing)
        for descriptor in (self._pipe.fileno(), self._output):
            os.set_blocking(descriptor, False)
        self._silent = False
        self._inbox, self._news = bytearray(), bytearray()
        self._limits = limits or Limits()
        self._meter, self._words = Meter(self._limits), "this program"
        self._job: Callable[..., Any] | None = None
        self._printed = bytearray()
        self.on_phase: Callable[[str, str], None] = lambda phase, words: None
        self.alive = True
        self._send((prepare, arguments))

    def start(self, job: Callable[..., Any], *arguments: Any, **named: Any) -> None:
        """Begin a job."""
        self._job = job
        self._meter.start(self.pid)
        self._printed.clear()
        self._send((job, arguments, named))

    def poll(self) -> Any:
        """Return the answer of the job, NoAnswer if it has none, None while it is in work."""
        try:
            self._inbox += self._received()
            for message in wire.messages(self._inbox):
                if message.kind == wire.PHASE:
                    phase, self._words = wire.decode(message.content, tuple[str, str])
                    self._meter.begin(phase, self.pid if self._meter.is_due else None)
                    self.on_phase(phase, self._words)
                else:
                    return self._answer(message)
        except wire.BrokenMessage as error:
            self.end()
            return self._failed("crashed", f"Its answer cannot be read: {error}.")
        if (status := self._status()) is not None:
            return self._died(status)
        excess = self._meter.excess(self.pid) if self.pid and self._meter.is_due else None
        if not excess:
            return None
        self.end()
        doing = "" if excess.status == "interrupted" else f" while {self._doing}"
        return self._failed(excess.status, f"Stopped{doing} because {excess.reason}.")

    def ask(self, job: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        """Do a job and return its answer, or NoAnswer."""
        self.start(job, *arguments, **named)
        return self.answer()

    def answer(self) -> Any:
        """Wait for the answer of the job in work, or NoAnswer."""
        while (answer := self.poll()) is None:
            wait_for_any([self])
        return answer

    def printed(self) -> str:
        """Return the beginning and the end of what the job in work, or the last one, printed."""
        self._listen()
        text = bytes(self._printed)
        if len(text) > 2 * _KEPT_BYTES:
            text = text[:_KEPT_BYTES] + b" ... " + text[-_KEPT_BYTES:]
        return shortened(text.decode(errors="replace").strip())

    def end(self) -> None:
        """Kill the process and all that it started; nothing is lost that is not elsewhere."""
        if not self.alive:
            return
        self.alive = False
        self._listen()
        self._control.close()
        try:
            killed = self._keeper.wait(_KEEPER_SECONDS) < 0
        except subprocess.TimeoutExpired:  # somebody has halted it
            self._keeper.kill()
            killed = self._keeper.wait() < 0
        if killed:  # it could not clear up
            _kill_marked(self._mark)
        self._pipe.close()
        os.close(self._output)

    def descriptors(self) -> list[socket.socket | int]:
        """Return the descriptors on which news can come; one that is closed is always ready."""
        return [self._pipe, self._control, *([] if self._silent else [self._output])]

    @property
    def pid(self) -> int | None:
        """The number of the process, once its keeper has told it."""
        with suppress(BlockingIOError, OSError):
            self._news += self._control.recv(64, socket.MSG_DONTWAIT)
        return struct.unpack_from("i", self._news)[0] if len(self._news) >= 4 else None

    # ---- parts -------------------------------------------------------------------------
    def _send(self, task: tuple[Any, ...]) -> None:
        self._pipe.setblocking(True)
        with suppress(OSError):  # it is dead, as poll() will find
            self._pipe.sendall(pickle.dumps(task))
        with suppress(OSError):
            self._pipe.setblocking(False)

    def _received(self) -> bytes:
        self._listen()
        pieces = []
        with suppress(BlockingIOError, OSError):
            while len(pieces) < _MOST_PIECES and (piece := self._pipe.recv(2**20)):
                pieces.append(piece)
        return b"".join(pieces)

    def _listen(self) -> None:
        """Take what was printed, of which little is kept."""
        with suppress(BlockingIOError, OSError):
            for _ in range(_MOST_PIECES):
                piece = os.read(self._output, 2**16)
                if not piece:
                    self._silent = True  # all writers have closed it
                    break
                self._printed += piece
                if len(self._printed) > 4 * _KEPT_BYTES:
                    del self._printed[_KEPT_BYTES + 1 : -_KEPT_BYTES]

    def _status(self) -> int | None:
        """The wait status of the process if it has ended."""
        keeper_ended = self._keeper.poll() is not None  # asked first: it says the status before
        if self.pid and len(self._news) >= 8:
            return struct.unpack_from("i", self._news, 4)[0]
        # A keeper that was killed says nothing; the process has ended with it.
        return signal.SIGKILL if keeper_ended else None

    def _answer(self, message: wire.Message) -> Any:
        if message.kind == wire.DONE and self._job:
            return wire.decode(message.content, wire.answer_type(self._job))
        text = wire.decode(message.content, str)
        if message.kind == wire.REFUSED:
            return Refused(status="crashed", message=text, phase=self._meter.phase)
        return self._failed("crashed", text)

    def _died(self, status: int) -> NoAnswer:
        self.end()
        if self._keeper.returncode > 0:
            said = self.printed().partition("\n")[0]
            reason = said or f"its keeper ended with exit code {self._keeper.returncode}"
            return self._failed("interrupted", f"The process cannot be started: {reason}.")
        code = os.waitstatus_to_exitcode(status)
        how = f"exit code {code}"
        if code < 0:
            with suppress(ValueError):
                how = signal.Signals(-code).name
            if how not in _OWN_FAULTS:
                return self._failed(
                    "interrupted",
                    f"The process was killed from outside while {self._doing} ({how}).",
                )
        last = self.printed().splitlines()[-1:]
        said = f" Its last words: {last[0][-300:]}" if last else ""
        return self._failed("crashed", f"The process died while {self._doing} ({how}).{said}")

    @property
    def _doing(self) -> str:
        return f"loading {self._words}" if self._meter.phase == LOADING else self._words

    def _failed(self, status: str, text: str) -> NoAnswer:
        return NoAnswer(status=status, message=text, phase=self._meter.phase, words=self._words)


def wait_for_any(processes: Iterable[GuardedProcess]) -> None:
    """Return when one of the processes has something to tell, or budgets should be looked at."""
    wait([end for process in processes for end in process.descriptors()], timeout=_WATCH_SECONDS)


def ask_once(
    about: str,
    prepare: Callable[..., Any],
    arguments: tuple,
    limits: Limits,
    job: Callable[..., Any],
    *given: Any,
) -> Any:
    """Do one job in a process of its own and return its answer.

    Raises
    ------
    SpecError
        If the job refuses its arguments, or has no answer; then the message begins with ``about``.
    """
    process = GuardedProcess(prepare, arguments, limits)
    try:
        answer = process.ask(job, *given)
        if printed := process.printed():
            print(printed, file=sys.stderr)
    finally:
        process.end()
    if isinstance(answer, Refused):
        raise SpecError(answer.message)
    if isinstance(answer, NoAnswer):
        raise SpecError(f"{about}: {answer.message}")
    return answer


def _kill_marked(mark: str) -> None:
    """Kill all processes that inherited a mark from a guarded process (Linux only)."""
    wanted = f"{_MARK}={mark}".encode()
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if wanted in (entry / "environ").read_bytes():
                os.kill(int(entry.name), signal.SIGKILL)
