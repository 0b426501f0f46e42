"""Runs that continue: from the last stored cell, after a smaller budget, with another source."""

from __future__ import annotations

import random
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import pytest
from small_stores import A_SCENE

from bench.results.store import Store, StoreError
from bench.running.inventory import Inventory
from bench.running.plan import Suite, make_suite
from bench.running.process import NoAnswer
from bench.running.profiles import ProfileFile, StudyFile
from bench.running.session import missing_cells, missing_scenes, result_of

PROFILE = """
samples = 3
[[study]]
problems = ["spring_mass"]
t_end = 2.0
integrators = ["generalized_alpha", "newmark"]
steps = [0.1, 0.05, 0.025, 0.0125]
[[study]]
problems = ["pendulum"]
integrators = ["generalized_alpha[rho_inf=0.5]", "ida", "ida[formulation=index3,max_calls=2000]"]
steps = [0.02, 0.01, 0.005]
rtol = [1e-4, 1e-6]
"""
CELLS = 8 + 3 + 4


def start(folder: Path, *more: str) -> subprocess.Popen:
    """Run the suite as a person would, in a process of its own."""
    profile = folder / "profile.toml"
    profile.write_text(PROFILE)
    command = [sys.executable, "-m", "bench", "run", str(profile), "--out", str(folder / "out")]
    return subprocess.Popen(
        [*command, *more], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def finish(folder: Path) -> str:
    process = start(folder)
    output, _ = process.communicate(timeout=240)
    assert process.returncode == 0, output
    return output


def rows(out: Path) -> int:
    """Finished cells and samples so far, read beside the running process."""
    try:
        with Store(out) as store:
            records = store.records().values()
    except StoreError:
        return 0
    return len(records) + sum(len(record.run_s) for record in records)


def table(out: Path) -> dict[str, tuple]:
    """The final table without times."""
    with Store(out) as store:
        return {
            key: (r.status, r.message, r.errors, r.constraint, r.work, len(r.run_s))
            for key, r in store.records().items()
        }


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed")
    finish(folder)
    result = table(folder / "out")
    assert len(result) == CELLS
    return result


@pytest.mark.long
@pytest.mark.parametrize("kills", [2, 10])
def test_kills_at_random_moments_change_nothing(tmp_path, undisturbed, kills):
    chance, out = random.Random(20081), tmp_path / "out"
    for _ in range(kills):
        process = start(tmp_path)
        wanted = rows(out) + chance.randint(0, 5)
        while process.poll() is None and rows(out) < wanted:
            time.sleep(0.005)
        time.sleep(chance.random() * 0.3)
        process.kill()
        process.communicate()
        kept = table(out) if rows(out) else {}
        for key, row in kept.items():  # every row that is there is whole
            assert row[:-1] == undisturbed[key][:-1]
    finish(tmp_path)
    assert table(out) == undisturbed


@pytest.mark.long
def test_a_finished_run_measures_nothing_again(tmp_path, undisturbed):
    finish(tmp_path)
    with Store(tmp_path / "out") as store:
        before = store.records()
    assert f"0 measured now, {CELLS} kept" in finish(tmp_path)
    with Store(tmp_path / "out") as store:
        assert store.records() == before
    process = start(tmp_path, "--fresh")
    output, _ = process.communicate(timeout=240)
    assert f"{CELLS} measured now, 0 kept" in output
    assert table(tmp_path / "out") == undisturbed


REGISTRY = Inventory()
STUDY = StudyFile(problems=["pendulum"], integrators=["newmark"], steps=[0.01])


def suite(budget_s: float = 10.0, memory_gib: float = 4.0) -> Suite:
    profile = ProfileFile(study=[STUDY], budget_s=budget_s, memory_gib=memory_gib)
    return make_suite("x", profile, REGISTRY)


@pytest.fixture
def store(tmp_path):
    with Store(tmp_path, create=True) as store:
        yield store


def keep(store: Store, stopped: bool = True, **more: object) -> None:
    """Keep a cell and its scene, which a budget stopped or an error."""
    (cell,) = suite().cells.values()
    fate = NoAnswer(
        status="budget_exceeded" if stopped else "crashed", message="m", phase="running"
    )
    record, rows = result_of(cell, fate, *cell.facts(REGISTRY))
    scene = msgspec.structs.replace(
        A_SCENE,
        t_end=cell.t_end,
        stopped="reference" if stopped else "",
        fingerprint=REGISTRY.problem("pendulum").fingerprint,
    )
    store.save(msgspec.structs.replace(record, **more), rows)
    store.keep(msgspec.structs.replace(scene, **more))


def missing(store: Store, **more: float) -> tuple[int, int]:
    """Count the cells and scenes of a suite with these budgets that are missing."""
    asked = suite(**more)
    cells, scenes = missing_cells(asked, store, REGISTRY), missing_scenes(asked, store, REGISTRY)
    return len(cells), len(scenes)


def test_what_a_budget_stopped_is_run_again_with_more_and_what_went_wrong_otherwise_is_not(store):
    keep(store, budget_s=10.0, memory_gib=4.0)
    for more, count in (
        ({}, 0), ({"budget_s": 5.0, "memory_gib": 2.0}, 0), ({"budget_s": 20.0}, 1),
        ({"memory_gib": 8.0}, 1),
    ):  # fmt: skip
        assert missing(store, **more) == (count, count)
    keep(store, stopped=False, budget_s=10.0, memory_gib=4.0)
    assert missing(store, budget_s=20.0, memory_gib=8.0) == (0, 0)


def test_a_scene_is_described_again_when_the_code_of_its_record_changes(store, monkeypatch):
    keep(store)
    monkeypatch.setattr("bench.running.inventory.fingerprint", lambda made: "other")
    monkeypatch.setattr(REGISTRY, "_known", {})
    assert missing(store) == (1, 1)
