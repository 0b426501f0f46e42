"""Rows of a store that cannot be read, or not be written: they are set aside and told."""

from __future__ import annotations

import json

import msgspec
import numpy as np
import pytest
from small_stores import A_SCENE, NO_ROWS, a_record, change, filled

from bench.results.records import (
    Damping,
    IntegratorFacts,
    Plan,
    Rows,
)
from bench.results.store import Store, StoreError, set_aside_text


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
        ("long_runs SET value = {}", Store.long_runs, {}),
        ("records SET value = {}", Store.records, {}),
        ("records SET rows = {}", lambda store: store.rows("k"), NO_ROWS),
    ],
    ids=[
        "plan",
        "environments",
        "scenes",
        "damping",
        "experiments",
        "long_runs",
        "records",
        "rows",
    ],
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
        assert store.records() == {"other": a_record("other", run_s=[2.0], rounds=[(0, 0)])}


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
    change(filled(tmp_path), f"INSERT INTO samples VALUES ('k', 1, {seconds}, NULL)")
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


def test_a_sample_without_its_record_is_set_aside(tmp_path):
    change(filled(tmp_path), "INSERT INTO samples VALUES ('lost', 0, 1.0, NULL)")
    with Store(tmp_path) as store:
        assert list(store.records()) == ["k"]
        (row,) = store.set_aside()
        assert row == ("samples", "lost, number 0", "it has no record")
