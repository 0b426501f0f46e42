"""The store: round trips, refusals, a full disk; what is missing in it."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest
from numpy.random import random
from planted import MACHINE
from small_stores import A_LONG_RUN, A_SCENE, AN_EXPERIMENT, NO_ROWS, a_record, change, filled

from bench.results.records import Plan, Rows, Study
from bench.results.store import FILE, Store, StoreError
from bench.results.studies import LongRun
from bench.running.inventory import Inventory
from bench.running.plan import ProfileFile, StudyFile, Suite, make_suite
from bench.running.process import NoAnswer
from bench.running.session import missing, result_of

NOT_A_DATABASE = "not a database, but long enough to have a header" * 50


@pytest.fixture
def shared() -> Iterator[Path]:
    """A folder that another user can reach (those of tmp_path are closed to others)."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)
        os.chmod(folder, 0o700)


@contextmanager
def no_right_to_write(folder: Path) -> Iterator[None]:
    """The folder is read-only, and the test is not root, to whom that means nothing."""
    folder.chmod(0o555)
    for file in folder.iterdir():
        file.chmod(0o444)
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(user)


def test_everything_written_is_read_back(tmp_path):
    study = Study(title="s", problem="pendulum", t_end=1.35, figures=["orders"], cells=["k"])
    plan = Plan(name="p", title="P", samples=3, budget_s=1.0, studies=[study])
    rows = Rows(t=[0.0, 0.33333333], values={"q": [[1.0, 2.0], [0.1, 1e-300]]}, notes={"n": [None]})
    long = Rows(t=[0.0, 1 / 3], values=rows.values, notes=rows.notes)  # eight digits are kept
    number = MACHINE.number
    with Store(tmp_path / "deep" / "er", create=True) as store:
        for value in (plan, MACHINE, A_SCENE, AN_EXPERIMENT, A_LONG_RUN):
            store.keep(value)
        store.save(a_record(environment=number), long)
        for k, seconds in enumerate((0.1, 0.2, 0.05)):
            store.add_sample("k", k, seconds)
    with Store(tmp_path / "deep" / "er") as store:
        assert store.plan() == plan
        assert store.environments() == {number: MACHINE}
        assert store.scenes() == {("pendulum", 1.35): A_SCENE}
        assert store.experiments() == {"e": AN_EXPERIMENT}
        assert store.values(LongRun) == {A_LONG_RUN.key: A_LONG_RUN}
        assert store.rows("k") == rows
        assert store.records()["k"] == a_record(
            environment=number, run_s=[0.1, 0.2, 0.05], rounds=[(number, k) for k in range(3)]
        )
        assert store.rows("other") == NO_ROWS
    with Store(tmp_path / "deep" / "er", create=True) as store:  # measured anew
        store.save(a_record(status="diverged"), NO_ROWS)
        assert store.records()["k"].run_s == []


def test_what_cannot_be_read_is_named_with_the_way_out(tmp_path):
    values = {"Record": "7b22", "Plan": "7b7d", "SceneRecord": "00ff", "Rows": ""}
    for kind, value in values.items():
        folder = filled(tmp_path / kind)
        change(folder, f"UPDATE results SET value = X'{value}' WHERE kind = '{kind}'")
        with Store(folder) as store, pytest.raises(StoreError, match=rf"A {kind} in.*--fresh"):
            store.rows("k"), store.records(), store.scenes()
    lost = filled(tmp_path / "lost")
    change(lost, "DROP TABLE results")
    words = r"cannot be read \(no such table: results\).*--fresh"
    with Store(lost) as store, pytest.raises(StoreError, match=words):
        store.records()
    with pytest.raises(StoreError, match="no stepbench results"):
        Store(tmp_path)
    for name, sql in (("empty", ""), ("other", "CREATE TABLE other (x)")):
        folder = tmp_path / name
        folder.mkdir()
        change(folder, sql)
        before = (folder / FILE).read_bytes()
        with pytest.raises(StoreError, match=r"no stepbench store.*--fresh"):
            Store(folder)
        assert (folder / FILE).read_bytes() == before
        assert [file.name for file in folder.iterdir()] == [FILE]


def test_a_result_that_could_not_be_read_again_is_refused_and_leaves_the_earlier_one(tmp_path):
    with Store(tmp_path, create=True) as store:
        store.save(a_record(), NO_ROWS)
        store.keep(AN_EXPERIMENT)
        for odd in ({"message": ValueError("x")}, {"errors": {"q": {"max": -1.0}}}):
            with pytest.raises(StoreError, match="cannot be stored"):
                store.save(a_record(**odd), NO_ROWS)
        with pytest.raises(StoreError, match="cannot be stored"):
            store.keep(msgspec.structs.replace(AN_EXPERIMENT, number=float("nan")))
        assert store.records() == {"k": a_record()}
        assert store.experiments() == {"e": AN_EXPERIMENT}


def test_records_come_in_the_order_of_the_plan(tmp_path):
    study = Study(title="", problem="p", t_end=1.0, figures=[], cells=["c", "a", "not yet"])
    with Store(tmp_path, create=True) as store:
        for key in ("a", "old", "c"):
            store.save(a_record(key), NO_ROWS)
        store.keep(Plan(name="p", title="", samples=1, budget_s=1.0, studies=[study]))
        assert list(store.records()) == ["c", "a", "old"]


def test_fresh_replaces_a_store_of_another_schema_and_a_damaged_file_with_its_log(tmp_path):
    change(filled(tmp_path), "PRAGMA user_version = 99")
    for create in (False, True):
        with pytest.raises(StoreError, match=r"its schema is 99, not.*--fresh"):
            Store(tmp_path, create=create)
    with Store(tmp_path, create=True, fresh=True) as store:
        assert store.plan() is None
        assert (store.records(), store.scenes(), store.environments()) == ({}, {}, {})
    (tmp_path / FILE).write_text(NOT_A_DATABASE)
    with pytest.raises(StoreError, match=r"cannot be opened.*--fresh or another --out"):
        Store(tmp_path, create=True)
    seconds = []  # names of the old files that show whether these were written to
    for suffix in ("", "-wal", "-shm"):
        (tmp_path / (FILE + suffix)).write_text(NOT_A_DATABASE)
        seconds.append(tmp_path / f"second{suffix}")
        os.link(tmp_path / (FILE + suffix), seconds[-1])
    with Store(tmp_path, create=True, fresh=True) as store:
        store.save(a_record("new"), NO_ROWS)
    with Store(tmp_path) as store:
        assert list(store.records()) == ["new"]
    assert [file.read_text() for file in seconds] == [NOT_A_DATABASE] * 3


def test_reading_changes_nothing_and_cannot_write(tmp_path):
    folder = filled(tmp_path / "50% #1?mode=rwc&x ü")  # signs of a URI
    before = {file: file.read_bytes() for file in folder.iterdir()}
    with Store(folder) as store:
        assert list(store.records()) == ["k"]
        for write in (
            lambda: store.save(a_record("other"), NO_ROWS),
            lambda: store.add_sample("k", 1, 1.0),
        ):
            with pytest.raises(StoreError, match="readonly"):
                write()
    assert {file: file.read_bytes() for file in folder.iterdir()} == before


def test_a_store_is_read_while_a_run_writes_it_and_no_other_run_does(tmp_path, stepbench):
    with Store(tmp_path, create=True) as writer, Store(tmp_path) as reader:
        writer.save(a_record(), NO_ROWS)
        assert list(reader.records()) == ["k"]
        for fresh in ([], ["--fresh"]):
            answer = stepbench("run", "quick", "--out", tmp_path, *fresh)
            assert answer.exit_code != 0
            assert f"Another run is writing into {tmp_path}; wait for its end" in answer.output
        assert set(writer.records()) == {"k"}
    with Store(tmp_path, create=True) as store:
        assert set(store.records()) == {"k"}


def test_a_read_only_folder_is_read_and_keeps_its_store(shared):
    filled(shared)
    files = set(shared.iterdir())
    with no_right_to_write(shared):
        with Store(shared) as store:
            assert store.records()["k"].run_s == [1.0]
        with pytest.raises(StoreError, match="another --out"):
            Store(shared, create=True, fresh=True)
    assert set(shared.iterdir()) == files
    with Store(shared) as store:
        assert list(store.records()) == ["k"]


def test_rows_in_a_log_that_cannot_be_read_are_not_passed_over(shared):
    with Store(shared, create=True) as store:
        store.save(a_record(), NO_ROWS)
        kept = {name: (shared / name).read_bytes() for name in (FILE, FILE + "-wal")}
    for name, content in kept.items():  # as a killed run leaves them, copied without the index
        (shared / name).write_bytes(content)
    with no_right_to_write(shared), pytest.raises(StoreError, match="cannot be opened"):
        Store(shared)


def test_a_full_disk_keeps_what_was_stored(tmp_path):
    with Store(tmp_path, create=True) as store:
        store.save(a_record("first"), NO_ROWS)
        pages = store._db.execute("PRAGMA page_count").fetchone()[0]
        store._db.execute(f"PRAGMA max_page_count = {pages + 2}")
        big = Rows(t=random(200_000).tolist(), values={})
        with pytest.raises(StoreError, match=r"cannot be written.*intact"):
            store.save(a_record("second"), big)
    with Store(tmp_path) as store:
        assert list(store.records()) == ["first"]


def test_of_the_runs_of_a_method_the_rows_of_the_finest_that_reached_the_end_are_kept(tmp_path):
    rows = Rows(t=[1.0])

    def kept(*runs, fingerprint=""):
        """The steps of the runs whose rows are kept, after these with (step, status)."""
        with Store(tmp_path, create=True) as store:
            for h, status in runs:
                key, more = f"pendulum | newmark | {h}", {"h": h, "status": status}
                store.save(a_record(key, fingerprint=fingerprint, **more), rows)
            return [r.h for r in store.records().values() if store.rows(r.key).t]

    assert kept((0.1, "ok")) == [0.1]
    assert kept((0.01, "diverged"), (0.05, "ok"), (0.02, "ok"), (0.08, "ok")) == [0.02]
    assert kept((0.02, "ok")) == [0.02]  # once more
    with Store(tmp_path, create=True) as store:  # others have their own
        for k, more in enumerate(({"t_end": 9.0}, {"pattern": (1.0,)}, {"integrator": "hht"})):
            record = a_record(f"pendulum | {more.get('integrator', 'newmark')} | other {k}", **more)
            store.save(record, rows)
            assert store.rows(record.key) == rows
    assert kept((0.1, "ok"), fingerprint="edited") == [0.1] * 4
    assert kept((0.05, "diverged"), fingerprint="edited") == [0.1] * 4


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
    record, rows = result_of(cell, fate)
    scene = msgspec.structs.replace(
        A_SCENE,
        t_end=cell.t_end,
        stopped="reference" if stopped else "",
        fingerprint=REGISTRY.problem("pendulum").fingerprint,
    )
    store.save(msgspec.structs.replace(record, **more), rows)
    store.keep(msgspec.structs.replace(scene, **more))


def counts(store: Store, **more: float) -> tuple[int, int]:
    """Count the cells and scenes of a suite with these budgets that are missing."""
    cells, scenes = missing(suite(**more), store)
    return len(cells), len(scenes)


def test_what_a_budget_stopped_is_run_again_with_more_and_what_went_wrong_otherwise_is_not(store):
    keep(store, budget_s=10.0, memory_gib=4.0)
    for more, count in (
        ({}, 0), ({"budget_s": 5.0, "memory_gib": 2.0}, 0), ({"budget_s": 20.0}, 1),
        ({"memory_gib": 8.0}, 1),
    ):  # fmt: skip
        assert counts(store, **more) == (count, count)
    keep(store, stopped=False, budget_s=10.0, memory_gib=4.0)
    assert counts(store, budget_s=20.0, memory_gib=8.0) == (0, 0)


def test_a_scene_is_described_again_when_the_code_of_its_record_changes(store, monkeypatch):
    keep(store)
    monkeypatch.setattr("bench.running.inventory.fingerprint", lambda made: "other")
    monkeypatch.setattr(REGISTRY, "_known", {})
    assert counts(store) == (1, 1)
