"""CSV and JSON: numbers stay, lists are lists and names are names."""

import io
import json
import math

import pandas as pd
import pytest
from planted import plant, planted
from small_stores import a_record

from bench.results.flat_rows import csv_text, flatten
from bench.results.records import Digits, median


def test_numbers_line_breaks_and_empty_cells_are_read_unchanged():
    rows = [{"a": "one\r\ntwo\rthree\nfour", "b": 1}]
    frame = pd.read_csv(io.StringIO(csv_text(rows)))
    assert frame.to_dict("records") == [{"a": "one \ntwo three\nfour", "b": 1}]
    numbers = [-1.5, 1e308, 5e-324, -0.0, 7, None, math.inf]
    frame = pd.read_csv(io.StringIO(csv_text([{"x": x, "y": "u"} for x in numbers])))
    assert list(frame["x"].drop(index=5)) == [x for x in numbers if x is not None]
    assert math.isnan(frame["x"][5])
    rows = [{"b": 1, "a": 'say "no", please'}, {"c": None, "b": 2.5}]
    assert csv_text(rows) == 'b,a,c\n1,"say ""no"", please",\n2.5,,\n'  # as they appear


def test_a_record_is_a_flat_row():
    row = flatten(a_record(run_s=[0.3, 0.1, 0.2]), {})
    assert (row["error_q_end"], row["error_q_max"], row["work_steps"]) == (1e-3, None, 10)
    assert (row["run_s_median"], row["run_s_min"], row["run_s_max"]) == (0.2, 0.1, 0.3)
    assert (row["pattern"], row["run_s"]) == ([0.3, 0.7], [0.3, 0.1, 0.2])
    assert row["environment"] is None
    assert flatten(a_record(), {})["run_s_min"] is None
    assert [median([]), median([3.0]), median([4.0, 1.0, 2.0, 3.0])] == [None, 3.0, 2.5]


def test_the_export_has_lists_names_and_published_digits_and_its_file_decides_the_form(
    stepbench, refused, tmp_path
):
    run = planted("pendulum", "good", {"q": (1.0, 2)}, h=0.1, pattern=(1 / 3, 2 / 3))
    run.components = {"q": {"max": [1 / 7, None]}}
    run.published = [
        Digits(quantity="q", t=1.0, published=[0.5, 2.0], computed=[0.5, 2.1], tolerance=1e-9)
    ]
    folder = plant(tmp_path / "store", [run])
    for name in ("a.csv", "a.JSON"):
        stepbench("report", folder, "-o", tmp_path / name)
    for form in ("csv", "JSON"):  # the same on the screen
        said = stepbench("report", folder, f"--{form.lower()}").stdout
        assert said.strip() == (tmp_path / f"a.{form}").read_text().strip()
    (row,) = json.loads((tmp_path / "a.JSON").read_text())
    assert row["published"][0]["computed"] == [0.5, 2.1]
    assert row["pattern"] == [1 / 3, 2 / 3]
    assert row["run_s"] == pytest.approx([3e-5, 3.03e-5, 3.06e-5])
    assert (row["error_q_components_max"], row["error_q_components_end"]) == ([1 / 7, None], [])
    assert row["environment"] == "Model 1, 8 cores, 2025-03-01T10:00:00+00:00"
    frame = pd.read_csv(tmp_path / "a.csv")
    assert json.loads(frame["published"][0]) == row["published"]
    for value in frame.iloc[0]:  # no value of Python's
        assert not isinstance(value, str) or not value.startswith(("{'", "[{'"))
    assert frame.pattern[0] == "0.333333333 0.666666667"
    assert frame.run_s[0] == "3e-05 3.03e-05 3.06e-05"
    assert frame.error_q_components_max[0] == "0.142857143 nan"
    assert frame.environment[0] == row["environment"]
    wrong = "report", folder, "--json", "-o", tmp_path / "b.csv"
    assert "ends in .csv and --json was given" in refused(*wrong)
