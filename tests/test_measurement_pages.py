"""Chapters and charts of measurements beside the cells: they show what the store holds."""

from __future__ import annotations

import csv
import io
import re

import msgspec
import pytest
from planted import Document, plant, planted
from planted_measurements import (
    DERIVED,
    EXACT,
    FAILED,
    GRADIENTS,
    PRECISIONS,
    ROUNDED,
    TICKS,
    a_precision,
    a_tick,
    measured,
)

from bench.results.measurements import KINDS
from bench.results.store import Store
from reports.charts.sweeps import budget_chart, gradient_chart, precision_chart
from reports.pages.html_report import write_html_report
from reports.pages.markdown_report import write_markdown_report
from reports.pages.measurements import measurement_chapters


# ---- chapters ----------------------------------------------------------------------------
@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = plant(
        tmp_path_factory.mktemp("report"), [planted("pendulum", "m", {"q": (1.0, 2)}, h=0.1)]
    )
    with Store(path, create=True) as store:
        for one in (TICKS, ROUNDED, GRADIENTS, FAILED):
            store.save_measurement(one)
    return path


def test_the_pages_have_the_numbers_of_the_store(folder):
    front = write_html_report(folder).read_text(encoding="utf-8")
    pages = {}
    for kind, title in zip(KINDS, ("Fixed budget per step", "Precision", "Gradients"), strict=True):
        assert re.search(rf'href="report/{kind}.html"[^>]*>{title}', front)
        text = (folder / "report" / f"{kind}.html").read_text(encoding="utf-8")
        pages[kind] = Document(text)
        assert "What to see here: " in pages[kind].words
        assert len(pages[kind].charts) == 1
    words, rows = pages["realtime"].words, pages["realtime"].rows
    assert "Ticks" in words
    assert "Watch the clock." in words
    times = rows("oscillator at 250 Hz, 1000 steps: time per step in µs")
    assert [*times[0].values()] == ["newmark", "1", "100", "4000", "5000", "1 (0.1 %)"]
    assert [row["q"] for row in rows("Errors")] == ["0.002", "5e-5"]
    errors = [[*row.values()] for row in pages["precision"].rows("newmark on pendulum")]
    assert ["single", "0.01", "0.0001", "1.26", "ok"] in errors
    assert "in single rounding takes over in" in pages["precision"].words
    costs = pages["gradient"].rows("Errors of derivatives, and their cost in runs")
    assert [*costs[-1].values()] == [
        "newmark",
        "reverse",
        "h=0.01",
        "0.01",
        "0.0001",
        "0.0003",
        "3.25",
    ]
    assert "q[0] by length: 21.1530779673" in pages["gradient"].words
    assert "IDA: unsupported: No derivative is taken." in pages["gradient"].words


def test_markdown_has_the_same_chapters(folder):
    text = write_markdown_report(folder).read_text(encoding="utf-8")
    for title in ("## Fixed budget per step", "## Precision", "## Gradients", "### Ticks"):
        assert f"\n{title}\n" in text
    assert text.count("What to see here: ") == 3
    for row in (
        "| `newmark` | 1 | 100 | 4000 | 5000 | 1 (0.1 %) |",
        "| single | 0.01 | 0.0001 | 1.26 | ok |",
        "| `newmark` | reverse | h=0.01 | 0.01 | 0.0001 | 0.0003 | 3.25 |",
    ):
        assert row in text
    for name in ("realtime-1-chart", "precision-1-chart", "gradient-1-chart"):
        assert (folder / "report_figures" / f"{name}.svg").read_text().startswith("<svg")


def test_without_measurements_there_is_no_chapter():
    assert not any(chapter.sections for chapter in measurement_chapters({}))
    of = {chapter.title: chapter.sections for chapter in measurement_chapters({FAILED.key: FAILED})}
    (section,) = of["Gradients"]
    assert (section.parts, section.sentences) == ([], ["IDA: unsupported: No derivative is taken."])
    assert of["Precision"] == of["Fixed budget per step"] == []


def test_entries_have_sections_of_their_own():
    other = measured("precision", words="h=0.2 s", precision=PRECISIONS)
    more = msgspec.structs.replace(ROUNDED, integrator="bdf2")
    found = {one.key: one for one in (ROUNDED, other, more)}
    _, chapter, _ = measurement_chapters(found)
    assert [s.title for s in chapter.sections] == ["pendulum: h=0.1 s", "pendulum: h=0.2 s"]
    assert [s.anchor for s in chapter.sections] == ["precision-1", "precision-2"]


# ---- charts ------------------------------------------------------------------------------
def rows_of(chart, name):
    return list(csv.DictReader(io.StringIO(chart["datasets"][name])))


def test_the_budget_chart_draws_times_deadline_and_errors():
    chart = budget_chart(TICKS.realtime)
    times = {(r["text"], r["line"]): float(r["time"]) for r in rows_of(chart, "times")}
    assert times == {
        (f"Newmark ({limit})", word): value
        for limit in ("1", "unlimited")
        for word, value in (("median", 100.0), ("99.9 %", 4001.0), ("worst", 5000.0))
    }
    left, right = chart["concat"]
    assert left["layer"][-1]["encoding"]["x"] == {"datum": 4000.0}
    assert [float(r["error"]) for r in rows_of(chart, "errors")] == [2e-3, 5e-5]
    assert (line_of(left)["x"]["field"], line_of(right)["x"]["field"]) == ("time", "error")
    failed = budget_chart([a_tick(status="diverged", errors={})])
    assert len(failed["concat"]) == 1
    assert budget_chart([]) is None


def test_the_precision_chart_draws_an_error_for_each_precision_and_step():
    chart = precision_chart(PRECISIONS)
    found = {
        (r["line"], float(r["h"])): (float(r["q"]), float(r["lam"]))
        for r in rows_of(chart, "sweep")
    }
    drawn = {(r.precision, r.h): pytest.approx((*r.errors.values(),), rel=1e-4) for r in PRECISIONS}
    assert found == drawn
    axes = [line_of(panel) for panel in chart["concat"]]
    assert [(axis["x"]["field"], axis["y"]["field"]) for axis in axes] == [("h", "q"), ("h", "lam")]
    for channel in ("color", "strokeDash"):
        scale = axes[0][channel]["scale"]
        assert scale["domain"] == ["double", "single", "mixed"]
        assert len(set(map(str, scale["range"]))) == 3
    assert precision_chart([a_precision("double", 0.1)]) is None


def test_the_gradient_chart_draws_errors_over_processor_seconds():
    chart = gradient_chart([GRADIENTS.gradient])
    found = [
        (r["line"], float(r["seconds"]), float(r["by0"]), float(r["by1"]))
        for r in rows_of(chart, "sweep")
    ]
    assert found == [
        (run.way, *map(pytest.approx, (run.cost * run.run_s, *run.errors))) for run in DERIVED
    ]
    axes = [line_of(panel) for panel in chart["concat"]]
    assert [(axis["x"]["field"], axis["y"]["field"], axis["y"]["title"]) for axis in axes] == [
        ("seconds", f"by{k}", f"relative error of derivatives by {name}")
        for k, name in enumerate(EXACT.by)
    ]
    assert axes[0]["strokeDash"]["scale"]["domain"] == ["forward", "reverse"]
    assert gradient_chart([]) is None


def test_numbers_of_charts_are_read_as_numbers():
    charts = budget_chart(TICKS.realtime), precision_chart(PRECISIONS)
    for chart in (*charts, gradient_chart([GRADIENTS.gradient])):
        for panel in chart["concat"]:
            types = panel["data"]["format"]["parse"]
            axes = [line_of(panel)[axis] for axis in "xy"]
            assert {types[a["field"]] for a in axes if a["type"] == "quantitative"} == {"number"}


def line_of(panel):
    """The encoding of a panel, or of its first layer."""
    return panel["encoding"] if "encoding" in panel else panel["layer"][0]["encoding"]
