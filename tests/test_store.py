"""The store: round trips, refusals, and a full disk."""

from __future__ import annotations

import json
import os
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import msgspec
import numpy as np
import pytest

from bench.results.experiments import ExperimentResult
from bench.results.records import (
    Damping,
    Environment,
    IntegratorFacts,
    Plan,
    Record,
    Rows,
    SceneRecord,
    Study,
)
from bench.results.store import FILE, Store, StoreError, set_aside_text

NOT_A_DATABASE = "not a database, but long enough to have a header" * 50
NO_ROWS = Rows(t=[], values={})
A_DAMPING = Damping(omega_h=[0.1], radius=[0.9], ratio=[None], period_error=[-0.1], fingerprint="f")


AN_EXPERIMENT = ExperimentResult(
    name="e", number=1, title="", claim="", remedy="", source="", parts=[]
)


def a_record(key="k", **more):
    given = {
        "problem": "pendulum",
        "integrator": "newmark",
        "family": "f",
        "formulation": "index3",
        "controls": "step",
        "h": 0.1,
        "pattern": (0.3, 0.7),
        "t0": 0.35,
        "t_end": 1.35,
        "status": "ok",
        "errors": {"q": {"end": 1e-3, "max": None}},
        "work": {"steps": 10},
        "constraint": {"position": 1e-12},
        "reference_error": {"q": {"end": 1e-15}},
    } | more
    return Record(key=key, **given)


A_SCENE = SceneRecord(
    problem="pendulum",
    t_end=1.35,
    title="A pendulum.",
    description="",
    source="",
    parameters=[],
    components={"q": ["X", "Y"]},
    sizes={"nq": 2},
    t0=0.35,
    reference_method="closed form",
    reference_error={"q": 1e-15},
    reference=Rows(t=[0.35], values={"q": [[0.0, 1.0]]}),
)


def test_everything_written_is_read_back(tmp_path):
    plan = Plan(
        name="p",
        title="P",
        samples=3,
        budget_s=1.0,
        studies=[
            Study(title="s", problem="pendulum", t_end=1.35, figures=["convergence"], cells=["k"])
        ],
    )
    machine = Environment(
        date="now", command="c", cpu="x", cores=2, memory_gib=1.0, platform="p", versions={"a": "1"}
    )
    rows = Rows(t=[0.0, 1 / 3], values={"q": [[1.0, 2.0], [0.1, 1e-300]]})
    with Store(tmp_path / "deep" / "er", create=True) as store:
        store.save_plan(plan)
        number = store.save_environment(machine)
        store.save_scene(A_SCENE)
        store.save_damping("newmark", A_DAMPING)
        store.save_damping("forgotten", A_DAMPING)
        store.save_damping("forgotten", None)
        store.save(a_record(environment=number), rows)
        for k, seconds in enumerate((0.1, 0.2, 0.05)):
            store.add_sample("k", k, seconds)
    with Store(tmp_path / "deep" / "er") as store:
        assert store.plan() == plan
        assert store.environments() == {number: machine}
        assert store.scenes() == {("pendulum", 1.35): A_SCENE}
        assert store.damping() == {"newmark": A_DAMPING}
        assert store.rows("k") == rows
        assert store.records()["k"] == a_record(environment=number, run_s=[0.1, 0.2, 0.05])
        with pytest.raises(KeyError):
            store.rows("other")


def test_a_record_that_is_measured_anew_loses_its_old_samples(tmp_path):
    with Store(tmp_path, create=True) as store:
        store.save(a_record(), Rows(t=[], values={}))
        store.add_sample("k", 0, 1.0)
        store.save(a_record(status="diverged"), Rows(t=[], values={}))
        assert store.records()["k"].run_s == []


def test_records_come_in_the_order_of_the_plan(tmp_path):
    study = Study(title="", problem="p", t_end=1.0, figures=[], cells=["c", "a", "not yet"])
    with Store(tmp_path, create=True) as store:
        for key in ("a", "old", "c"):
            store.save(a_record(key), Rows(t=[], values={}))
        store.save_plan(Plan(name="p", title="", samples=1, budget_s=1.0, studies=[study]))
        assert list(store.records()) == ["c", "a", "old"]


def test_a_folder_without_results_is_refused(tmp_path):
    with pytest.raises(StoreError, match="no stepbench results"):
        Store(tmp_path)


def test_a_file_that_is_no_store_is_refused(tmp_path):
    (tmp_path / FILE).write_text(NOT_A_DATABASE)
    with pytest.raises(StoreError, match="cannot be opened"):
        Store(tmp_path)


def test_a_store_of_another_schema_is_refused_with_the_way_out(tmp_path):
    Store(tmp_path, create=True).close()
    with sqlite3.connect(tmp_path / FILE) as db:
        db.execute("UPDATE meta SET value = '99' WHERE name = 'schema'")
    with pytest.raises(StoreError, match=r"schema 99.*--fresh"):
        Store(tmp_path)


def change(folder: Path, sql: str) -> None:
    """Change a store behind its back."""
    with closing(sqlite3.connect(folder / FILE)) as db, db:
        db.execute(sql)


def filled(folder: Path) -> Path:
    """A folder with a store that has one of everything."""
    machine = Environment(
        date="", command="", cpu="", cores=1, memory_gib=1.0, platform="", versions={}
    )
    with Store(folder, create=True) as store:
        store.save_plan(Plan(name="p", title="", samples=1, budget_s=1.0, studies=[]))
        store.save_environment(machine)
        store.save_scene(A_SCENE)
        store.save_damping("newmark", A_DAMPING)
        store.save_experiment(AN_EXPERIMENT)
        store.save(a_record(), NO_ROWS)
        store.add_sample("k", 0, 1.0)
    return folder


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


def test_fresh_forgets_everything_in_a_good_store(tmp_path):
    filled(tmp_path)
    with Store(tmp_path, create=True, fresh=True) as store:
        assert store.plan() is None
        assert (store.records(), store.scenes(), store.environments()) == ({}, {}, {})
        store.save(a_record("new"), NO_ROWS)
    with Store(tmp_path) as store:
        assert list(store.records()) == ["new"]


def test_create_without_fresh_keeps_what_is_there(tmp_path):
    filled(tmp_path)
    with Store(tmp_path, create=True) as store:
        assert list(store.records()) == ["k"]


def test_fresh_replaces_a_damaged_file_and_its_log(tmp_path):
    (tmp_path / FILE).write_text(NOT_A_DATABASE)
    with pytest.raises(StoreError, match=r"cannot be opened.*--fresh or another --out"):
        Store(tmp_path, create=True)
    seconds = []  # names of the old files that show whether these were written to
    for suffix in ("", "-wal", "-shm"):
        (tmp_path / (FILE + suffix)).write_text(NOT_A_DATABASE)
        seconds.append(tmp_path / f"second{suffix}")
        os.link(tmp_path / (FILE + suffix), seconds[-1])
    with Store(tmp_path, create=True, fresh=True) as store:
        store.save(a_record(), NO_ROWS)
    with Store(tmp_path) as store:
        assert list(store.records()) == ["k"]
    assert [file.read_text() for file in seconds] == [NOT_A_DATABASE] * 3


def test_fresh_replaces_a_store_of_another_schema(tmp_path):
    change(filled(tmp_path), "UPDATE meta SET value = '99' WHERE name = 'schema'")
    with pytest.raises(StoreError, match="schema 99"):
        Store(tmp_path, create=True)
    Store(tmp_path, create=True, fresh=True).close()
    with Store(tmp_path) as store:
        assert store.records() == {}


def test_fresh_in_a_folder_that_cannot_be_written_is_refused_and_keeps_it(shared):
    filled(shared)
    with no_right_to_write(shared), pytest.raises(StoreError, match="another --out"):
        Store(shared, create=True, fresh=True)
    with Store(shared) as store:
        assert list(store.records()) == ["k"]


@pytest.mark.parametrize(
    "damage",
    ["X'7B22'", "X'5B5D'", "X'22FF22'", "7", "'null'", "zeroblob(9)"],
    ids=["cut", "form", "utf8", "type", "null", "zeros"],
)
@pytest.mark.parametrize(
    ("column", "read", "empty"),
    [
        ("meta SET value = {} WHERE name = 'plan'", Store.plan, None),
        ("environments SET value = {}", Store.environments, {}),
        ("scenes SET value = {}", Store.scenes, {}),
        ("damping SET value = {}", Store.damping, {}),
        ("experiments SET value = {}", Store.experiments, {}),
        ("records SET value = {}", Store.records, {}),
        ("records SET rows = {}", lambda store: store.rows("k"), NO_ROWS),
    ],
    ids=["plan", "environments", "scenes", "damping", "experiments", "records", "rows"],
)
def test_a_damaged_value_is_set_aside_and_named(tmp_path, column, read, empty, damage, request):
    change(filled(tmp_path), f"UPDATE {column.format(damage)}")
    with Store(tmp_path) as store:
        assert read(store) == empty
        (row,) = store.set_aside()
    assert row.table == request.node.callspec.id.split("-")[0]
    assert row.reason
    assert set_aside_text([row]).startswith("1 row of the store cannot be read")


def test_a_good_store_has_nothing_set_aside(tmp_path):
    with Store(filled(tmp_path)) as store:
        assert store.set_aside() == []
        assert set_aside_text([]) == ""


def test_one_spoilt_row_costs_no_other(tmp_path):
    with Store(filled(tmp_path), create=True) as store:
        store.save(a_record("other"), NO_ROWS)
        store.add_sample("other", 0, 2.0)
    change(tmp_path, "UPDATE records SET value = '{' WHERE key = 'k'")
    with Store(tmp_path) as store:
        assert store.records() == {"other": a_record("other", run_s=[2.0])}


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"h":0.1', '"h":null'),
        ('"h":0.1', '"h":-0.1'),
        ('"h":0.1', '"h":0'),
        ('"h":0.1', '"h":1e999'),
        ('"controls":"step"', '"controls":"tolerance"'),
        ("[0.3,0.7]", "[]"),
        ("0.001", "-1e-3"),
        ("0.001", '"0.001"'),
        ('"steps":10', '"steps":-1'),
        ('"steps":10', '"steps":1.5'),
        ('"steps":10', '"steps":99999999999999999999'),
        ('"key":"k"', '"key":"other"'),
        ('"key":"k",', ""),
    ],
)
def test_a_record_with_impossible_numbers_is_set_aside(tmp_path, old, new):
    change(filled(tmp_path), f"UPDATE records SET value = replace(value, '{old}', '{new}')")
    with Store(tmp_path) as store:
        assert store.records() == {}
        assert [row.table for row in store.set_aside()] == ["records"]


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        ({"t": [1.0], "values": {"q": [[1.0], [2.0]]}}, "2 values of q at 1 of t"),
        ({"t": [1.0, 2.0], "values": {"q": [[1.0], [2.0, 3.0]]}}, "rows of q have different"),
        ({"t": [1.0], "values": {}, "notes": {"h": [None, 1.0]}}, "2 values of h at 1 of t"),
    ],
)
def test_rows_that_do_not_fit_together_are_set_aside(tmp_path, rows, reason):
    change(filled(tmp_path), f"UPDATE records SET rows = '{json.dumps(rows)}'")
    with Store(tmp_path) as store:
        assert store.rows("k") == NO_ROWS
        assert reason in set_aside_text(store.set_aside())


@pytest.mark.parametrize("seconds", ["'x'", "-1.0", "0.0", "1e-300", "1e300", "9e999", "X'00'"])
def test_a_spoilt_sample_costs_no_other_and_is_taken_anew_with_its_cell(tmp_path, seconds):
    change(filled(tmp_path), f"INSERT INTO samples VALUES ('k', 1, {seconds})")
    with Store(tmp_path, create=True) as store:
        assert store.records()["k"].run_s == [1.0]
        assert [row.table for row in store.set_aside()] == ["samples"]
        store.forget_spoilt_samples()
        assert store.records()["k"].run_s == []
        assert store.set_aside() == []


def test_a_result_that_cannot_be_read_again_is_kept_as_crashed_with_the_reason(tmp_path):
    odd = [
        a_record("nan", h=float("nan")),
        a_record("numpy", work={"steps": np.int64(3)}),
        a_record("object", message=ValueError("x")),
        a_record("negative", errors={"q": {"max": -1.0}}),
    ]
    odd[0].h, odd[0].errors = 0.1, {"q": {"max": 1j}}  # type: ignore[dict-item]
    with Store(tmp_path, create=True) as store:
        for record in odd:
            store.save(record, NO_ROWS)
        store.save_scene(msgspec.structs.replace(A_SCENE, reference=Rows(t=[1.0], values=1)))
        store.save_damping("d", Damping(omega_h=[float("nan")]))
        assert store.set_aside() == []
        records = store.records()
        assert list(records) == [record.key for record in odd]
        for record in records.values():
            assert (record.status, record.h, record.errors) == ("crashed", 0.1, {})
            assert record.message.startswith("The result cannot be stored: ")
        (scene,) = store.scenes().values()
        assert "cannot be stored" in scene.description
        assert "cannot be stored" in store.damping()["d"].message


def test_a_plan_is_kept_without_unfit_facts_of_integrators(tmp_path):
    facts = {
        "odd": IntegratorFacts(title="O", orders={"q": 1.5}),  # type: ignore[dict-item]
        "none": IntegratorFacts(title="N", source=None),  # type: ignore[arg-type]
        "good": IntegratorFacts(title="G", orders={"q": 2}),
    }
    plan = Plan(name="p", title="", samples=1, budget_s=1.0, studies=[], integrators=facts)
    with Store(tmp_path, create=True) as store:
        store.save_plan(plan)
        found = store.plan()
        assert found
        assert found.integrators == {"good": facts["good"]}
        with pytest.raises(StoreError, match=r"Plan cannot be stored.*samples"):
            store.save_plan(msgspec.structs.replace(plan, samples="many"))
        assert store.plan() == found


def test_names_that_no_chart_can_show_are_cut_and_stay_different(tmp_path):
    with Store(tmp_path, create=True) as store:
        for end in "ab":
            store.save(a_record("k" * 9999 + end, integrator="i" * 9999), NO_ROWS)
        store.save_scene(msgspec.structs.replace(A_SCENE, problem="p" * 9999))
        assert store.set_aside() == []
        records = store.records()
        assert len(records) == 2
        for record in records.values():
            assert record.status == "crashed"
            assert "length <= 1000" in record.message
        assert len(store.scenes()) == 1


def test_sampled_values_that_cannot_be_read_again_cost_no_more_than_themselves(tmp_path):
    with Store(tmp_path, create=True) as store:
        store.save(a_record(), Rows(t=[0.0], values={"q": [[float("nan")]]}))
        (record,) = store.records().values()
        assert (record.status, record.errors) == ("ok", a_record().errors)
        assert record.message.startswith("Its sampled values cannot be stored: Expected `float`")
        assert store.rows("k") == NO_ROWS
        assert store.set_aside() == []


@pytest.mark.parametrize("text", ["\ud800", "\0", "\x1b[31m", "\u202e", "\x9b", "\uffff"])
def test_unfit_characters_are_replaced_and_cost_nothing(tmp_path, text):
    record = a_record(f"a{text}b", message=f"{text} \\u0000 ü 😀", integrator=text)
    with Store(tmp_path, create=True) as store:
        store.save(record, NO_ROWS)
        store.add_sample(record.key, 0, 1.0)
        store.save_scene(msgspec.structs.replace(A_SCENE, problem=text))
        (found,) = store.records().values()
        (scene,) = store.scenes().values()
        assert store.rows(found.key) == NO_ROWS
        assert store.set_aside() == []
    instead = "\ufffd[31m" if len(text) > 1 else "\ufffd"
    assert found.message == f"{instead} \\u0000 ü 😀"
    assert (found.key, found.integrator, scene.problem) == (f"a{instead}b", instead, instead)
    assert (found.status, found.run_s) == ("ok", [1.0])


def test_a_missing_table_is_named_with_the_way_out(tmp_path):
    change(filled(tmp_path), "DROP TABLE scenes")
    with (
        Store(tmp_path) as store,
        pytest.raises(StoreError, match=r"cannot be read \(no such table: scenes\).*--fresh"),
    ):
        store.scenes()


def test_a_store_from_before_there_was_a_table_is_read(tmp_path):
    for table in ("damping", "experiments"):
        change(filled(tmp_path / table), f"DROP TABLE {table}")
        with Store(tmp_path / table) as store:
            assert getattr(store, table)() == {}
            assert list(store.records()) == ["k"]


def test_a_plan_cannot_be_changed(tmp_path):
    with Store(filled(tmp_path)) as store:
        plan = store.plan()
    with pytest.raises(AttributeError):
        plan.samples = 2


def test_a_sample_without_its_record_is_set_aside(tmp_path):
    change(filled(tmp_path), "INSERT INTO samples VALUES ('lost', 0, 1.0)")
    with Store(tmp_path) as store:
        assert list(store.records()) == ["k"]
        (row,) = store.set_aside()
        assert row == ("samples", "lost, number 0", "it has no record")


def test_reading_changes_no_byte_and_cannot_write(tmp_path):
    before = (filled(tmp_path) / FILE).read_bytes()
    with Store(tmp_path) as store:
        assert list(store.records()) == ["k"]
        with pytest.raises(StoreError, match="readonly"):
            store.save(a_record("other"), NO_ROWS)
        with pytest.raises(StoreError, match="readonly"):
            store.add_sample("k", 1, 1.0)
    assert (tmp_path / FILE).read_bytes() == before


@pytest.mark.parametrize("sql", ["", "CREATE TABLE other (x)", "CREATE TABLE meta (name, value)"])
def test_a_database_that_is_no_store_is_refused_and_left_as_it_is(tmp_path, sql):
    change(tmp_path, sql)
    before = (tmp_path / FILE).read_bytes()
    with pytest.raises(StoreError, match=r"no stepbench store.*--fresh"):
        Store(tmp_path)
    assert (tmp_path / FILE).read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == [FILE]


def test_a_store_is_read_while_a_run_writes_it(tmp_path):
    with Store(tmp_path, create=True) as writer, Store(tmp_path) as reader:
        writer.save(a_record(), NO_ROWS)
        assert list(reader.records()) == ["k"]


def test_two_runs_do_not_write_into_one_folder(tmp_path, stepbench):
    with Store(tmp_path, create=True) as store:
        store.save(a_record(), NO_ROWS)
        for fresh in ([], ["--fresh"]):
            answer = stepbench("run", "quick", "--out", tmp_path, *fresh)
            assert answer.exit_code != 0
            assert f"Another run is writing into {tmp_path}; wait for its end" in answer.output
        assert set(store.records()) == {"k"}
    with Store(tmp_path, create=True) as store:
        assert set(store.records()) == {"k"}


def test_a_store_in_a_folder_with_signs_of_a_uri_is_read(tmp_path):
    folder = filled(tmp_path / "50% #1?mode=rwc&x ü")
    with Store(folder) as store:
        assert list(store.records()) == ["k"]


def test_a_store_in_a_read_only_folder_is_read(shared):
    filled(shared)
    files = set(shared.iterdir())
    with no_right_to_write(shared), Store(shared) as store:
        assert store.records()["k"].run_s == [1.0]
    assert set(shared.iterdir()) == files


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
        store.save(a_record("first"), Rows(t=[], values={}))
        pages = store._db.execute("PRAGMA page_count").fetchone()[0]
        store._db.execute(f"PRAGMA max_page_count = {pages + 2}")
        big = Rows(t=[0.1] * 200_000, values={})
        with pytest.raises(StoreError, match=r"cannot be written.*intact"):
            store.save(a_record("second"), big)
    with Store(tmp_path) as store:
        assert list(store.records()) == ["first"]
