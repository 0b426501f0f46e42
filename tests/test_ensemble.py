"""Ensembles: every member equals a single run and does not disturb the others."""

import json
import re
import time
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from helpers import run_of, toy

from bench.plugins.registry import Registry
from bench.running.plan import resolution_of
from bench.sweeps import ensemble as members
from bench.sweeps.batch import Batch, BatchRun
from bench.sweeps.variation import find_quantity, runs_with
from integrators import Steps, Tolerances
from integrators.native.loops.kernel import Kernel
from problems import parameter
from problems.base.runtime import SPARE_THREADS
from problems.base.spec import SpecError, split_spec
from problems.scenes.oscillators import Duffing

REGISTRY = Registry()
ADAPTIVE, ENDS = "generalized_alpha_adaptive", r"(q|v|a|lam|x|xdot|y)(\d+)"


def alone(problem, integrator, h, t_end=None):
    scene, method = REGISTRY.problem(problem), REGISTRY.integrator(integrator)
    return method.prepare(scene, t_end or scene.interval[1], Steps(h)).measure()


def ensemble(scene, method, vary, fixed=None, end=None):
    values = {find_quantity(name, scene, method): np.array(v) for name, v in vary.items()}
    fixed = fixed or resolution_of(scene, method)
    return members.ensemble(scene, method, values, fixed, end or scene.interval[1])


def ends_of(found):
    """The end values by group, a row per member."""
    names = [*filter(None, (re.fullmatch(ENDS, name) for name in found.values))]
    return {
        group: np.stack([found.values[n[0]] for n in names if n[1] == group], axis=1)
        for group in dict.fromkeys(name[1] for name in names)
    }


def check_member(found, k, run, rtol):
    """A member is its single run: status, message, counts, time and end values."""
    assert (found.status[k], found.message[k]) == (run.status, run.message)
    work = {name[5:]: counts for name, counts in found.values.items() if name[:5] == "work_"}
    for name, counts in work.items():
        # Another program rounds differently, which may save or cost an iteration here and there.
        wanted = getattr(run.work, name)
        assert counts[k] == (wanted if name == "steps" else pytest.approx(wanted, rel=5e-3))
    if run.status == "ok":
        assert found.values["t"][k] == run.t[-1]
        for name, table in ends_of(found).items():
            end = getattr(run, name)[-1]
            scale = np.abs(end).max(initial=0.0) or 1.0
            assert table[k] == pytest.approx(end, rel=0, abs=rtol * scale), name


KEPT, GGL = "generalized_alpha[newton=modified,gamma=guarded]", "hht[formulation=stabilised_index2]"
PATTERN = Steps(0.1, (0.3, 0.7))


@pytest.mark.long
@pytest.mark.parametrize(
    ("problem", "integrator", "vary", "fixed", "within"),
    [
        (
            "quarter_car", "generalized_alpha",
            {"k": [2e4, 24453.1], "h": [5e-3, 1e-2], "rho_inf": [0.2, 0.5]}, Steps(0.01), 1e-11,
        ),
        ("pendulum", KEPT, {"th0": [0.5, 2.0]}, PATTERN, 1e-9),
        ("pendulum", GGL, {"newton_tol": [1e-12, 1e-4]}, PATTERN, 1e-9),
        ("spring_mass", "kvaerno5[steps=constant]", {"b": [0.0, 1.4]}, PATTERN, 1e-9),
        ("pendulum", "dopri8[steps=constant]", {"g": [5.0, 9.81]}, PATTERN, 1e-9),
        ("ramp_oscillator", "bathe_ode", {"k": [1.0, 2.0, 4.0]}, PATTERN, 1e-12),
        ("pendulum", ADAPTIVE, {"rtol": [1e-5, 1e-2], "th0": [2.0, 0.5]}, None, 1e-8),
        ("quarter_car", ADAPTIVE, {"rtol": [1e-2, 1e-4], "rho_inf": [0.4, 0.0]}, None, 1e-8),
        ("spring_mass", ADAPTIVE, {"k": [1.0, 4.0], "atol": [1e-4, 1e-6]}, None, 1e-8),
    ],
)  # fmt: skip
def test_members_are_single_runs_whatever_varies(plugins, problem, integrator, vary, fixed, within):
    registry = Registry([plugins])  # they run in numbers, too
    scene, method = registry.problem(problem), registry.integrator(integrator)
    end = scene.interval[0] + 0.5
    found = ensemble(scene, method, vary, fixed, end)
    for k, values in enumerate(zip(*vary.values(), strict=True)):
        bases, size = {"scene": split_spec(problem), "integrator": split_spec(integrator)}, {}
        for name, value in zip(vary, values, strict=True):
            owner = find_quantity(name, scene, method).owner
            (bases[owner][1] if owner in bases else size)[name] = value
        one, alone = (
            f"{name}[{','.join(f'{key}={value}' for key, value in own.items())}]"
            for name, own in bases.values()
        )
        one, alone = registry.problem(one), registry.integrator(alone)
        tolerances = Tolerances(size.get("rtol", 1e-6), size.get("atol"))
        resolution = replace(fixed, **size) if fixed else tolerances
        check_member(found, k, run_of(alone, one, resolution, end), within)
    assert "work_rejected" in found.values or fixed


def test_a_diverging_member_neither_spoils_nor_slows_the_others():
    scene = REGISTRY.problem("spring_mass[b=0]")
    method = REGISTRY.integrator("newmark[beta=0]")
    healthy = [0.1, 0.5, 1.0, 1.9]
    without = ensemble(scene, method, {"h": [*healthy, 0.7]}, end=200.0)
    found = ensemble(scene, method, {"h": [*healthy, 2.5]}, end=200.0)
    assert found.status == ["ok"] * 4 + ["diverged"]
    assert "Ended at t=52.5 s of 200 s" in found.message[4]
    assert found.values["t"][4] == pytest.approx(52.5)
    assert np.isnan(ends_of(found)["q"][4]).all()
    for name, table in ends_of(found).items():
        assert (table[:4] == ends_of(without)[name][:4]).all()
    # Newton's method ends at once the steps that a failed run takes with the others.
    blown = alone("spring_mass[b=0]", "newmark[beta=0,newton_max=1000]", 2.5, 200.0)
    assert blown.status == "diverged"
    assert blown.work.newton <= 3 * blown.work.steps


def test_a_member_that_ends_early_leaves_the_others_as_they_are():
    scene = REGISTRY.problem("pendulum")
    method = REGISTRY.integrator("generalized_alpha_adaptive[max_steps=500]")
    tolerances = [1e-2, 1e-3, 1e-7]
    found = ensemble(scene, method, {"rtol": tolerances})
    assert found.status == ["ok", "ok", "budget_exceeded"]
    assert "500 steps were used up" in found.message[2]
    assert np.isnan(ends_of(found)["q"][2]).all()
    assert found.values["work_steps"][2] + found.values["work_rejected"][2] == 500
    # It takes further steps with the others, which Newton's method ends at once.
    assert found.values["work_newton"][2] < 5 * 500
    whole = ensemble(scene, method, {"rtol": [*tolerances[:2], 1e-2]})  # the same program
    assert (ends_of(found)["q"][:2] == ends_of(whole)["q"][:2]).all()


#: With two iterations, steps have to be short; four members run in one program.
PENDULUM, TIGHT = (
    REGISTRY.problem("pendulum"),
    REGISTRY.integrator("generalized_alpha[newton_max=2]"),
)


def test_newton_failures_are_told_as_in_single_runs():
    steps, gravities = [0.001, 0.2, 0.002, 0.1], [9.0, 9.5, 10.0, 10.5]
    found = ensemble(PENDULUM, TIGHT, {"h": steps, "g": gravities})
    assert found.status == ["ok", "newton_failed", "ok", "newton_failed"]
    for k, (h, g) in enumerate(zip(steps, gravities, strict=True)):
        check_member(found, k, alone(f"pendulum[g={g}]", TIGHT.spec, h), 1e-7)


def test_ok_means_finite_values_in_every_group(monkeypatch):
    plain = Kernel.batched

    def spoiled(self, packed, rows, row_count):
        table, end = plain(self, packed, rows, row_count)
        return np.array(table) * np.where(np.arange(table.shape[2]) == 5, np.nan, 1.0), end

    monkeypatch.setattr(Kernel, "batched", spoiled)
    found = ensemble(PENDULUM, TIGHT, {"h": [0.002] * 4})  # [n, t, q1, q2, v1, v2, ...]
    assert found.status == ["diverged"] * 4
    assert found.message[0] == "It ended with values that are not finite."


def test_blocks_are_bounded_hold_runs_of_like_length_and_leave_xla_a_thread(monkeypatch):
    scene, method = REGISTRY.problem("pendulum"), REGISTRY.integrator("generalized_alpha")
    steps = np.random.default_rng(0).permutation(np.geomspace(0.01, 0.1, 10))
    runs = runs_with(scene, method, Steps(0.1), {find_quantity("h", scene, method): steps})
    batch, now, most = Batch(runs, 1.35, lanes=4), [], []
    blocks = list(batch.blocks(jobs=2))
    assert sorted(len(block.members) for block in blocks) == [2, 4, 4]
    counts = [block.counts[:, 0] for block in blocks]
    assert counts[0].min() >= counts[1].max() >= counts[1].min() >= counts[2].max()
    assert sorted(np.concatenate([block.members for block in blocks])) == list(range(10))

    def called(*given):
        now.append(given)
        most.append(len(now))
        time.sleep(0.05)  # the others come meanwhile
        return now.pop()

    # With all of XLA's threads they might wait for each other for ever (jaxlib 0.10).
    monkeypatch.setattr(batch, "_called", lambda *given: 0.0)
    monkeypatch.setattr(batch, "_block", called)
    monkeypatch.setenv("NPROC", "3")
    assert len(list(batch.blocks(jobs=8))) == 3
    assert max(most) <= 3 - SPARE_THREADS


def test_a_member_without_a_start_says_why():
    found = ensemble(PENDULUM, TIGHT, {"radial": [0.0, 0.1, 0.0, 0.0]}, Steps(0.002))
    assert found.status == ["ok", "crashed", "ok", "ok"]
    assert "violates the constraints at velocity level by 1.000e-01" in found.message[1]
    assert (ends_of(found)["q"][0] == ends_of(found)["q"][2]).all()
    assert found.values["work_steps"].tolist() == [500, 0, 500, 500]


# ---- the command -------------------------------------------------------------------------
@pytest.mark.long
def test_the_command_draws_prints_and_writes_tables_for_pandas(stepbench, tmp_path):
    line = "solve spring_mass generalized_alpha --ensemble 5 --t-end 1 --vary k:0.8..1.2"
    line = *line.split(), "--vary", "h:0.001..0.1", "-o", tmp_path / "m.csv"
    result = stepbench(*line, "--seed", "3")
    assert result.exit_code == 0, result.output
    assert "5 ok" in result.output
    assert "median" in result.output
    table = pd.read_csv(tmp_path / "m.csv")
    assert table["k"].between(0.8, 1.2).all()
    assert table["h"].between(0.001, 0.1).all()
    assert (table["status"] == "ok").all()
    answer = json.loads(stepbench(*line, "--seed", "3", "--json").stdout)
    assert answer["summary"]["q1"]["median"] == np.median(table["q1"])
    assert answer["statuses"] == {"ok": 5}
    k, h = table["k"].tolist()[2], table["h"].tolist()[2]
    run = alone(f"spring_mass[k={k}]", "generalized_alpha", h, 1.0)
    assert table["q1"][2] == pytest.approx(run.q[-1, 0], rel=1e-12)
    stepbench(*line, "--seed", "4")
    assert pd.read_csv(tmp_path / "m.csv")["k"][0] != table["k"][0]


def test_names_that_stand_for_two_things_need_their_owner():
    beta = parameter(1.0, "1", "a name that Newmark's method has, too")
    scene, method = toy("Shared", base=Duffing, beta=beta)(), REGISTRY.integrator("newmark")
    with pytest.raises(SpecError, match=r"write scene.beta or integrator.beta"):
        find_quantity("beta", scene, method)
    assert find_quantity("scene.beta", scene, method).owner == "scene"
    beta = find_quantity("integrator.beta", scene, method)
    runs = runs_with(scene, method, Steps(0.1), {beta: [0.2, 0.3]})
    assert [(run.scene.beta, run.method.beta) for run in runs] == [(1.0, 0.2), (1.0, 0.3)]
    car = REGISTRY.problem("full_car")  # h is a height of it
    with pytest.raises(SpecError, match=r"write step.h or scene.h"):
        find_quantity("h", car, method)
    assert find_quantity("step.h", car, method).owner == "step"


def test_different_programs_are_refused():
    scene = REGISTRY.problem("pendulum")
    forms = ("index3", "stabilised_index2")
    methods = [REGISTRY.integrator(f"generalized_alpha[formulation={form}]") for form in forms]
    with pytest.raises(SpecError, match="different compiled programs"):
        Batch([BatchRun(scene, method, Steps(0.1)) for method in methods], 1.35)
