"""report.html and its folder report/: pages that need no network; or all of them in one file."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import partial
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Any

import platformdirs
import vl_convert

from problems.whole_files import cached, put
from reports.charts.vega_lite import chart_json
from reports.pages.page import FOLDER, FRONT, Page
from reports.pages.report import read_report
from reports.pages.site import Site
from reports.pages.site_data import SiteData
from reports.pages.templating import html

FILE = FRONT
LIBRARY = "vega.js"
#: Scripts of a page with a question, in the order in which they are needed.
_QUESTION_SCRIPTS = ("question.js", "answers.js", "marks.js", "plots.js", "verdict.js", "words.js")
_FRONT_SCRIPTS = (*_QUESTION_SCRIPTS, "panels.js", "heat.js", "profile.js")
#: Scripts of all pages but the front page.
_DRAWING_SCRIPTS = (LIBRARY, "tabs.js", "charts.js", "motion.js")


def write_html_report(folder: Path, single_file: bool = False) -> Path:
    """Write report.html and report/ into a run folder, from its store alone.

    Parameters
    ----------
    folder
        The run folder.
    single_file
        Whether report.html holds all pages, and there is no folder.

    Returns
    -------
    pathlib.Path
        The first page.

    Raises
    ------
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    folder = Path(folder)
    site = Site(read_report(folder, interactive=True), folder, single_file)
    data = SiteData(site.report)
    data = data if data.groups else None  # without errors there is nothing to ask
    more = ""  # the file with the answers to all questions but the first, which report.html holds
    if single_file:
        everything = data.everything() if data else None
        text = _written(site, site.pages, everything, library=javascript_library())
    else:
        _write_others(site, data, folder / FOLDER)
        if data:
            rest = chart_json(data.further_questions(), separators=(",", ":"))
            rest = f"stepbench.more({rest});\n"
            more = f"{FOLDER}data-{hashlib.sha256(rest.encode()).hexdigest()[:8]}.js"
            put(folder / more, rest)
        text = _written(site, site.pages[:1], data and data.first_question(), more)
    put(folder / FILE, text)
    for old in folder.glob(f"{FOLDER}data*.js"):
        if old != folder / more:
            old.unlink()
    return folder / FILE


def _write_others(site: Site, data: SiteData | None, folder: Path) -> None:
    """Write all pages but the first, and what they share."""
    folder.mkdir(parents=True, exist_ok=True)
    for page in site.pages[1:]:
        own = None
        if data and page.kind == "scene" and page.values["place"] is not None:
            own = data.scene(page.values["scene"].name)
        put(folder / page.file, _written(site, [page], own))
    kept_files = {page.file for page in site.pages}
    for old in (*folder.glob("scene-*.html"), *folder.glob("method-*.html")):
        if old.name not in kept_files:
            old.unlink()
    for asset in (resources.files("reports.pages") / "assets").iterdir():
        if asset.name.endswith((".css", ".js")):
            put(folder / asset.name, asset.read_bytes())
    put(folder / LIBRARY, javascript_library())


def _written(
    site: Site,
    pages: Sequence[Page],
    data: dict[str, Any] | None,
    more: str = "",
    library: str = "",
) -> str:
    """The text of a file with these pages."""
    here, front = pages[0].path, pages[0].kind == "front"
    asking = (_FRONT_SCRIPTS if front else _QUESTION_SCRIPTS) if data else ()
    drawing = () if front and not site.single else _DRAWING_SCRIPTS
    title = "" if front else f"{pages[0].title} · "
    return html(
        "layout.html.j2",
        assets=None if front else "",
        address=partial(site.address, here=here),
        names=site.names,
        linked=front and not site.single,
        report=site.report,
        site=site,
        pages=pages,
        title=title + site.report.title,
        about=f"{site.report.title} · {site.runs_text}",
        home="../" * here.count("/") + site.link(site.pages[0]),
        contents=site.contents(here),
        single=site.single,
        library=library,
        data=data,
        more=more,
        programs=("kept.js", *asking, "tables.js", *drawing),
        pages_at=FOLDER if front and not site.single else "",
    )


def javascript_library() -> str:
    """The JavaScript that draws the charts.

    Its making takes seconds, so a copy is kept in the user's cache folder if possible.
    """
    file = Path(platformdirs.user_cache_dir("stepbench")) / f"vega-{version('vl-convert-python')}"

    def bundle() -> bytes:
        # The type stub lacks the default of the argument.
        text = vl_convert.javascript_bundle()  # pyright: ignore[reportCallIssue]
        return text.replace("</script", "<\\/script").encode()

    return cached(file, bundle).decode()
