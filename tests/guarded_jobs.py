"""Jobs of guarded processes for test_guard.py."""

import os
import subprocess
import time

import numpy as np

from bench.running.process import REFERENCE, Notify
from problems.base.spec import SpecError


def prepare(notify: Notify, number: int) -> tuple[Notify, int]:
    return notify, number


def add(state: tuple, one: int, two: int = 0) -> int:
    return state[1] + one + two


def numbers(state: tuple) -> tuple:
    scalars = [np.float64(1.5), np.int32(2), np.bool_(True)]
    return np.array([[1.0, np.nan], [np.inf, -0.0]]), scalars


def a_function_of_its_own(state: tuple) -> object:
    return lambda: state


def raises(state: tuple) -> int:
    raise ValueError("so it goes")


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


def ends_by(state: tuple, number: int) -> int:
    os.kill(os.getpid(), number)
    time.sleep(60)
    return 1


def exits(state: tuple) -> int:
    print("it said so", flush=True)
    os._exit(3)


def sleeps(state: tuple) -> int:
    time.sleep(600)
    return 1


def leaves_a_child(state: tuple) -> int:
    """End while a child holds the pipe."""
    child = subprocess.Popen(["sleep", "1000"], close_fds=False)
    if os.fork() == 0:
        time.sleep(1000)
    print(child.pid, flush=True)
    os._exit(4)


def starts_children(state: tuple) -> list[int]:
    return [subprocess.Popen(["sleep", "1000"]).pid for _ in range(2)]
