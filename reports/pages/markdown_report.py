"""report.md: the report for reading beside code, with SVG pictures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from reports.charts.rendering import draw
from reports.pages.captioned_charts import CaptionedCharts
from reports.pages.report import Report, read_report
from reports.pages.templating import markdown

FILE = "report.md"
FIGURES = "report_figures"


def write_markdown_report(folder: Path) -> Path:
    """Write report.md and its pictures (report_figures/) into a run folder, from its store alone.

    Parameters
    ----------
    folder
        The run folder.

    Returns
    -------
    pathlib.Path
        The page.

    Raises
    ------
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    report = read_report(folder, interactive=False)
    charts = {name: chart for f in _figures(report) for name, chart in f.charts.items()}
    failed = draw(charts, Path(folder) / FIGURES)
    path = Path(folder) / FILE
    text = markdown("report.md.j2", report=report, figures=FIGURES, failed=failed)
    path.write_text(text, encoding="utf-8")
    return path


def _figures(report: Report) -> Iterator[CaptionedCharts]:
    yield from report.overview
    for scene in report.scenes:
        yield from [scene.picture] if scene.picture else []
        yield from (figure for study in scene.studies for figure in study.figures)
    for experiment in report.atlas.experiments if report.atlas else ():
        yield from experiment.figures
