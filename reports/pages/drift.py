"""drift.html: long runs as a chapter of the report, and as a page of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from bench.results.drift import LongRun, scenes_of
from bench.results.table import Table
from problems.whole_files import put
from reports.charts.drift import drift_chart
from reports.charts.rendering import pictures
from reports.names import scene_name
from reports.pages.captioned_charts import CaptionedCharts, captioned
from reports.pages.templating import html
from reports.text.drift_table import drift_sentences, drift_table

FILE = "drift.html"
_CAPTION = (
    "Absolute values over time, from the least (or the end of the axis) to the largest in each of "
    "up to 200 parts of the run. Energy: its change, relative to the largest kinetic one. "
    "Momentum: the change of the one that changes most, relative to its largest value. "
    "Residuals: the largest one of the constraints Φ, and of their rates. Phase: time by which a "
    "run is ahead of the closed form or behind it."
)


@dataclass
class DriftSection:
    """Long runs of one scene with the same steps."""

    anchor: str
    title: str
    rows: str
    sentences: list[str]
    figure: CaptionedCharts | None
    table: Table


def drift_chapter(runs: Mapping[str, LongRun], interactive: bool) -> list[DriftSection]:
    """The sections on these long runs."""
    return [_section(f"drift-{k}", own, interactive) for k, own in enumerate(scenes_of(runs), 1)]


def write_drift_page(runs: Mapping[str, LongRun], folder: Path) -> Path:
    """Write drift.html into a folder."""
    sections = drift_chapter(runs, interactive=False)
    charts = {n: c for s in sections if s.figure for n, c in s.figure.charts.items()}
    drawn = {name: picture.svg for name, picture in pictures(charts).items()}
    put(folder / FILE, html("drift_page.html.j2", sections=sections, pictures=drawn))
    return folder / FILE


def _section(anchor: str, own: list[LongRun], interactive: bool) -> DriftSection:
    first = own[0]
    return DriftSection(
        anchor=anchor,
        title=f"{scene_name(first.problem)}: {first.asked} steps of {first.h:g} s",
        rows=f"Measured at {max(run.rows for run in own)} rows of each run.",
        sentences=list(drift_sentences(own)),
        figure=captioned(_CAPTION, {f"{anchor}-chart": drift_chart(own, interactive)}),
        table=drift_table(own),
    )
