"""Throughput of many runs by their number, on the processor and on a GPU if one is there.

    python tests/benchmarks/batches.py [--out FILE]

Every platform (`cpu`, and `cuda` if JAX finds such a device) runs in a process of its own. Steps
times runs per second are those of the quickest of some rounds, the reading of the results included
and the making of the runs not. That the ends agree with single runs on the processor is asserted,
nothing about times.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

#: Numbers of runs; 8 192 keep all cores busy.
SIZES = {"cpu": (1, 64, 1024, 8192), "cuda": (1, 64, 1024, 8192, 65536)}
#: Scenes with the parameter that varies by a fifth, and methods.
CASES = (
    ("quarter_car", "k", "generalized_alpha"),
    ("slider_crank", "l2", "generalized_alpha"),
    ("pendulum", "th0", "semi_implicit_euler"),
    ("full_car", "m", "generalized_alpha"),
)
STEPS, ROUNDS, SINGLE = 200, 3, 5
#: Seconds after which a case is given up.
LONGEST = 170


def measure(problem: str, name: str, spec: str) -> None:
    """Print a line of JSON for each size of a case on the platform of this process."""
    from bench.plugins.registry import Registry
    from bench.sweeps.batch import Batch
    from bench.sweeps.variation import find_quantity, runs_with
    from integrators import Steps
    from problems.runtime import jax

    registry, sizes = Registry(), SIZES[os.environ["JAX_PLATFORMS"]]
    scene, method = registry.problem(problem), registry.integrator(spec)
    h, value = scene.nominal_step / 10, getattr(scene, name)
    end = scene.interval[0] + STEPS * h
    values = np.random.default_rng(0).uniform(0.9 * value, 1.1 * value, sizes[-1])
    axis = find_quantity(name, scene, method)
    for size in sizes:
        runs = runs_with(scene, method, Steps(h), {axis: values[:size]})
        lanes = size if jax.default_backend() != "cpu" else None
        batch, started = Batch(runs, end, lanes=lanes), time.perf_counter()
        blocks = list(batch.blocks())
        compiled, times = time.perf_counter() - started, []
        for _ in range(ROUNDS):
            list(batch.blocks())
            times.append(time.perf_counter() - batch.compiled_at)
        order = np.concatenate([block.members for block in blocks])
        ends = np.concatenate([block.values["q"][:, -1] for block in blocks])
        first = ends[np.argsort(order)[:SINGLE]]
        ok = np.mean([status == "ok" for block in blocks for status in block.status])
        print(json.dumps([size, compiled, min(times), float(ok), first.tolist()]), flush=True)


def measured(platform: str) -> dict[tuple, list]:
    """Rows of a platform by scene, method and size: each case in a process of its own."""
    rows: dict[tuple, Any] = {}
    for case in CASES:
        command = ["timeout", str(LONGEST), sys.executable, __file__, "--one", *case]
        environment = os.environ | {"JAX_PLATFORMS": platform}
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, text=True, env=environment
        ) as process:
            for line in process.stdout or ():
                size, *row = json.loads(line)
                rows[case[0], case[2], size] = row
                print(platform, *case, size, *(f"{x:.4g}" for x in row[:3]), flush=True)
    return rows


def main() -> None:
    """Measure every platform, and print and write a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--one", nargs=3, help=argparse.SUPPRESS)
    parser.add_argument("--out", default="stepbench-batches.json", type=Path)
    asked = parser.parse_args()
    if asked.one:
        return measure(*asked.one)
    found = {"cpu": measured("cpu")}
    probe = [sys.executable, "-c", "import jax; jax.devices()"]
    if not subprocess.run(
        probe, env=os.environ | {"JAX_PLATFORMS": "cuda"}, stderr=subprocess.DEVNULL
    ).returncode:
        found["cuda"] = measured("cuda")
    print("million steps x runs per second:", *found)
    for key in dict.fromkeys(key for rows in found.values() for key in rows):
        rows = {platform: own[key] for platform, own in found.items() if key in own}
        print(*key, *(f"{p} {STEPS * key[2] / row[1] / 1e6:.3f}" for p, row in rows.items()))
        ends = [row[-1] for row in rows.values()]
        if not np.allclose(ends, ends[0], rtol=1e-8, atol=1e-9):
            raise SystemExit(f"{key}: the platforms disagree.")
    asked.out.write_text(json.dumps({p: [*map(list, rows.items())] for p, rows in found.items()}))


if __name__ == "__main__":
    main()
