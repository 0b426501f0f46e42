"""report.md and a file per scene in report/: for reading beside code, with SVG pictures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from problems.base.cache import put
from reports.charts.rendering import draw
from reports.formatting import file_name
from reports.names import scene_name
from reports.pages.chapter import FOLDER, Figure
from reports.pages.report import Report, read_report
from reports.pages.templating import markdown
from reports.tables.ranking_tables import standings_table
from reports.verdicts import DIFFER, headlines

FILE = "report.md"
_FIGURES = "report_figures"


def write_markdown_report(folder: Path) -> Path:
    """Write report.md, report/scene-NAME.md and their pictures, from a run folder's store alone.

    Parameters
    ----------
    folder
        The run folder.

    Returns
    -------
    pathlib.Path
        The index.

    Raises
    ------
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    report = read_report(folder)
    charts = {name: chart for f in _figures(report) for name, chart in f.charts.items()}
    failed = draw(charts, folder / _FIGURES)
    files = {name: FOLDER + quote(_scene_file(name)) for name in report.series}
    names = {**report.names, **{name: scene_name(name) for name in report.series}}
    own = folder / FOLDER
    own.mkdir(exist_ok=True)
    for chapter in report.scenes:
        text = markdown(
            "scene.md.j2",
            names,
            report=report,
            scene=chapter,
            index=FILE,
            figures=f"../{_FIGURES}",
            failed=failed,
        )
        put(own / _scene_file(chapter.name), text)
    for old in own.glob("scene-*.md"):
        if old.name not in map(_scene_file, (chapter.name for chapter in report.scenes)):
            old.unlink()
    text = markdown(
        "report.md.j2",
        names,
        report=report,
        answer=headlines(report.answered, report.names),
        doubts=[[DIFFER], *report.wrong],
        standings=standings_table(report.answer),
        scenes=[(scene_name(s.name), files[s.name]) for s in report.scenes],
        figures=_FIGURES,
        failed=failed,
    )
    put(folder / FILE, text)
    return folder / FILE


def _scene_file(name: str) -> str:
    return f"scene-{file_name(name)}.md"


def _figures(report: Report) -> Iterator[Figure]:
    yield report.overview
    for chapter in (*report.scenes, *report.chapters):
        yield from chapter.figures
