"""Throughput of many runs by their number, on the processor and on a GPU if one is there.

    python tests/benchmarks/batches.py [--out FILE]

Each case runs in a process of its own, on the processor, and on a GPU if JAX finds one. Steps times
runs per second are those of the quickest of some rounds, the reading of the results included and
the making of the runs not. That the first runs end where they end alone, on the processor, is
asserted, and nothing about times; endings are counted.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

#: Numbers of runs; 8 192 keep all cores busy.
SIZES = {"cpu": (1, 64, 1024, 8192), "cuda": (1, 64, 1024, 8192, 65536)}
#: Scenes with the parameter that varies by a fifth, methods, and most runs.
CASES = (
    ("quarter_car", "k", "generalized_alpha", "65536"),
    ("slider_crank", "l2", "generalized_alpha", "65536"),
    ("pendulum", "th0", "semi_implicit_euler", "65536"),
    ("full_car", "m", "generalized_alpha", "64"),
)
STEPS, ROUNDS, ALONE = 200, 3, 5
#: Seconds after which a case is given up.
LONGEST = 170


def measure(problem: str, name: str, spec: str, most: str) -> None:
    """Print a line of JSON for each size of a case on the platform of this process."""
    from bench.plugins.registry import Registry
    from bench.sweeps.batch import Batch
    from bench.sweeps.variation import find_quantity, runs_with
    from integrators import Steps
    from problems.runtime import on_gpu

    registry = Registry()
    sizes = [size for size in SIZES[os.environ["JAX_PLATFORMS"]] if size <= int(most)]
    scene, method = registry.problem(problem), registry.integrator(spec)
    h, value = scene.nominal_step / 10, getattr(scene, name)
    end = scene.interval[0] + STEPS * h
    values = np.random.default_rng(0).uniform(0.9 * value, 1.1 * value, sizes[-1])
    axis = find_quantity(name, scene, method)
    if not on_gpu():
        alone = runs_with(scene, method, Steps(h), {axis: values[:ALONE]})
        found = [method.prepare(run.scene, end, Steps(h)).measure() for run in alone]
        print(json.dumps([0, 0.0, {}, [run.q[-1].tolist() for run in found]]), flush=True)
    for size in sizes:
        runs = runs_with(scene, method, Steps(h), {axis: values[:size]})
        batch = Batch(runs, end, lanes=size if on_gpu() else None)
        blocks, times = list(batch.blocks()), []
        for _ in range(ROUNDS):
            list(batch.blocks())
            times.append(time.perf_counter() - batch.compiled_at)
        order = np.argsort(np.concatenate([block.members for block in blocks]))
        ends = np.concatenate([block.values["q"][:, -1] for block in blocks])[order[:ALONE]]
        row = size, min(times), Counter(s for b in blocks for s in b.status), ends.tolist()
        print(json.dumps(row), flush=True)


def measured(platform: str) -> dict[tuple[str, str, int], Any]:
    """Seconds, endings and ends by scene, method and size; size 0 has the runs alone."""
    rows = {}
    for case in CASES:
        command = [sys.executable, __file__, "--one", *case]
        own = os.environ | {"JAX_PLATFORMS": platform}
        try:
            said = subprocess.run(
                command, stdout=subprocess.PIPE, env=own, timeout=LONGEST, check=True
            ).stdout
        except subprocess.TimeoutExpired as late:
            said = late.stdout or b""
            print(f"{platform}, {case[0]}: given up after {LONGEST} s.")
        for line in said.decode().splitlines():
            size, *row = json.loads(line)
            rows[case[0], case[2], size] = row
    return rows


def main() -> None:
    """Measure every platform, and print and write a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--one", nargs=4, help=argparse.SUPPRESS)
    parser.add_argument("--out", default="stepbench-batches.json", type=Path)
    asked = parser.parse_args()
    if asked.one:
        return measure(*asked.one)
    found = {"cpu": measured("cpu")}
    probe = [sys.executable, "-c", "import jax; jax.devices()"]
    on_a_gpu = os.environ | {"JAX_PLATFORMS": "cuda"}
    if not subprocess.run(probe, env=on_a_gpu, stderr=subprocess.DEVNULL).returncode:
        found["cuda"] = measured("cuda")
    print("million steps x runs per second, and how the runs ended:")
    wrong = []
    for platform, rows in found.items():
        for (problem, spec, size), (seconds, endings, ends) in rows.items():
            if size:
                rate = STEPS * size / seconds / 1e6
                print(f"{platform:5}{problem:14}{spec:22}{size:6}{rate:9.3f}  {endings}")
                alone = found["cpu"].get((problem, spec, 0))
                if alone and not np.allclose(ends, alone[-1][: len(ends)], rtol=1e-8, atol=1e-9):
                    wrong.append(f"{platform}, {problem}, {size} runs")
    rows = [[platform, *key, *row] for platform, own in found.items() for key, row in own.items()]
    asked.out.write_text(json.dumps(rows))
    if wrong:
        raise SystemExit(f"Runs end elsewhere than alone: {'; '.join(wrong)}.")


if __name__ == "__main__":
    main()
