"""atlas.html: the failure atlas as a chapter of the report, and as a page of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import vl_convert

from bench.results.experiments import ExperimentResult
from reports.charts.atlas import experiment_chart
from reports.pages.captioned_charts import CaptionedCharts, captioned
from reports.pages.templating import html
from reports.text.atlas_tables import experiments_table, part_table, predicted_counts
from reports.text.table import Table

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
    pictures = {
        name: vl_convert.vegalite_to_svg(chart)
        for experiment in (chapter.experiments if chapter else [])
        for figure in experiment.figures
        for name, chart in figure.charts.items()
    }
    path = Path(folder) / FILE
    text = html("atlas.html.j2", atlas=chapter, pictures=pictures)
    path.write_text(text, encoding="utf-8")
    return path


def _section(f: ExperimentResult) -> ExperimentSection:
    verdict = f.verdict.capitalize()
    parts = []
    for k, part in enumerate(f.parts, 1):
        caption = f"{part.text}: {part.quantity}"
        caption += f"; {part.show} in the first run." if part.show else "."
        figure = captioned(caption, {f"atlas-{f.name}-{k}": experiment_chart(part)})
        parts.append((part_table(part), figure))
    return ExperimentSection(f, f"{verdict}: {predicted_counts(f)} numbers.", parts)
