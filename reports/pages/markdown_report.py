"""report.md and a file per scene in report/: for reading beside code, with SVG pictures."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import quote

from problems.base.cache import put
from reports.charts.rendering import draw
from reports.pages.page import FOLDER
from reports.pages.report import read_report
from reports.pages.templating import markdown
from reports.tables.ranking_tables import standings_table
from reports.verdicts import headlines

FILE = "report.md"
_FIGURES = "report_figures"


def write_markdown_report(folder: Path) -> Path:
    """Write report.md, report/scene-NAME.md and their pictures, from a run folder's store alone.

    Raises
    ------
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    report = read_report(folder)
    overview = report.overview
    figures = [overview, *(f for p in (*report.scenes, *report.chapters) for f in p.figures)]
    charts = {name: chart for figure in figures for name, chart in figure.charts.items()}
    failed = draw(charts, folder / _FIGURES)
    files = {f"{page.anchor}.md": page for page in report.scenes}
    names = {**report.names, **{page.values["key"]: page.title for page in report.scenes}}
    own = folder / FOLDER
    own.mkdir(exist_ok=True)
    same = {"report": report, "failed": failed}
    for file, page in files.items():
        put(own / file, markdown("scene.md.j2", names, page=page, figures=f"../{_FIGURES}", **same))
    for old in own.glob("scene-*.md"):
        if old.name not in files:
            old.unlink()
    text = markdown(
        "report.md.j2",
        names,
        answer=headlines(report.answered, report.names),
        standings=standings_table(report.answer),
        overview=overview,
        scenes=[(page.title, FOLDER + quote(file)) for file, page in files.items()],
        figures=_FIGURES,
        **same,
    )
    put(folder / FILE, text)
    return folder / FILE
