"""The benchmarks of families of methods make their tables; times are not checked."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from bench.plugins.registry import Registry
from integrators import Steps
from integrators.native.step_method import NativeMethod
from problems.reference import Reference


@pytest.fixture(autouse=True)
def scripts(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(Path(__file__).parent / "benchmarks"), *sys.path])


def test_every_native_method_is_in_a_race():
    import families

    registry = Registry()
    native = {n for n in registry.integrators if isinstance(registry.integrator(n), NativeMethod)}
    scenes = families.SCENE, families.FREE, families.LIE
    raced = {scene: families.all_native(scene) for scene in scenes}
    names = {spec.partition("[")[0] for specs in raced.values() for spec in specs}
    assert names == native > {"rodas5p", "stormer_verlet", "cr"}
    assert {specs[0] for specs in raced.values()} == {families.OURS}


@pytest.mark.long
def test_tables_of_families():
    import families

    rows = families.same_step([families.OURS, "kr_alpha"], steps=5000, rounds=1)
    lines = families.same_step_table(rows).splitlines()
    cells = [cell.strip() for cell in lines[2].split("|")[1:-1]]
    assert cells[0] == f"`{families.OURS}`"
    step, run, operations, residuals = (float(cells[k].split()[0]) for k in (1, 2, 5, 7))
    assert operations > 100 * residuals > 100
    assert run == pytest.approx(5 * step, rel=0.1)  # ms of 5000 steps in µs
    assert lines[-1].startswith("- kr_alpha was left out: constraints")

    rows = families.beside_ida(families.SCENE, 1e-3, rounds=1)
    ida = next(row for row in rows if "parts_ms" in row)
    assert ida["contestant"] == "ida[callbacks=python]"
    assert min(ida["parts_ms"].values()) > 0
    assert "the library" in families.ida_table(rows)

    rows = families.beside_python(families.CarAxis(), 1e-6, families._SOLVERS[0], rounds=1)
    assert rows[0]["ratio"]["median"] == 1.0
    assert "arithmetic" in families.ida_table(rows)
    assert all(0 < row["agreement"][families._ERROR] < 0.1 for row in rows)


def test_programs_that_the_compiler_refuses_are_left_out_with_a_sentence(monkeypatch, capsys):
    import opponents

    if opponents.shutil.which("cc") is None:
        pytest.skip("no C compiler")
    monkeypatch.setattr(opponents, "_OPTIONS", ("-march=no-such-machine",))
    with pytest.raises(opponents.NotHere, match=r"The C program was left out: cc .* fails"):
        opponents.c_program()
    assert opponents.peak() is None
    assert "The peak was left out: cc" in capsys.readouterr().out


@pytest.mark.long
def test_a_method_meets_the_error_of_another():
    import opponents

    reference = Reference(opponents.SCENE, opponents.T_END)
    wanted = opponents.stepbench(opponents.OURS, Steps(2e-3), reference).error
    found = opponents.equally_accurate("park[newton=modified]", wanted, reference)
    assert wanted / 2 <= found.error <= 2 * wanted
    with pytest.raises(opponents.NotHere, match="The nearest is"):
        opponents.equally_accurate("semi_implicit_euler", 1e-9, reference)


@pytest.mark.long
def test_the_table_of_a_race_has_operations_per_second():
    import opponents
    import race

    rows = race.race("short", "gap", [opponents.stepbench(opponents.OURS, Steps(1e-2))], rounds=2)
    done = 1e-9 * rows[0]["work"]["operations"] / np.median(rows[0]["seconds"])
    assert rows[0]["gflops"] == pytest.approx(done)
    line = race.table(rows, race.Peak(2 * done, done)).splitlines()[-1]
    assert line.endswith(f"| {done:.2f} (50.0%) |")


def test_pairs_that_seconds_and_operations_order_differently_have_a_reason():
    import ranks

    slow = ranks.Timed("slow", 3e-6, {"method": 90.0, "solves": 10.0})
    fast = ranks.Timed("fast", 2e-6, {"factorisations": 150.0})
    near = ranks.Timed("near", 2.5e-6, {"method": 120.0})
    assert ranks.pairs([fast, near, slow]) == [
        (slow, fast)
    ]  # 1.5 by 1.5; 1.2 by 1.2 is less than 2
    assert ranks.correlation([fast, near, slow]) == pytest.approx(-1)
    lines = ranks.table("pendulum", [fast, near, slow]).splitlines()
    assert lines[2] == "| `slow` | 100 | 3.00 | 30.00 |"
    assert "takes 1.5 times as long as `fast`, which takes 1.5 times as many" in lines[-1]
    assert "matrices are full" in lines[-1]


def test_of_the_same_readings_the_least_repeats_where_the_mean_does_not():
    import widths

    # A run of 1 s, and its readings in six rounds: alone, and with one that is disturbed.
    quiet, busy = [[[1.0] * 4] * 6], [[[1.0, 1.0, 1.0, 1.0 + 4 * n] for n in range(6)]]
    assert widths.row("least", (quiet, busy)) == "| least | 0.0 % | 1.00 | 0.0 % | 1.00 |"
    assert widths.row("mean", (quiet, busy)) == "| mean | 0.0 % | 1.00 | 142.9 % | 3.50 |"
