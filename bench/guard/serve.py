"""Inside a guarded process: answers the jobs of its parent, one at a time."""

from __future__ import annotations

import os
import pickle
import signal
import socket
import sys
import traceback
from collections.abc import Callable
from typing import Any

from bench.guard import wire
from bench.guard.limits import LOADING, RUNNING
from bench.plugins.reasons import PluginError, why
from problems.checks import FalseAnswer
from problems.plain_text import said
from problems.spec import SpecError

#: Tells the parent that a job goes on to another phase (bench.guard.limits), with words on it.
Notify = Callable[[str, str], None]


def serve(descriptor: int) -> None:
    """Answer jobs until the parent closes the socket."""
    pipe, myself = socket.socket(fileno=descriptor), os.getpid()
    tasks = pipe.makefile("rb")
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    os.set_inheritable(descriptor, False)  # by programs that a plugin starts

    def only_one() -> None:
        if os.getpid() != myself:  # a plugin has forked, and its child came here
            os._exit(1)

    def tell(kind: str, content: Any) -> None:
        only_one()
        pipe.sendall(wire.message(kind, content))

    def notify(phase: str, words: str) -> None:
        tell(wire.PHASE, (phase, words))

    def answer(job: Callable[..., Any], *given: Any, **named: Any) -> None:
        try:
            found = job(*given, **named)
            sys.stdout.flush()
            content = wire.message(wire.DONE, found)
        except BaseException as error:  # a plugin may raise anything
            if isinstance(error, SpecError) and not isinstance(error, FalseAnswer | PluginError):
                return tell(wire.REFUSED, f"{said(error)}.")  # the user is to blame
            if os.environ.get("STEPBENCH_TRACEBACK"):
                traceback.print_exc()
            tell(wire.FAILED, why(error))
        else:
            only_one()
            pipe.sendall(content)

    try:
        prepare, arguments = pickle.load(tasks)
        notify(LOADING, "this program")
        state = prepare(notify, *arguments)
        while True:
            only_one()
            job, given, named = pickle.load(tasks)
            notify(RUNNING, "running")
            answer(job, state, *given, **named)
    except (EOFError, ConnectionError):
        os._exit(0)
    except Exception as error:  # of what prepares; its last words are the reason
        sys.exit(why(error))
