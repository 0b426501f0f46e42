"""drift.html: what drifts off in long runs, as a table and charts over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.results.drift import DRIFTS, lines
from bench.results.records import Rows
from reports.charts.line_styles import line_styles
from reports.charts.over_time import histories
from reports.charts.rendering import pictures
from reports.formatting import number
from reports.pages.templating import html
from reports.text.table import Table

FILE = "drift.html"


def write_drift_page(found: Sequence[Mapping[str, Any]], folder: Path) -> Path:
    """Write drift.html into a folder, from answers of `bench.running.drift.drift_job`."""
    head = ["integrator", "steps", "status", "quantity", "largest", "trend per s"]
    cells = [
        [one["integrator"], str(one["steps"]), one["status"], words, _cell(largest), _cell(per_s)]
        for one in found
        for words, largest, per_s in lines(one) or [("-", None, None)]
    ]
    runs = [(one["integrator"], _rows(one["rows"])) for one in found if one["rows"]["t"]]
    drawn = histories(runs, line_styles(label for label, _ in runs), notes=tuple(DRIFTS))
    text = html(
        "drift.html.j2",
        problem=found[0]["problem"],
        h=f"{found[0]['h']:g}",
        table=Table("Largest drift, and its trend", head, cells),
        charts=[one.svg for one in pictures({"drift": drawn}).values()] if drawn else [],
        messages=[f"{one['integrator']}: {one['message']}" for one in found if one["message"]],
    )
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / FILE
    path.write_text(text, encoding="utf-8")
    return path


def _rows(values: Mapping[str, list[float | None]]) -> Rows:
    """Absolute values, as the charts' axes are logarithmic."""
    notes = {
        name: [None if value is None else abs(value) for value in column]
        for name, column in values.items()
        if name != "t"
    }
    return Rows(t=values["t"], values={}, notes=notes)  # pyright: ignore[reportArgumentType]


def _cell(value: float | None) -> str:
    return "-" if value is None else number(value)
