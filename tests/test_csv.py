"""CSV: what a spreadsheet would run is quoted, and numbers are read as they are."""

from __future__ import annotations

import io
import math

import pandas as pd
import pytest

from bench.results.csv_text import csv_export, csv_text


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1", "@a", "\tx", "\rx", "=cmd|' /C calc'!A0"])
def test_a_text_that_begins_like_a_formula_is_quoted(text):
    rows = [{"name": text, text: 1.5}, {"name": "a=b", text: -2.5}]
    frame = pd.read_csv(io.StringIO(csv_export(rows)), keep_default_na=False)
    quoted = f"'{text}".replace("\r", " ")
    assert list(frame.columns) == ["name", quoted]
    assert list(frame["name"]) == [quoted, "a=b"]
    assert list(frame[quoted]) == [1.5, -2.5]
    # Charts look their labels up: there nothing is quoted.
    assert csv_text(rows).count("'") == text.count("'") * 2


def test_line_breaks_stay_within_their_cell():
    rows = [{"a": "one\r\ntwo\rthree\nfour", "b": 1}]
    frame = pd.read_csv(io.StringIO(csv_text(rows)))
    assert frame.to_dict("records") == [{"a": "one \ntwo three\nfour", "b": 1}]


def test_numbers_and_empty_cells_are_read_unchanged():
    numbers = [-1.5, 1e308, 5e-324, -0.0, 7, None, math.inf]
    frame = pd.read_csv(io.StringIO(csv_export([{"x": x, "y": "u"} for x in numbers])))
    assert list(frame["x"].drop(index=5)) == [x for x in numbers if x is not None]
    assert math.isnan(frame["x"][5])
