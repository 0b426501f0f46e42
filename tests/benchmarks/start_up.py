"""The first minute: `solve` and `run quick`, cold and warm, as multiples of a bare start of JAX.

Run as ``python tests/benchmarks/start_up.py``. Each is measured after a bare start (one compiled
call of a process of its own), so that both have the same machine: its seconds, and its processor
seconds with those of all processes that it started. Cold means without kept programs.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from statistics import median

ROUNDS = 3
BARE = (
    "-c",
    "import jax; jax.config.update('jax_enable_x64', True); print(jax.jit(lambda x: x+1)(1.0))",
)
COMMANDS = {
    "solve": ("-m", "bench", "solve", "slider_crank", "generalized_alpha", "--step", "0.001"),
    "run quick": ("-m", "bench", "run", "quick", "--fresh", "--out"),
}


def seconds(arguments: tuple[str, ...], cache: str) -> tuple[float, float]:
    """Run Python with a cache; return its seconds, and the processor's."""
    command = [sys.executable, *arguments, *([f"{cache}/results"] if "--out" in arguments else [])]
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    environment = os.environ | {"XDG_CACHE_HOME": cache}
    subprocess.run(command, env=environment, check=True, capture_output=True)
    after, lasted = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - begun
    return lasted, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def compare(name: str, kept: str | None) -> None:
    """Print medians of a command, with a cache that is kept or a new one each time."""
    rounds = []
    for _ in range(ROUNDS):
        with tempfile.TemporaryDirectory() as new:
            rounds.append((seconds(BARE, new), seconds(COMMANDS[name], kept or new)))
    bare, measured = (
        [median(t) for t in zip(*times, strict=True)] for times in zip(*rounds, strict=True)
    )
    print(
        f"{name + (' warm' if kept else ' cold'):16}{measured[0]:7.1f} s{measured[1]:7.1f} s"
        f"{measured[0] / bare[0]:7.1f}{measured[1] / bare[1]:7.1f}   bare start"
        f"{bare[0]:5.2f} s{bare[1]:5.2f} s",
        flush=True,
    )


def main() -> None:
    """Print a line for each command, cold and warm."""
    print(f"{'':16}{'lasts':>9}{'computes':>9}{'as multiples':>14}")
    with tempfile.TemporaryDirectory() as kept:
        for name in COMMANDS:
            compare(name, None)
            seconds(COMMANDS[name], kept)
            compare(name, kept)


if __name__ == "__main__":
    main()
