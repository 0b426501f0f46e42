"""Timing samples as the mean, the lower quartile and the least of their runs: what repeats?

Run as ``python tests/benchmarks/widths.py``. The runs of the suite ``quick`` are timed in rounds,
beside as many busy processes as each column says, all of them from the same readings. Printed are
the median width of the intervals, relative to the time, as pages have it; and the median of the
times, relative to the least time that the run ever took.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack

from bench.plugins.registry import Registry
from bench.results.timings import FEWEST, median_interval
from bench.running.inventory import Inventory
from bench.running.measure import readings
from bench.running.plan import make_suite
from bench.running.profiles import read_profile
from bench.running.worker import Worker
from problems.runtime import use_threads
from problems.usage import undisturbed

BUSY = (0, 2)
SAMPLES: dict[str, Callable[[Sequence[float]], float]] = {
    "mean": statistics.fmean,
    "lower quartile": lambda taken: sorted(taken)[len(taken) // 4],
    "least": min,
}
#: Rounds of samples: by run, then by round, the readings.
Rounds = list[list[list[float]]]


def prepared() -> list[Callable[[], object]]:
    """Prepare the runs of the suite that reach the end."""
    worker = Worker(Registry())
    cells = make_suite(*read_profile("quick"), Inventory()).cells.values()
    good = [cell.key for cell in cells if worker.run(cell)[0].status == "ok"]
    return [worker.prepared[key].execute for key in good]


def measured(runs: Sequence[Callable[[], object]], rounds: int, busy: int) -> Rounds:
    """Take rounds of samples beside so many busy processes."""
    with ExitStack() as ends:
        for _ in range(busy):
            other = subprocess.Popen([sys.executable, "-S", "-c", "while True: sum(range(10**6))"])
            ends.callback(other.wait)
            ends.callback(other.kill)
        ends.enter_context(undisturbed())
        taken = [[readings(run) for run in runs] for _ in range(rounds)]
    return [list(samples) for samples in zip(*taken, strict=True)]


def row(name: str, found: Sequence[Rounds]) -> str:
    """Widths and times of a kind of sample, beside fewer and more processes."""
    least = [min(t for r in every for s in r for t in s) for every in zip(*found, strict=True)]
    cells = []
    for rounds in found:
        widths, times = [], []
        for run, best in zip(rounds, least, strict=True):
            samples = [SAMPLES[name](taken) for taken in run]
            low, high = median_interval(samples)
            widths.append((high - low) / statistics.median(samples))
            times.append(statistics.median(samples) / best)
        cells += [f"{100 * statistics.median(widths):.1f} %", f"{statistics.median(times):.2f}"]
    return f"| {name} | {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    runs = prepared()
    found = [measured(runs, FEWEST, busy) for busy in BUSY]
    heads = (f"beside {busy}: width | time" for busy in BUSY)
    print(f"| {len(runs)} runs: a sample is the | {' | '.join(heads)} |")
    print("|---|" + "---:|---:|" * len(BUSY))
    for name in SAMPLES:
        print(row(name, found))


if __name__ == "__main__":
    use_threads(1)
    main()
