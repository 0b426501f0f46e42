"""Throughput of many runs: ensembles against a loop over single runs, a map, and sizes on a GPU.

All are compiled before; a loop makes each run from its parameters, or takes runs that were made.
Ensembles take one thread or all, and include the reading of the results. Throughput by size is
that of a process of its own, on the processor, and on a GPU if JAX finds one. Times are those of
the clock; that members end where single runs end is checked.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
from frame import Row, alone, options, spread, write

from bench.plugins.registry import Registry
from bench.running.worker import Worker
from bench.sweeps.batch import Batch
from bench.sweeps.outcome_map import outcome_map
from bench.sweeps.variation import SweepRequest, find_quantity, runs_with
from integrators import Steps
from problems.base.runtime import on_gpu

MEMBERS, ALONE = 1000, 50
#: Numbers of runs; 8 192 keep all cores busy.
SIZES = {"cpu": (1, 64, 1024, 8192), "cuda": (1, 64, 1024, 8192, 65536)}
#: Scenes with the parameter that varies, methods, and most runs.
CASES = (
    ("quarter_car", "k", "generalized_alpha", 65536),
    ("slider_crank", "l2", "generalized_alpha", 65536),
    ("pendulum", "th0", "semi_implicit_euler", 65536),
    ("full_car", "m", "generalized_alpha", 64),
)
STEPS = 200
#: Seconds after which a case is given up.
LONGEST = 170


class Varied:
    """Runs of a scene whose parameter varies by a fifth, made from values of it."""

    def __init__(self, problem: str, name: str, spec: str, h: float | None, count: int) -> None:
        registry = Registry()
        self.scene, self.method = registry.problem(problem), registry.integrator(spec)
        self.steps = Steps(h or self.scene.nominal_step / 10)
        start = self.scene.interval[0]
        self.end = self.scene.interval[1] if h else start + STEPS * self.steps.h
        value = getattr(self.scene, name)
        self.values = np.random.default_rng(0).uniform(0.9 * value, 1.1 * value, count)
        self._axis = find_quantity(name, self.scene, self.method)

    def runs(self, count: int) -> Any:
        return runs_with(self.scene, self.method, self.steps, {self._axis: self.values[:count]})

    def single(self, k: int) -> Any:
        values = {self._axis: self.values[k : k + 1]}
        (run,) = runs_with(self.scene, self.method, self.steps, values)
        return self.method.prepare(run.scene, self.end, self.steps)

    def check(self, blocks: list, count: int) -> None:
        """Compare ends of the first runs with those of single runs."""
        order = np.argsort(np.concatenate([block.members for block in blocks]))
        ends = np.concatenate([block.values["q"] for block in blocks])[order]
        for k in range(min(count, len(ends))):
            if not np.allclose(ends[k], self.single(k).measure().q[-1], rtol=1e-8, atol=1e-9):
                raise SystemExit(f"{self.scene.name}: run {k} of many ends elsewhere than alone.")


def against_a_loop(problem: str, name: str, rounds: int) -> Row:
    """Microseconds of a member in each round."""
    of = Varied(problem, name, "generalized_alpha", Registry().problem(problem).nominal_step,
                MEMBERS)  # fmt: skip
    batch, singles = Batch(of.runs(MEMBERS), of.end), [of.single(k) for k in range(ALONE)]
    of.check([*batch.blocks()], ALONE)

    def ensemble(jobs: int | None) -> Callable[[], object]:
        return lambda: [*Batch(of.runs(MEMBERS), of.end).blocks(jobs=jobs)]

    calls: dict[str, Callable[[], object]] = {
        "loop, run": lambda: [single.execute() for single in singles],
        "one thread, run": lambda: [*batch.blocks(jobs=1)],
        "all threads, run": lambda: [*batch.blocks()],
        "loop, prepare and run": lambda: [of.single(k).execute() for k in range(ALONE)],
        "one thread, prepare and run": ensemble(1),
        "all threads, prepare and run": ensemble(None),
    }
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            started = time.perf_counter()
            call()
            count = ALONE if name.startswith("loop") else MEMBERS
            times[name].append(1e6 * (time.perf_counter() - started) / count)
    print(f"{problem}, {MEMBERS} members, us a member: median; loop/this: median (quartiles)")
    for name, own in times.items():
        ratios = np.divide(times[f"loop, {name.split(', ')[1]}"], own)
        print(f"{name:28} {np.median(own):8.1f}; {spread(ratios)}", flush=True)
    return {"scene": problem, "us": times}


def by_size(case: int, rounds: int) -> None:
    """Print a row of JSON for each size of a case on the platform of this process."""
    *named, most = CASES[case]
    sizes = [size for size in SIZES[os.environ["JAX_PLATFORMS"]] if size <= most]
    of = Varied(*named, None, sizes[-1])
    for size in sizes:
        batch = Batch(of.runs(size), of.end, lanes=size if on_gpu() else None)
        blocks, times = [*batch.blocks()], []
        of.check(blocks, 5)
        for _ in range(rounds):
            list(batch.blocks())
            times.append(time.perf_counter() - batch.compiled_at)
        endings = Counter(status for block in blocks for status in block.status)
        print(json.dumps({"size": size, "seconds": min(times), "endings": endings}), flush=True)


def main() -> None:
    """Measure, print the tables, write the JSON."""
    given = options(__doc__, 7, "stepbench-many-runs.json")
    if given.one:
        return by_size(int(given.one[0]), 3)
    loops = (("quarter_car", "k"), ("pendulum", "th0"))
    rows = [against_a_loop(*named, given.rounds) for named in loops]
    nothing: dict[str, Any] = dict.fromkeys(("step", "pattern", "rtol", "atol"))
    request = SweepRequest("pendulum", "generalized_alpha", nothing, None)
    found = outcome_map(Worker(Registry()), request, ("h", "rho_inf"), ("h:1e-3..0.3",), (200, 200))
    print(f"map of 200 x 200 on pendulum: {found['run_s']:.1f} s, prepared and compiled in "
          f"{found['compile_s']:.1f} s")  # fmt: skip
    platforms, cuda = ["cpu"], os.environ | {"JAX_PLATFORMS": "cuda"}
    probe = [sys.executable, "-c", "import jax; jax.devices()"]
    if not subprocess.run(probe, env=cuda, stderr=subprocess.DEVNULL).returncode:
        platforms.append("cuda")
    print("million steps x runs per second, and how the runs ended:")
    for platform in platforms:
        own = os.environ | {"JAX_PLATFORMS": platform}
        for k, (problem, _, spec, _) in enumerate(CASES):
            for row in alone(__file__, given.rounds, k, env=own, timeout=LONGEST):
                rate = STEPS * row["size"] / row["seconds"] / 1e6
                print(f"{platform:5}{problem:14}{spec:22}{row['size']:6}{rate:9.3f}  "
                      f"{row['endings']}", flush=True)  # fmt: skip
                rows.append({"platform": platform, "scene": problem, "method": spec} | row)
    write(rows, given.out)


if __name__ == "__main__":
    main()
