"""Text of the front page without a browser: its policy, its columns, and the data beside it."""

from __future__ import annotations

import json
import math
import re

import pytest

from reports.pages.columns import column


def test_the_policy_allows_no_script_but_the_page_s_own(site):
    text = (site / "report.html").read_text(encoding="utf-8")
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text).group(1)
    (scripts,) = [part for part in policy.split("; ") if part.startswith("script-src")]
    assert "unsafe" not in scripts
    assert "default-src 'none'" in policy.replace("&#39;", "'")
    assert len(text) < 300_000


def numbers(text):
    """The numbers of a column, read in another way than by the scripts."""
    alphabet = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_"
    for k in range(0, len(text), 4):
        part = text[k : k + 4]
        bits = sum(alphabet.index(c) << 6 * (3 - i) for i, c in enumerate(part))
        yield None if part == "----" else 10 ** (80 * bits / (2**24 - 1) - 40)


def test_a_column_keeps_its_numbers_and_those_that_are_missing():
    reserved = 10 ** (80 * 0xFBEFBE / (2**24 - 1) - 40)  # would be written as "----"
    values = [1.0, 3.7e-13, None, 0.0, math.nan, math.inf, 12345.678, 1e-40, 1e40, reserved]
    found = list(numbers(column(values)))
    assert [v is None for v in found] == [v is None or not 0 < v < math.inf for v in values]
    for value, read in zip(values, found, strict=True):
        assert read is None or read == pytest.approx(value, rel=1.2e-5)


def test_the_page_holds_the_first_question_and_the_file_beside_it_all(site):
    text = (site / "report.html").read_text(encoding="utf-8")
    first = json.loads(re.search(r'id="stepbench-data"[^>]*>(.*?)</script>', text, re.S).group(1))
    assert list(first["answers"]) == ["a|max|operations", "a|max|seconds"]
    (data,) = (site / "report").glob("data*.js")  # the one that the page names
    assert f'data-more="report/{data.name}"' in text
    rest = data.read_text(encoding="utf-8")
    more = json.loads(rest.removeprefix("stepbench.more(").rstrip().removesuffix(");"))
    assert len(more["answers"]) == len(first["group_names"]) * 4 * 3
    # Until all comes, a number has its first three characters.
    place = more["columns"].index("operations")
    short, full = first["runs_of"][0][0][2][1], more["runs_of"][0][0][2][place]
    assert (first["letters"], more["letters"]) == (3, 4)
    assert [short[k : k + 3] for k in range(0, len(short), 3)] == [
        full[k : k + 3] for k in range(0, len(full), 4)
    ]
    for key in first["answers"]:
        one, other = (
            [
                [data["details"][k] for k in data["verdicts"][place]]
                for place in data["answers"][key]
            ]
            for data in (first, more)
        )
        assert one == other
    # A text per method, then the ties for each accuracy that can be judged.
    runs = first["runs_of"][0]
    assert len(one[0]) == len(runs) + len(first["targets"]) == len(runs) + 25
