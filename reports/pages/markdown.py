"""report.md: the same content as the HTML page, for reading beside code, with SVG pictures."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import jinja2

from reports.charts.rendering import draw
from reports.pages.report import Page, read_page
from reports.pages.scene_chapter import Figure
from reports.text.tables import Table

FILE = "report.md"
FIGURES = "report_figures"


def write(folder: Path) -> Path:
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
    page = read_page(folder, interactive=False)
    charts = {name: chart for f in _figures(page) for name, chart in f.charts.items()}
    draw(charts, Path(folder) / FIGURES)
    path = Path(folder) / FILE
    path.write_text(render("report.md.j2", page=page, figures=FIGURES), encoding="utf-8")
    return path


def render(name: str, **values: object) -> str:
    """A template's text without runs of blank lines."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("reports.pages"),
        autoescape=False,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters |= {"md": escape, "code": code, "table": table}
    text = environment.get_template(name).render(**values)
    return re.sub(r"\n{3,}", "\n\n", text).rstrip() + "\n"


def _figures(page: Page) -> Iterator[Figure]:
    yield from page.overview
    for scene in page.scenes:
        yield from [scene.picture] if scene.picture else []
        yield from (figure for study in scene.studies for figure in study.figures)
    for card in page.atlas.cards if page.atlas else ():
        yield from card.figures


def escape(text: object) -> str:
    """Text in which no character means markup, on one line."""
    flat = " ".join(str(text).split())
    flat = flat.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return re.sub(r"([\\`*_\[\]|#~$])", r"\\\1", flat)


def code(text: object) -> str:
    """Text set as code, fit for a table's cell."""
    flat = " ".join(str(text).split()).replace("`", "'")
    return f"`{flat}`".replace("|", "\\|") if flat else ""


def table(content: Table) -> str:
    """A table in GitHub's dialect, with its caption and note."""
    lines = [_row(escape(head) for head in content.head), _row("---" for _ in content.head)]
    for i, cells in enumerate(content.rows):
        shown = [code(c) if j in content.code else escape(c) for j, c in enumerate(cells)]
        lines.append(_row(f"**{c}**" if (i, j) in content.best else c for j, c in enumerate(shown)))
    # With a colon: a line that is nothing but bold would pass for a heading.
    parts = [f"**{escape(content.caption)}**:", "\n".join(lines)]
    return "\n\n".join([*parts, escape(content.note)] if content.note else parts)


def _row(cells: object) -> str:
    return f"| {' | '.join(cells)} |"
