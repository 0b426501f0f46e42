"""The store: round trips, refusals, and a disk that is full."""

from __future__ import annotations

import csv
import io
import json
import sqlite3

import pandas as pd
import pytest

from bench.records import Environment, Plan, Record, Rows, SceneRecord, Study, flatten, median
from bench.store import FILE, Store, StoreError


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
        "reference_error": {"q": 1e-15},
    } | more
    return Record(key=key, **given)


A_SCENE = SceneRecord(
    problem="pendulum",
    t_end=1.35,
    title="A pendulum.",
    description="",
    source="",
    parameters=[],
    coordinates=["X", "Y"],
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
        store.save(a_record(environment=number), rows)
        for k, seconds in enumerate((0.1, 0.2, 0.05)):
            store.add_sample("k", k, seconds)
    with Store(tmp_path / "deep" / "er") as store:
        assert store.plan() == plan
        assert store.environments() == {number: machine}
        assert store.scenes() == {("pendulum", 1.35): A_SCENE}
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
        store.clear()
        assert store.records() == {}


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
    (tmp_path / FILE).write_text("not a database, but long enough to have a header" * 50)
    with pytest.raises(StoreError, match="cannot be opened"):
        Store(tmp_path)


def test_a_store_of_another_schema_is_refused_with_the_way_out(tmp_path):
    Store(tmp_path, create=True).close()
    with sqlite3.connect(tmp_path / FILE) as db:
        db.execute("UPDATE meta SET value = '99' WHERE name = 'schema'")
    with pytest.raises(StoreError, match=r"schema 99.*--fresh"):
        Store(tmp_path)


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


def test_flat_rows_open_in_pandas():
    record = a_record(run_s=[0.3, 0.1, 0.2])
    row = flatten(record)
    assert row["error_q_end"] == 1e-3
    assert row["error_q_max"] is None
    assert row["work_steps"] == 10
    assert (row["run_s_median"], row["run_s_min"], row["run_s_max"]) == (0.2, 0.1, 0.3)
    assert row["pattern"] == "0.3/0.7"
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, row)
    writer.writeheader()
    writer.writerow(row)
    for frame in (
        pd.read_csv(io.StringIO(buffer.getvalue())),
        pd.read_json(io.StringIO(json.dumps([row]))),
    ):
        assert frame.loc[0, "error_q_end"] == 1e-3
        assert frame.loc[0, "integrator"] == "newmark"


def test_the_median_of_samples():
    assert median([]) is None
    assert median([3.0]) == 3.0
    assert median([4.0, 1.0, 2.0, 3.0]) == 2.5
