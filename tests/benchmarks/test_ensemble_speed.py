"""Throughput of ensembles against a loop over single runs (``make bench``).

Two loops over single runs, with the kernel compiled before and from start to end without rows:
one makes each run from its parameters, as a loop of a user does (scene, start, packing), and
takes it; the other takes runs that were made before. The ensemble is measured likewise, with and
without the making of its members, on one thread and on all, and includes the reading of the
results. Nothing is asserted about times.
"""

from __future__ import annotations

import time

import numpy as np
import pytest

from bench.axes import axis, number, varied
from bench.batch import Batch
from bench.maps import outcome_map
from bench.registry import Registry
from integrators import Steps

REGISTRY = Registry()
MEMBERS, ALONE = 1000, 50


def seconds(call, rounds=3):
    times = []
    for _ in range(rounds):
        started = time.perf_counter()
        call()
        times.append(time.perf_counter() - started)
    return min(times)


@pytest.mark.parametrize(("problem", "name"), [("quarter_car", "k"), ("pendulum", "th0")])
def test_ensemble_against_a_loop(benchmark, capsys, problem, name):
    scene, method = REGISTRY.problem(problem), REGISTRY.integrator("generalized_alpha")
    value = getattr(scene, name)
    values = np.random.default_rng(0).uniform(0.8 * value, 1.2 * value, MEMBERS)
    end, steps = scene.interval[1], Steps(scene.nominal_step)
    axis_of = number(name, scene, method)
    batch = Batch(varied(scene, method, steps, {axis_of: values}), end)
    batch.warm()

    def made(value):
        (run,) = varied(scene, method, steps, {axis_of: [value]})
        return method.prepare(run.scene, end, steps)

    singles = [made(value) for value in values[:ALONE]]

    def loop():
        for single in singles:
            single.execute()

    def whole_loop():
        for value in values[:ALONE]:
            made(value).execute()

    def whole_ensemble(jobs=None):
        runs = varied(scene, method, steps, {axis_of: values})
        return list(Batch(runs, end).blocks(jobs=jobs))

    loop()
    alone, whole = seconds(loop) / ALONE, seconds(whole_loop) / ALONE
    one = seconds(lambda: list(batch.blocks(jobs=1))) / MEMBERS
    whole_one = seconds(lambda: whole_ensemble(jobs=1)) / MEMBERS
    whole_all = seconds(whole_ensemble) / MEMBERS
    blocks = benchmark.pedantic(lambda: list(batch.blocks()), rounds=3, warmup_rounds=1)
    all_threads = benchmark.stats.stats.min / MEMBERS
    assert sum(len(block.members) for block in blocks) == MEMBERS
    benchmark.extra_info |= {
        "members": MEMBERS,
        "us_a_member": {
            "taken": {"loop": 1e6 * alone, "one_thread": 1e6 * one, "threads": 1e6 * all_threads},
            "made_and_taken": {
                "loop": 1e6 * whole, "one_thread": 1e6 * whole_one, "threads": 1e6 * whole_all
            },
        },
    }  # fmt: skip
    with capsys.disabled():
        print(
            f"\n{problem}, {MEMBERS} members of {blocks[0].counts[0, 0]:.0f} steps: "
            f"single run {1e6 * alone:.0f} us; ensemble on one thread {1e6 * one:.0f} us a member "
            f"({alone / one:.1f} times the throughput), on all threads {1e6 * all_threads:.0f} us "
            f"({alone / all_threads:.1f} times)\n"
            f"with the making of each: single run {1e6 * whole:.0f} us; ensemble on one thread "
            f"{1e6 * whole_one:.0f} us ({whole / whole_one:.1f} times), on all threads "
            f"{1e6 * whole_all:.0f} us ({whole / whole_all:.1f} times)"
        )


def test_a_map_of_200_by_200(benchmark, capsys):
    scene, method = REGISTRY.problem("pendulum"), REGISTRY.integrator("generalized_alpha")
    axes = axis("h", scene, method, (1e-3, 0.3)), axis("rho_inf", scene, method)
    found = benchmark.pedantic(lambda: outcome_map(scene, method, axes, (200, 200)), rounds=1)
    assert sum(found.counts().values()) == 40_000
    with capsys.disabled():
        print(
            f"\nmap of 200 x 200 on pendulum: {found.run_s:.1f} s, "
            f"prepared and compiled in {found.compile_s:.1f} s"
        )
