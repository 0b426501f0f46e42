"""Programs that are asked something, such as a compiler: none may hang, or stay behind."""

from __future__ import annotations

import os
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Sequence

from problems import keeper
from problems.usage import Usage, idle_seconds, usage

#: Time in s that a program may be idle, less than any process of ours may be, and may compute.
_IDLE, _COMPUTING = 5.0, 90.0
#: Time in s between two looks at a program.
_BETWEEN = 0.5


def run_program(command: Sequence[str], **variables: str) -> subprocess.CompletedProcess[bytes]:
    """Run a program, and end it with all that it started if it hangs or this process ends.

    Parameters
    ----------
    command
        The program and its arguments.
    variables
        Are added to the environment.

    Raises
    ------
    TimeoutError
        If it did nothing for 5 s, or computed for more than 90 s.
    OSError
        If it cannot be started.
    """
    ours, theirs = socket.socketpair()
    control = theirs.fileno()
    keeping = [sys.executable, "-I", "-S", keeper.__file__, str(control), "0", *command]
    with (
        subprocess.Popen(
            keeping,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            pass_fds=(control,),
            start_new_session=True,
            env=os.environ | variables,
        ) as process,
        ours,  # closed first: then its keeper ends it
    ):
        theirs.close()
        output, errors = _communicated(process, command[0])
        news = ours.recv(64)
    if len(news) < 8:
        raise OSError(errors.decode(errors="replace").strip())
    code = os.waitstatus_to_exitcode(struct.unpack("ii", news)[1])
    return subprocess.CompletedProcess(command, code, output, errors)


def _communicated(process: subprocess.Popen[bytes], name: str) -> tuple[bytes, bytes]:
    """All that a program says until its end."""
    before, idle, looked = Usage(), 0.0, time.monotonic()
    while True:
        try:
            return process.communicate(timeout=_BETWEEN)
        except subprocess.TimeoutExpired:
            now, use = time.monotonic(), usage(process.pid) or before
            idle += idle_seconds(before, use, now - looked)
            before, looked = use, now
            if idle > _IDLE:
                raise TimeoutError(f"{name} did nothing for {_IDLE:g} s") from None
            if use.computed_s > _COMPUTING:
                raise TimeoutError(f"{name} took more than {_COMPUTING:g} s") from None
