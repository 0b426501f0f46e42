"""Inside a guarded process: answers the jobs of its parent, one at a time."""

from __future__ import annotations

import importlib
import io
import os
import pickle
import select
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

#: Phases of a job; each has a budget of its own.
LOADING, PREPARING, REFERENCE = "loading", "preparing", "reference"
RUNNING, MEASURING = "running", "measuring"
#: The phase in which another process makes what is needed: it may do nothing.
WAITING = "waiting"

#: Tells the parent that a job goes on to another phase, with words on it.
Notify = Callable[[str, str], None]


def serve(descriptor: int) -> None:
    """Answer jobs until this program is gone."""
    pipe = Connection(descriptor)
    os.set_inheritable(descriptor, False)  # by programs that a plugin starts
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    threading.Thread(target=_end_with_parent, args=(descriptor,), daemon=True).start()

    def notify(phase: str, words: str) -> None:
        pipe.send(("phase", (phase, words)))

    state = None
    with suppress(EOFError, ConnectionError):
        while True:
            job, *given = pipe.recv()
            if len(given) == 1:
                state = _prepared(job, notify, *given[0])
            else:
                notify(RUNNING, "running")
                pipe.send_bytes(_answered(job, state, *given))
    os._exit(0)


def _end_with_parent(descriptor: int) -> None:
    """Wait until the other end of the pipe is closed, whatever this process is doing."""
    watched = select.poll()
    watched.register(descriptor, 0)
    watched.poll()
    os.killpg(0, signal.SIGKILL)


def _prepared(prepare: Callable[..., Any], notify: Notify, *arguments: Any) -> Any:
    from bench.plugins.registry import why

    try:
        notify(LOADING, "this program")
        return prepare(notify, *arguments)
    except Exception as error:
        sys.exit(why(error))  # its last words are the reason


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


def load_libraries(notify: Notify, module: str) -> None:
    """Load a module of this program, and JAX, which takes most of the time."""
    importlib.import_module(module)
    from problems.base.runtime import jax

    with suppress(Exception):  # whoever runs something is told
        jax.jit  # noqa: B018
