"""Times of our time loop against C, a C++ code, and general-purpose solvers.

``make bench`` prints a table and writes it as JSON. Contestants run in turn, round after round, so
that a disturbance of the machine acts on all alike. A ratio is taken within a round; above 1 we are
faster. The table has its median and quartiles over the rounds, and the ratio of the least times,
which is steadier on a busy machine. The times are not checked; the agreement of the results is.
Operations of our own methods per second stand beside those that one core can do at most.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from exudyn_slider_crank import exudyn_run
from opponents import (
    OURS,
    RHO,
    SCENE,
    STEPS,
    T_END,
    Contestant,
    NotHere,
    Peak,
    c_program,
    equally_accurate,
    peak,
    stepbench,
)

from bench.plugins.registry import Registry
from bench.results.environment import environment
from integrators import Steps, Tolerances
from problems.reference import Reference
from problems.runtime import use_threads
from problems.scenes.pendulum import Pendulum
from problems.scenes.spring_mass import SpringMass

#: Steps of the races at equal error in a: a coarse and a fine one.
_SIZES = (1e-3, 1e-4)
_PEERS = ("ida", "kvaerno5", "radau")
#: Methods on small scenes: steps of those at constant ones, and tolerance of the others.
_SMALL_SCENES, _SMALL_STEPS, _SMALL_RTOL = (SpringMass(), Pendulum()), 20_000, 1e-8
_METHODS = (
    *("generalized_alpha", "generalized_alpha[newton=modified]", "hht", "newmark", "wbz"),
    *("ida", "kvaerno5", "kencarp4"),
)
#: Solutions of the same discrete equations, solved to these tolerances, differ by less.
_SAME = 1e-6


def present(*makers: Callable[[], Contestant]) -> list[Contestant]:
    """Those contestants that can run here; of the others it is said why not."""
    found = []
    for make in makers:
        try:
            found.append(make())
        except NotHere as reason:
            print(reason)
    return found


def race(title: str, agreement: str, contestants: list[Contestant], rounds: int) -> list[dict]:
    """Rows of the contestants, the first of whom is ours."""
    seconds = np.array([[one.run() for one in contestants] for _ in range(rounds)])
    ours, rows = contestants[0], []
    for one, own in zip(contestants, seconds.T, strict=True):
        ratios = np.quantile(own / seconds[:, 0], [0.5, 0.25, 0.75])
        done = one.work.get("operations")
        gap = np.linalg.norm(one.q - ours.q) / np.linalg.norm(ours.q)
        rows.append(
            {
                "race": title,
                "contestant": one.name,
                "about": one.about,
                "steps": one.steps,
                "seconds": own.tolist(),
                "work": one.work,
                "us_per_step": {
                    "median": 1e6 * float(np.median(own)) / one.steps,
                    "least": 1e6 * float(own.min()) / one.steps,
                },
                "milliseconds": {
                    "median": 1e3 * float(np.median(own)),
                    "least": 1e3 * float(own.min()),
                },
                "ratio": dict(zip(("median", "low", "high"), map(float, ratios), strict=True))
                | {"of_least": float(own.min() / seconds[:, 0].min())},
                "gflops": done and 1e-9 * done / float(np.median(own)),
                "agreement": {agreement: float(gap if one.error is None else one.error)},
            }
        )
    return rows


def same_equations(rounds: int) -> list[dict[str, Any]]:
    """Index 3, 20 000 steps: everybody solves the same discrete equations."""
    spec, steps = f"generalized_alpha[rho_inf={RHO:g}]", Steps(T_END / STEPS)
    contestants = present(
        lambda: stepbench(OURS, steps),
        lambda: stepbench(spec, steps),
        c_program,
        lambda: exudyn_run("full"),
        lambda: exudyn_run("modified"),
    )
    title = f"the same {STEPS} steps"
    rows = race(title, "difference of q at the end", contestants, rounds)
    for row in rows:
        (gap,) = row["agreement"].values()
        if not gap < _SAME:
            raise SystemExit(f"{row['contestant']} ends elsewhere than {OURS}: by {gap:.1e}.")
    return rows


def same_error(h: float, rounds: int, reference: Reference) -> list[dict[str, Any]]:
    """Solvers of other kinds at the tolerance that gives our error in a, within a factor of 2."""
    ours = stepbench(OURS, Steps(h), reference)
    peers = [lambda spec=spec: equally_accurate(spec, ours.error, reference) for spec in _PEERS]
    contestants = [ours, *present(*peers)]
    return race(f"equal error in a, h={h:g} s", "settled error in a", contestants, rounds)


def methods(rounds: int) -> list[dict[str, Any]]:
    """Methods and solvers on small scenes; they solve other discrete equations."""
    rows = []
    for scene in _SMALL_SCENES:
        start, end = scene.interval
        at = {"step": Steps((end - start) / _SMALL_STEPS), "tolerance": Tolerances(_SMALL_RTOL)}
        makers = [
            lambda spec=spec, at=at, scene=scene: stepbench(
                spec, at[Registry().integrator(spec).controls], scene=scene
            )
            for spec in _METHODS
        ]
        rows += race(scene.name, "difference of q at the end", present(*makers), rounds)
    return rows


def table(rows: list[dict[str, Any]], most: Peak | None = None) -> str:
    """The rows in Markdown, a table per race; operations beside the most that a core can do."""
    lines: list[str] = []
    for k, row in enumerate(rows):
        ((agreement, gap),) = row["agreement"].items()
        if k == 0 or row["race"] != rows[k - 1]["race"]:
            times = "ms | µs/step (least) | its time/ours (quartiles) | of the least"
            head = f"| {row['race']} | at | {times} | {agreement} | Gflop/s (of the peak) |"
            lines += ["", head, "|---|---|---:|---:|---:|---:|---:|---:|"]
        us, ratio = row["us_per_step"], row["ratio"]
        lines.append(
            f"| {row['contestant']} | {row['about']} | {row['milliseconds']['median']:.1f} "
            f"| {us['median']:.2f} ({us['least']:.2f}) "
            f"| {ratio['median']:.2f} ({ratio['low']:.2f} to {ratio['high']:.2f}) "
            f"| {ratio['of_least']:.2f} | {gap:.1e} | {_speed(row['gflops'], most)} |"
        )
    return "\n".join(lines[1:])


def _speed(rate: float | None, most: Peak | None) -> str:
    if not rate:
        return ""
    return f"{rate:.2f}" if most is None else f"{rate:.2f} ({rate / most.wide:.1%})"


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--output", type=Path, default=Path("stepbench-bench.json"))
    options.add_argument("--rounds", type=int, default=21, help="samples of each contestant")
    given = options.parse_args()
    machine = environment()
    print(f"{machine.cpu}, {machine.cores} cores, {machine.platform}")
    most = peak()
    if most is not None:
        print(f"The peak of a core: {most.wide:.1f} Gflop/s, {most.single:.1f} by single numbers.")
    rows = same_equations(given.rounds)
    reference = Reference(SCENE, T_END)
    for h in _SIZES:
        rows += same_error(h, max(3, given.rounds // 4), reference)
    rows += methods(max(3, given.rounds // 4))
    print(table(rows, most))
    record = {
        "machine": msgspec.to_builtins(machine),
        "peak_gflops": most and most._asdict(),
        "rounds": given.rounds,
        "rows": rows,
    }
    given.output.write_text(json.dumps(record, indent=1) + "\n")
    print(f"\nWritten to {given.output}.")


if __name__ == "__main__":
    use_threads(1)
    main()
