"""The keeper of a guarded process: starts it, and ends it with everything that it started.

It is a program of its own, ``keeper.py CONTROL KEPT COMMAND...``, and needs nothing but the
standard library, so that it starts at once and no code that it guards can stop it. CONTROL is a
socket: the keeper writes the process number of the command and, when that has ended, its wait
status; it kills when anything comes or the other side is gone. KEPT are descriptors that the
command inherits, with commas between them.

On Linux the keeper adopts orphans of the command, which even a new session does not let escape,
and the command is killed by the system if the keeper dies.
"""

from __future__ import annotations

import ctypes
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
#: The keeper ends after this, in s, though the system does not end a process that it has killed.
_PATIENCE_SECONDS = 10.0
#: Signals that a person or a system sends to end a program.
_ENDING = (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


def _prctl(option: int, value: int) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


def die_with_parent() -> None:
    """Have the system kill this process when its parent ends, in any way (Linux only)."""
    _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def _begin(keeper: int) -> None:
    """Prepare the command between fork and exec."""
    os.setpgid(0, 0)
    for ending in _ENDING:
        signal.signal(ending, signal.SIG_DFL)
    die_with_parent()
    if os.getppid() != keeper:
        os._exit(1)


def main(control: socket.socket, kept: list[int], command: list[str]) -> None:
    """Keep a command until it ends or the other side of ``control`` says so or is gone."""
    for ending in (signal.SIGINT, *_ENDING):
        signal.signal(ending, signal.SIG_IGN)
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)
    woken, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    myself = os.getpid()
    try:
        started = subprocess.Popen(command, pass_fds=kept, preexec_fn=lambda: _begin(myself))
    except (OSError, subprocess.SubprocessError) as error:
        sys.exit(f"{error}")  # no processes or no memory are left
    for descriptor in (*kept, 1, 2):  # their other ends see who else holds them
        os.close(descriptor)
    worker, status = started.pid, None
    ready = select.poll()  # unlike select(), for any number of open files
    for end in (control.fileno(), woken):
        ready.register(end, select.POLLIN)
    with suppress(OSError):  # nobody listens, as select will tell
        control.sendall(struct.pack("i", worker))
    while status is None:
        if control.fileno() in dict(ready.poll()):
            break
        os.read(woken, 1024)
        status = _reap()[0].get(worker)
    status = _end(worker).get(worker, status)
    with suppress(OSError):
        control.sendall(struct.pack("i", signal.SIGKILL if status is None else status))


def _reap() -> tuple[dict[int, int], bool]:
    """Collect the children that have ended, with their wait statuses; whether others are left."""
    ended = {}
    try:
        while (found := os.waitpid(-1, os.WNOHANG)) != (0, 0):
            ended[found[0]] = found[1]
    except ChildProcessError:
        return ended, False
    return ended, True


def _end(worker: int) -> dict[int, int]:
    """Kill everything until no child is left; return the wait statuses of children."""
    ended: dict[int, int] = {}
    with suppress(OSError):
        os.killpg(worker, signal.SIGKILL)
    given_up = time.monotonic() + _PATIENCE_SECONDS
    while time.monotonic() < given_up:
        for process in _descendants(os.getpid()):
            with suppress(OSError):
                os.kill(process, signal.SIGKILL)
        found, more = _reap()
        ended |= found
        if not more:
            break
        time.sleep(0.002)
    return ended


def _descendants(ancestor: int) -> set[int]:
    """Find all processes below one; none where there is no /proc."""
    parents = {}
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            # The name, in brackets, may hold anything, brackets too.
            parents[int(entry.name)] = int(
                (entry / "stat").read_bytes().rpartition(b")")[2].split()[1]
            )
    found, due = set(), {ancestor}
    while due:
        due = {process for process, parent in parents.items() if parent in due} - found
        found |= due
    return found


if __name__ == "__main__":
    number, descriptors, *program = sys.argv[1:]
    main(socket.socket(fileno=int(number)), [*map(int, descriptors.split(","))], program)
