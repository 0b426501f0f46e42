"""The same cells over several stores, and what changed where."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pytest
from planted import edited, everything, plant

from bench.results.history import history
from bench.results.records import Record

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
