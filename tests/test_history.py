"""The same cells over several stores, and what changed where."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path

import altair
import pytest
from planted import STEPS, Document, edited, everything, plant
from test_compare import double_newton, records

from bench.results.compare import compare_folders
from bench.results.history import history
from bench.results.records import Record, median
from reports.charts.comparison import ratio_charts
from reports.pages.comparison import write_comparison

GOOD = "good[rho_inf=0.8]"


def cheaper(record: Record) -> None:
    if record.problem == "pendulum" and record.integrator == GOOD:
        record.operations = {"residuals": record.operations["residuals"] / 2}


def worse(record: Record) -> None:
    if record.problem == "spring_mass" and record.integrator == GOOD and record.h == 0.1:
        record.errors["a"]["max"] *= 3.0
        record.errors["a"]["end"] *= 5.0  # another norm
    if record.integrator == "poor" and record.h == 0.1:
        record.status, record.message = "diverged", "A value grew."


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    root = tmp_path_factory.mktemp("history")
    runs = [r for r in everything() if r.problem == "spring_mass" or r.integrator == GOOD]
    first = plant(root / "first", runs)
    second = edited(first, "second", cheaper)
    return [first, second, edited(second, "third", worse)]


def test_changes_are_told_where_they_are(folders):
    found = history(folders)
    assert len(found.cells) == 18
    told = {
        (run.scene, run.integrator, run.resolution, line.quantity): line.changed
        for run, line in found.changed
    }
    halved = {where: texts for where, texts in told.items() if where[3] == "operations"}
    assert {where[:2] for where in halved} == {("pendulum", GOOD)}
    assert len(halved) == 6
    assert all(texts == ["", "x0.5", ""] for texts in halved.values())
    at = "h=0.1"
    assert told["spring_mass", GOOD, at, "error a"] == ["", "", "x3"]
    assert told["spring_mass", "poor", at, "status"] == ["", "", "ok -> diverged"]
    assert len(told) == 8
    (line,) = (line for run, line in found.changed if line.quantity == "error a")
    assert line.values == pytest.approx([0.03, 0.03, 0.09])


def test_a_row_for_each_cell_and_folder(folders, stepbench):
    rows = list(csv.DictReader(io.StringIO(stepbench("history", *folders, "--csv").stdout)))
    assert len(rows) == 18 * 3
    (own,) = (
        row
        for row in rows
        if (row["integrator"], row["resolution"], row["scene"]) == (GOOD, "h=0.1", "pendulum")
        and row["folder"].endswith("second")
    )
    assert own["changed"] == "operations x0.5"
    assert float(own["operations"]) == 150.0
    assert float(own["seconds"]) == pytest.approx(30e-6 * 1.01)
    assert own["status"] == "ok"
    answer = json.loads(stepbench("history", *folders, "--json").stdout)
    assert [store["date"] for store in answer["stores"]] == ["2025-03-01T10:00:00+00:00"] * 3
    assert answer["stores"][0]["versions"]["numpy"] == "2.1.0"
    assert len(answer["cells"]) == 18


def test_the_table_shows_what_changed_alone(folders, stepbench, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    text = stepbench("history", *folders).stdout
    lines = text.splitlines()
    assert any("error a" in line and "0.03" in line and "0.09" in line for line in lines)
    assert any("ok -> diverged" in line for line in lines)
    assert "What changed of 18 runs" in text
    same = stepbench("history", folders[0], folders[0]).stdout
    assert "Nothing changed." in same
    assert "What changed" not in same
    # Each run is named once, in full on a narrow screen, too; no change is told twice.
    assert text.count("ok -> diverged") == 1
    monkeypatch.setenv("COLUMNS", "60")
    assert "…" not in stepbench("history", *folders).stdout


def test_further_runs_change_nothing_in_the_others(folders, tmp_path, stepbench):
    alone = plant(tmp_path / "alone", [r for r in everything() if r.integrator == "poor"])
    text = stepbench("history", alone, folders[0]).stdout
    assert "Nothing changed in the runs that are in both." in text


def test_one_folder_has_no_history(folders, stepbench):
    result = stepbench("history", folders[0])
    assert result.exit_code == 1
    assert "takes two folders or more" in result.stderr


def test_a_cell_of_one_store_has_no_history(folders, tmp_path):
    alone = plant(tmp_path / "alone", [r for r in everything() if r.integrator == "poor"])
    assert {cell.run.integrator for cell in history([folders[0], alone]).cells} == {"poor"}


@pytest.fixture
def old(tmp_path: Path) -> Path:
    return plant(tmp_path / "old", everything())


def test_the_pages_hold_every_change_and_the_answer_does(old, stepbench, tmp_path):
    def edit(record):
        double_newton(record)
        if record.integrator == "poor":
            record.errors["a"]["max"] *= 5
            record.run_s = [4 * s for s in record.run_s]

    new, out = edited(old, "new", edit), tmp_path / "pages"
    result = stepbench("compare", old, new, "--out", out, "--fail-on", "error:2", "--json")
    assert result.exit_code == 1
    answer = json.loads(result.stdout)
    assert len(answer["regressions"]) == len(STEPS)
    before, after = records(old), records(new)
    for change in answer["changes"]:
        one, two = before[change["run"]["key"]], after[change["run"]["key"]]
        if change["kind"] == "error":
            values = [r.errors[change["name"]][change["norm"]] for r in (one, two)]
        elif change["kind"] == "work":
            values = [r.work[change["name"]] for r in (one, two)]
        else:
            values = [median(r.run_s) for r in (one, two)]
        assert [change["old"], change["new"]] == values
        assert change["ratio"] == pytest.approx(values[1] / values[0])
    page = Document((out / "comparison.html").read_text())
    paper = (out / "comparison.md").read_text()
    captions = [caption for caption, _ in page.tables]
    assert [caption.split()[0] for caption in captions] == ["Relative", "Counted", "Times"]
    for caption in captions:
        assert len(page.rows(caption)) == len(STEPS)
        assert f"**{caption}**" in paper
    for row in page.rows("Counted work that changed"):
        steps = round(1 / float(row["run"].removeprefix("h=")))
        told = (row["integrator"], row["count"], row["before"], row["now"], row["ratio"])
        assert told == ("good[rho_inf=0.8]", "residuals", str(3 * steps), str(6 * steps), "x2")
    assert page.words.count("Regression: ") == len(STEPS)
    assert all(place.startswith(("data:", "#")) for _, place in page.places)
    shown = [row["now"] for row in page.rows("Relative errors that changed")]
    poor = [r.errors["a"]["max"] for r in after.values() if r.integrator == "poor"]
    assert shown == [f"{error:.4g}" for error in poor]


def test_the_charts_hold_each_run_once_by_its_furthest_ratio_between_better_and_worse(old):
    def edit(record):
        if record.integrator == "poor" and record.h in STEPS[:2]:
            record.errors["a"] |= {"max": 8 * record.errors["a"]["max"]}
            record.errors["q"] |= {"end": record.errors["q"]["end"] / 2}
        elif record.integrator == "poor" and record.h == STEPS[2]:
            record.errors["x"]["end"] /= 4
        elif record.integrator == "poor" and record.h == STEPS[3]:
            record.errors["v"]["rms"] = None
        double_newton(record)

    found = compare_folders(old, edited(old, "new", edit))
    count = sum(found.judged.values())
    charts = ratio_charts(found)
    assert set(charts) == {"ratio-error", "ratio-work"}
    same, points = (layer["data"]["values"] for layer in charts["ratio-error"]["layer"])
    assert [(p["rank"], p["ratio"], p["worse"]) for p in points] == [
        (1, 0.25, 0),
        (count - 2, 8.0, 1),
        (count - 1, 8.0, 1),
        (count, 1e6, 1),  # no number any more: as far as it goes
    ]
    assert [(row["rank"], row["end"]) for row in same] == [(1.5, count - 2.5)]
    title = charts["ratio-error"]["title"]["text"]
    assert title == f"errors, furthest of each run: 3 worse, 1 better of {count}"
    work = charts["ratio-work"]["layer"][1]["data"]["values"]
    assert {p["ratio"] for p in work} == {2.0}
    assert [p["rank"] for p in work] == list(range(count - len(STEPS) + 1, count + 1))
    for chart in charts.values():
        altair.Chart.from_dict(chart, validate=True)


def test_both_pages_show_the_charts_and_identical_runs_have_none(old, tmp_path):
    found = compare_folders(old, edited(old, "twice", double_newton))
    html, markdown = write_comparison(found, [], tmp_path / "pages")
    assert html.read_text().count("<svg") == 1
    places = re.findall(r"!\[[^]]*\]\(([^)]+)\)", markdown.read_text())
    assert places == ["comparison_figures/ratio-work.svg"]
    assert (markdown.parent / places[0]).read_text() in html.read_text()
    html, markdown = write_comparison(compare_folders(old, old), [], tmp_path / "pages")
    assert "<svg" not in html.read_text()
    assert "![" not in markdown.read_text()
    assert not list((tmp_path / "pages").glob("**/*.svg"))
