"""The front page: the question, its answer, and the data of all other questions beside it."""

from __future__ import annotations

from pathlib import Path

from reports.charts.vega_lite import chart_json
from reports.pages.report import Report
from reports.pages.site_data import site_data
from reports.pages.templating import asset, html

FILE = "report.html"
#: Folder of the other pages, their style and scripts, and file of the other questions' data in it.
FOLDER, DATA = "report", "data.js"
#: Scripts of a page with a question, in the order in which they are needed.
QUESTION_SCRIPTS = ("question.js", "marks.js", "plots.js")
FRONT_SCRIPTS = (*QUESTION_SCRIPTS, "panels.js", "words.js", "heat.js", "profile.js", "tables.js")
STYLE = "report.css"


def write_front(report: Report, folder: Path, site: object) -> Path:
    """Write report.html, and the folder beside it with style, scripts and data.

    Parameters
    ----------
    report
        The content.
    folder
        The run folder.
    site
        What all pages show at their side.
    """
    rest = folder / FOLDER
    rest.mkdir(exist_ok=True)
    for name in (STYLE, *FRONT_SCRIPTS):
        (rest / name).write_text(asset(name), encoding="utf-8")
    (rest / DATA).write_text(
        f"stepbench.more({chart_json(site_data(report))});\n", encoding="utf-8"
    )
    path = folder / FILE
    text = html(
        "front.html.j2",
        linked=True,
        report=report,
        site=site,
        root="",
        here=FILE,
        scripts=FRONT_SCRIPTS,
        data=site_data(report, first_only=True),
        more=f"{FOLDER}/{DATA}",
    )
    path.write_text(text, encoding="utf-8")
    return path
