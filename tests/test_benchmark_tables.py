"""The benchmarks race every native method and make their tables; times are not checked."""

import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from integrators import Steps
from problems.truth.reference import Reference


@pytest.fixture(autouse=True)
def scripts(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(Path(__file__).parent / "benchmarks"), *sys.path])


def test_every_native_method_is_in_a_race():
    import frame
    import race

    raced = {scene: race.all_native(scene) for scene in (race.SCENE, race.FREE, race.LIE)}
    names = {spec.partition("[")[0] for specs in raced.values() for spec in specs}
    assert names == {*frame.native_methods()} > {"rodas5p", "stormer_verlet", "cr"}
    assert {specs[0] for specs in raced.values()} == {frame.OURS}


@pytest.mark.long
def test_tables_of_races():
    import frame
    import race

    rows = race.same_step([frame.OURS, "kr_alpha"], frame.SCENE, steps=5000, rounds=1)
    ours, c, _ = rows
    lines = frame.table(rows, peak=1e3).splitlines()
    cells = [cell.strip() for cell in lines[2].split("|")[1:-1]]
    assert (cells[0], c["contestant"]) == (f"`{frame.OURS}`", "C")
    step, run, operations, residuals = (float(cells[k].split()[0]) for k in (3, 4, 7, 9))
    assert operations > 100 * residuals > 100
    assert run == pytest.approx(5 * step, rel=0.1)  # ms of 5000 steps in µs
    speed = 1e-9 * ours["operations"] / np.median(ours["seconds"])
    assert cells[-1] == f"{speed:.2f} ({speed / 1e3:.1%})"
    assert lines[-1].startswith("- kr_alpha was left out: constraints")
    rows = race.beside_python(race.CarAxis(), race.SOLVERS[0], rounds=1)
    assert rows[0]["ratio"] == "1.00 (1.00 to 1.00)"
    assert all(0 < row["error"] < 0.1 for row in rows)


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
    import frame

    reference = Reference(frame.SCENE, frame.T_END)
    wanted = frame.contestant(frame.OURS, Steps(2e-3), reference).error
    found = frame.equally_accurate("park[newton=modified]", wanted, reference)
    assert wanted / 2 <= found.error <= 2 * wanted
    with pytest.raises(frame.NotHere, match="The nearest is"):
        frame.equally_accurate("semi_implicit_euler", 1e-9, reference)


def test_pairs_that_seconds_and_operations_order_differently_are_named():
    import frame
    import race

    def row(name, seconds, bill):
        made = partial(frame.Contestant, name, "", lambda: seconds, 1, np.ones(1), work={})
        return frame.race("pendulum", [partial(made, bill=bill)], 1)[0]

    slow = row("slow", 3e-6, {"method": 90.0, "solves": 10.0})
    fast = row("fast", 2e-6, {"factorisations": 150.0})
    near = row("near", 2.5e-6, {"method": 120.0})
    said = race.comparison([fast, near, slow])
    assert said.startswith("Rank correlation of seconds and operations: -1.000.")
    # 1.5 by 1.5; 1.2 by 1.2 is less than 2
    (line,) = [line for line in said.splitlines() if line.startswith("- ")]
    assert line.startswith("- `slow` takes 1.5 times as long as `fast`, which takes 1.5 times as")
    assert "| `slow` |  | 1 | 3.00 (3.00) | 0.00 |" in frame.table([slow])
