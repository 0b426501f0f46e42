"""Pictures: what cannot be drawn says so; no picture has more lines than can be read."""

from __future__ import annotations

import math
import re

import pytest
from planted import plant, planted, whole_markdown

from reports.charts import rendering
from reports.pages.markdown_report import _FIGURES as FIGURES
from reports.pages.markdown_report import write_markdown_report


def line(name, text="a,b\n1,2\n"):
    return {
        "datasets": {name: text},
        "data": {"name": name, "format": {"type": "csv"}},
        "mark": "line",
        "encoding": {f: {"field": k, "type": "quantitative"} for f, k in (("x", "a"), ("y", "b"))},
        "config": {"axis": {"labelColor": "#123456"}},
    }


def test_a_chart_that_cannot_be_drawn_says_so_and_costs_no_other(tmp_path):
    failed = rendering.draw({"bad": {"mark": "no such mark"}, "good": line("good")}, tmp_path)
    assert list(failed) == ["bad"]
    assert failed["bad"].sentence.startswith("This chart cannot be drawn: ")
    (file,) = tmp_path.iterdir()
    assert file.name == "good.svg"
    assert "#123456" in file.read_text()


def test_what_would_end_the_process_is_cleaned_before():
    # vl-convert's text measuring panics at a null character, and takes its process along.
    numbers = {"data": {"values": [{"a": math.inf, "b": math.nan}]}}
    for text in ("a\0b", "\ud800", "\x1b[31m", "\uffff", "</script>", "\u202e"):
        svg = rendering.picture(line("bad") | numbers | {"title": text}).svg
        assert svg.startswith("<svg"), svg
        assert not set(svg) & set("\0\x1b\uffff\u202e")


@pytest.fixture(scope="module")
def crowd(tmp_path_factory):
    """30 integrators, of which the later ones err less in q; the last one failed."""
    records = [
        planted("pendulum", f"m{k:02}", {g: (1.0 / (k + 1), 2) for g in ("q", "a")}, h=h)
        for k in range(29)
        for h in (0.1, 0.05, 0.025)
    ]
    failed = {"status": "crashed", "errors": {}}
    records += [planted("pendulum", "m29", {}, h=h, **failed) for h in (0.1, 0.05, 0.025)]
    return plant(tmp_path_factory.mktemp("crowd"), records)


def labels(chart):
    """The integrators that the legend of a chart names."""
    return set(re.findall(r">(m\d\d)[:<,]", chart))


def test_a_still_picture_shows_the_most_accurate_of_a_crowd_and_says_so(crowd):
    text = whole_markdown(write_markdown_report(crowd).parent)
    figures = crowd / FIGURES
    best = [f"m{k:02}" for k in range(28, -1, -1)]
    for name, most in (("convergence-max", 24), ("work_precision", 24), ("trajectory", 12)):
        chart = (figures / f"scene-1-1-{name}.svg").read_text()
        assert labels(chart) == set(best[:most]), name
        assert f"Of 30 integrators those {most} are shown that err least in q." in text
