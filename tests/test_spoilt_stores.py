"""Values of a store that cannot be read, or not be written: they are left out and told."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from small_stores import A_SCENE, NO_ROWS, a_record, change, filled

from bench.results.records import Damping, Rows
from bench.results.store import Store, StoreError, set_aside_text


@pytest.mark.parametrize("damage", ["X'7B22'", "X'22FF22'", "'null'"], ids=["cut", "utf8", "null"])
def test_a_damaged_value_of_any_kind_is_left_out_and_named(tmp_path, damage):
    empty = filled(tmp_path / "whole")
    with Store(empty) as store:
        kinds = [kind for (kind,) in store._read("SELECT DISTINCT kind FROM results")]
    assert len(kinds) == 8
    for kind in kinds:
        folder = filled(tmp_path / kind)
        change(folder, f"UPDATE results SET value = {damage} WHERE kind = '{kind}'")
        with Store(folder) as store:
            (row,) = store.set_aside()
            assert (row.kind, bool(row.reason)) == (kind, True)
            assert set_aside_text([row]).startswith("1 row of the store cannot be read")
            assert store.rows("k") == NO_ROWS
            assert list(store.records()) == ([] if kind == "Record" else ["k"])


def test_a_good_store_has_nothing_set_aside(tmp_path):
    with Store(filled(tmp_path)) as store:
        assert store.set_aside() == []
        assert set_aside_text([]) == ""


def test_one_spoilt_row_costs_no_other(tmp_path):
    with Store(filled(tmp_path), create=True) as store:
        store.save(a_record("other"), NO_ROWS)
        store.add_sample("other", 0, 2.0)
    change(tmp_path, "UPDATE results SET value = '{' WHERE kind = 'Record' AND key = 'k'")
    with Store(tmp_path) as store:
        assert store.records() == {"other": a_record("other", run_s=[2.0], rounds=[(0, 0)])}


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"h":0.1', '"h":-0.1'),
        ("0.001", '"0.001"'),
        ('"steps":10', '"steps":-1'),
        ('"key":"k",', ""),
    ],
)
def test_a_record_with_impossible_numbers_is_left_out(tmp_path, old, new):
    value = f"replace(value, '{old}', '{new}') WHERE kind = 'Record'"
    change(filled(tmp_path), f"UPDATE results SET value = {value}")
    with Store(tmp_path) as store:
        assert store.records() == {}
        assert [row.kind for row in store.set_aside()] == ["Record"]


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
        store.keep(msgspec.structs.replace(A_SCENE, reference=Rows(t=[1.0], values=1)))
        store.keep(Damping(omega_h=[float("nan")]), "d")
        assert store.set_aside() == []
        records = store.records()
        assert list(records) == [record.key for record in odd]
        for record in records.values():
            assert (record.status, record.h, record.errors) == ("crashed", 0.1, {})
            assert record.message.startswith("The result cannot be stored: ")
        (scene,) = store.scenes().values()
        assert "cannot be stored" in scene.description
        assert "cannot be stored" in store.damping()["d"].message


def test_a_plan_that_cannot_be_stored_is_refused_and_the_old_one_stays(tmp_path):
    with Store(filled(tmp_path), create=True) as store:
        plan = store.plan()
        with pytest.raises(StoreError, match=r"'plan' cannot be stored.*samples"):
            store.keep(msgspec.structs.replace(plan, samples="many"))
        assert store.plan() == plan


def test_sampled_values_that_cannot_be_read_again_cost_no_more_than_themselves(tmp_path):
    with Store(tmp_path, create=True) as store:
        store.save(a_record(), Rows(t=[0.0], values={"q": [[float("nan")]]}))
        (record,) = store.records().values()
        assert (record.status, record.errors) == ("ok", a_record().errors)
        assert record.message == "Its sampled values cannot be stored."
        assert store.rows("k") == NO_ROWS
        assert store.set_aside() == []


@pytest.mark.parametrize("text", ["\ud800", "\0", "\x1b[31m", "\u202e", "\x9b", "\uffff"])
def test_unfit_characters_are_replaced_and_cost_nothing(tmp_path, text):
    record = a_record(f"a{text}b", message=f"{text} \\u0000 ü 😀", integrator=text)
    with Store(tmp_path, create=True) as store:
        store.save(record, NO_ROWS)
        store.add_sample(record.key, 0, 1.0)
        store.keep(msgspec.structs.replace(A_SCENE, problem=text))
        (found,) = store.records().values()
        (scene,) = store.scenes().values()
        assert store.rows(found.key) == NO_ROWS
        assert store.set_aside() == []
    instead = "\ufffd[31m" if len(text) > 1 else "\ufffd"
    assert found.message == f"{instead} \\u0000 ü 😀"
    assert (found.key, found.integrator, scene.problem) == (f"a{instead}b", instead, instead)
    assert (found.status, found.run_s) == ("ok", [1.0])
