"""atlas.html: the failure atlas as a chapter of the report, and as a page of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.results.experiments import ExperimentResult
from bench.results.table import Table
from problems.whole_files import put
from reports.charts.atlas import experiment_chart
from reports.charts.rendering import pictures
from reports.formatting import file_name
from reports.pages.captioned_charts import CaptionedCharts, captioned
from reports.pages.templating import html
from reports.text.atlas_tables import experiments_table, part_table, predicted_counts

FILE = "atlas.html"


@dataclass
class ExperimentSection:
    """One experiment, with a table and a figure for each of its parts."""

    result: ExperimentResult
    verdict: str
    parts: list[tuple[Table, CaptionedCharts | None]]

    @property
    def figures(self) -> list[CaptionedCharts]:
        """The figures of all parts."""
        return [figure for _, figure in self.parts if figure]


@dataclass
class AtlasChapter:
    """All experiments: a table of verdicts, and a section for each."""

    summary: Table
    experiments: list[ExperimentSection]


def atlas_chapter(found: Sequence[ExperimentResult]) -> AtlasChapter | None:
    """The chapter on these experiments; None if there are none."""
    return AtlasChapter(experiments_table(found), [_section(f) for f in found]) if found else None


def write_atlas_page(found: Sequence[ExperimentResult], folder: Path) -> Path:
    """Write atlas.html into a folder."""
    chapter = atlas_chapter(found)
    charts = {
        name: chart
        for experiment in (chapter.experiments if chapter else [])
        for figure in experiment.figures
        for name, chart in figure.charts.items()
    }
    drawn = {name: picture.svg for name, picture in pictures(charts).items()}
    put(folder / FILE, html("atlas_page.html.j2", atlas=chapter, pictures=drawn))
    return folder / FILE


def _section(f: ExperimentResult) -> ExperimentSection:
    parts = []
    for k, part in enumerate(f.parts, 1):
        caption = f"{part.text}: {part.quantity}"
        caption += f"; {part.show} in the first run." if part.show else "."
        figure = captioned(caption, {f"atlas-{file_name(f.name)}-{k}": experiment_chart(part)})
        parts.append((part_table(part), figure))
    return ExperimentSection(f, f"{f.verdict.capitalize()}: {predicted_counts(f)} numbers.", parts)
