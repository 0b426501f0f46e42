"""Flat rows for pandas, CSV, and errors as a person writes them."""

from __future__ import annotations

import io
import json

import pandas as pd
import pytest
from small_stores import a_record

from bench.results.csv_text import csv_export, csv_text
from bench.results.quantities import group_and_norm
from bench.results.records import flatten, median
from problems.spec import SpecError


def test_flat_rows_open_in_pandas():
    record = a_record(run_s=[0.3, 0.1, 0.2])
    row = flatten(record, {})
    assert row["error_q_end"] == 1e-3
    assert row["error_q_max"] is None
    assert row["work_steps"] == 10
    assert (row["run_s_median"], row["run_s_min"], row["run_s_max"]) == (0.2, 0.1, 0.3)
    assert (row["pattern"], row["run_s"]) == ([0.3, 0.7], [0.3, 0.1, 0.2])
    assert row["environment"] is None
    for frame in (
        pd.read_csv(io.StringIO(csv_export([row]))),
        pd.read_json(io.StringIO(json.dumps([row]))),
    ):
        assert frame.loc[0, "error_q_end"] == 1e-3
        assert frame.loc[0, "integrator"] == "newmark"


def test_the_median_of_samples():
    assert median([]) is None
    assert median([3.0]) == 3.0
    assert median([4.0, 1.0, 2.0, 3.0]) == 2.5


def test_csv_has_the_columns_in_order_of_appearance():
    rows = [{"b": 1, "a": 'say "no", please'}, {"c": None, "b": 2.5}]
    assert csv_text(rows) == 'b,a,c\n1,"say ""no"", please",\n2.5,,\n'
    assert csv_text([{"a": 1, "b": 2}], ["b", "a"]) == "b,a\n2,1\n"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a:rms", ("a", "rms")),
        (" a : end ", ("a", "end")),
        ("a", ("a", "max")),
        ("|q|", ("|q|", "max")),
    ],
)
def test_an_error_is_read_as_group_and_norm(text, expected):
    assert group_and_norm(text, ["q", "a"]) == expected


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x:max", "no error of 'x'; known: a, q"),
        ("|a:max", "no error of"),
        ("a:mx", "no norm 'mx'; did you mean 'max'"),
    ],
)
def test_an_error_that_is_not_known_is_named(text, words):
    with pytest.raises(SpecError, match=words):
        group_and_norm(text, ["q", "a"])
