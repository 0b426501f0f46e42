"""Cells that a suite finds missing: results of a smaller budget, or of another source."""

from __future__ import annotations

import msgspec
import pytest
from small_stores import A_SCENE

from bench.guard.process import NoAnswer
from bench.results.store import Store
from bench.running.inventory import Inventory
from bench.running.plan import Suite, make_suite
from bench.running.profiles import ProfileFile, StudyFile
from bench.running.scene_records import made_by
from bench.running.session import missing_cells, missing_scenes, result_of

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
    record, rows = result_of(cell, fate, REGISTRY)
    scene = msgspec.structs.replace(
        A_SCENE,
        t_end=cell.t_end,
        stopped="reference" if stopped else "",
        fingerprint=made_by(REGISTRY.problem("pendulum").fingerprint),
    )
    store.save(msgspec.structs.replace(record, **more), rows)
    store.save_scene(msgspec.structs.replace(scene, **more))


def missing(store: Store, **more: float) -> tuple[int, int]:
    """Count the cells and scenes of a suite with these budgets that are missing."""
    asked = suite(**more)
    cells, scenes = missing_cells(asked, store, REGISTRY), missing_scenes(asked, store, REGISTRY)
    return len(cells), len(scenes)


def test_what_a_budget_stopped_is_run_again_with_more_time_or_memory(store):
    keep(store, budget_s=10.0, memory_gib=4.0)
    assert missing(store) == (0, 0)
    assert missing(store, budget_s=5.0, memory_gib=2.0) == (0, 0)
    assert missing(store, budget_s=20.0) == (1, 1)
    assert missing(store, memory_gib=8.0) == (1, 1)


def test_what_went_wrong_otherwise_is_not_run_again(store):
    keep(store, stopped=False, budget_s=10.0, memory_gib=4.0)
    assert missing(store, budget_s=20.0, memory_gib=8.0) == (0, 0)


def test_a_memory_that_an_earlier_version_did_not_keep_is_not_raised(store):
    keep(store, budget_s=10.0)
    assert missing(store, memory_gib=8.0) == (0, 0)
    assert missing(store, budget_s=20.0) == (1, 1)


def test_a_scene_is_described_again_when_the_code_of_its_record_changes(store, monkeypatch):
    keep(store)
    monkeypatch.setattr("bench.running.scene_records.fingerprint", lambda made: "other")
    assert missing(store) == (0, 1)
