"""Throughput of ensembles against a loop over single runs (``make bench``).

Two loops over single runs, with the kernel compiled before and from start to end without rows:
one makes each run from its parameters, as a loop of a user does (scene, start, packing), and
takes it; the other takes runs that were made before. The ensemble is measured likewise, with and
without the making of its members, on one thread and on all, and includes the reading of the
results. Ratios are taken within rounds. That the answers agree is asserted, nothing about times.
"""

from __future__ import annotations

import time

import numpy as np
import pytest

from bench.plugins.registry import Registry
from bench.sweeps.batch import Batch
from bench.sweeps.outcome_map import outcome_map
from bench.sweeps.variation import find_quantity, find_range, runs_with
from integrators import Steps

REGISTRY = Registry()
MEMBERS, ALONE = 1000, 50


def seconds(calls, rounds=7):
    """Seconds of each call in each round; in turn, so that what disturbs one disturbs all."""
    times = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            started = time.perf_counter()
            call()
            times[name].append(time.perf_counter() - started)
    return {name: np.array(own) for name, own in times.items()}


@pytest.mark.parametrize(("problem", "name"), [("quarter_car", "k"), ("pendulum", "th0")])
def test_ensemble_against_a_loop(benchmark, capsys, problem, name):
    scene, method = REGISTRY.problem(problem), REGISTRY.integrator("generalized_alpha")
    value = getattr(scene, name)
    values = np.random.default_rng(0).uniform(0.8 * value, 1.2 * value, MEMBERS)
    end, steps = scene.interval[1], Steps(scene.nominal_step)
    axis_of = find_quantity(name, scene, method)
    batch = Batch(runs_with(scene, method, steps, {axis_of: values}), end)

    def made(value):
        (run,) = runs_with(scene, method, steps, {axis_of: [value]})
        return method.prepare(run.scene, end, steps)

    singles = [made(value) for value in values[:ALONE]]

    def loop():
        for single in singles:
            single.execute()

    def whole_loop():
        for value in values[:ALONE]:
            made(value).execute()

    def whole_ensemble(jobs=None):
        runs = runs_with(scene, method, steps, {axis_of: values})
        return list(Batch(runs, end).blocks(jobs=jobs))

    # Before any time is taken: members end where single runs end.
    order = np.concatenate([block.members for block in batch.blocks()])
    ends = np.concatenate([block.values["q"][:, -1] for block in batch.blocks()])[np.argsort(order)]
    for single, end_of_member in zip(singles, ends, strict=False):
        assert np.allclose(single.measure().q[-1], end_of_member, rtol=1e-8, atol=1e-11)

    times = seconds(
        {
            "loop, taken": loop,
            "one thread, taken": lambda: list(batch.blocks(jobs=1)),
            "all threads, taken": lambda: list(batch.blocks()),
            "loop, made and taken": whole_loop,
            "one thread, made and taken": lambda: whole_ensemble(jobs=1),
            "all threads, made and taken": whole_ensemble,
        }
    )
    each = {n: 1e6 * t / (ALONE if n.startswith("loop") else MEMBERS) for n, t in times.items()}
    lines = [f"{problem}, {MEMBERS} members, us a member: median (loop/this: median, quartiles)"]
    for name, own in each.items():
        _, kind = name.split(", ")
        low, middle, high = np.quantile(each[f"loop, {kind}"] / own, (0.25, 0.5, 0.75))
        lines.append(f"{name:28} {np.median(own):8.1f} ({middle:.2f}, {low:.2f} to {high:.2f})")
        benchmark.extra_info[name] = {"us": np.median(own), "ratio": [low, middle, high]}
    benchmark.pedantic(lambda: list(batch.blocks()), rounds=3)
    with capsys.disabled():
        print("", *lines, sep="\n")


def test_a_map_of_200_by_200(benchmark, capsys):
    scene, method = REGISTRY.problem("pendulum"), REGISTRY.integrator("generalized_alpha")
    ranges = (
        find_range("h", scene, method, (1e-3, 0.3)),
        find_range("rho_inf", scene, method),
    )
    found = benchmark.pedantic(lambda: outcome_map(scene, method, ranges, (200, 200)), rounds=1)
    assert sum(found["counts"].values()) == 40_000
    with capsys.disabled():
        print(
            f"\nmap of 200 x 200 on pendulum: {found['run_s']:.1f} s, "
            f"prepared and compiled in {found['compile_s']:.1f} s"
        )
