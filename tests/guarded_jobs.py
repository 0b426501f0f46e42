"""Jobs of guarded processes for test_guard.py."""

from __future__ import annotations

import os
import signal
import subprocess
import time

import numpy as np

from bench.guard.limits import REFERENCE
from bench.guard.serve import Notify
from problems.spec import SpecError


def prepare(notify: Notify, number: int) -> tuple[Notify, int]:
    return notify, number


def add(state: tuple, one: int, two: int = 0) -> int:
    return state[1] + one + two


def numbers(state: tuple) -> np.ndarray:
    return np.array([[1.0, np.nan], [np.inf, -0.0]])


def another_type(state: tuple) -> int:
    return "text"  # type: ignore[return-value]


def an_object(state: tuple) -> dict:
    return {"what": object()}


def raises(state: tuple) -> int:
    raise ValueError("so it goes")


def leaves(state: tuple) -> int:
    raise SystemExit(0)


def refuses(state: tuple) -> int:
    raise SpecError("No such thing.")


def prints(state: tuple) -> int:
    print("first" + "x" * 100_000 + "\x1b[31mlast")
    return 1


def computes(state: tuple, seconds: float) -> int:
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass
    return 1


def computes_a_reference(state: tuple, seconds: float) -> int:
    state[0](REFERENCE, "making the reference of x")
    return computes(state, seconds)


def hoards(state: tuple) -> int:
    hoard = [np.ones(10**7) for _ in range(8)]
    time.sleep(60)
    return len(hoard)


def sends_rubbish(state: tuple) -> int:
    for descriptor in range(3, 1000):
        try:
            os.write(descriptor, b"\xff" * 100)
        except OSError:
            continue
    return 1


def ends_by(state: tuple, number: int) -> int:
    os.kill(os.getpid(), number)
    time.sleep(60)
    return 1


def exits(state: tuple) -> int:
    os._exit(3)


def leaves_children(state: tuple) -> int:
    """Start processes that outlive this one, and keep its pipes open."""
    for alone in (False, True):
        subprocess.Popen(["sleep", "1000"], start_new_session=alone, close_fds=False)
    if os.fork() == 0:
        os.setsid()
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        time.sleep(1000)
    os._exit(4)


def starts_a_child(state: tuple) -> int:
    subprocess.Popen(["sleep", "1000"], start_new_session=True)
    return 1


def comes_back_twice(state: tuple) -> int:
    return 7 if os.fork() == 0 else 8


def closes_its_output(state: tuple, seconds: float) -> int:
    for descriptor in (1, 2):
        os.close(descriptor)
    time.sleep(seconds)
    return 1
