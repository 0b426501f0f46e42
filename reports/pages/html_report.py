"""report.html and its folder report/: pages that need no network; or all of them in one file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from importlib import resources
from importlib.metadata import version
from pathlib import Path

import platformdirs
import vl_convert

from problems.base.cache import cached, put
from reports.charts.vega_lite import chart_json
from reports.pages.chapter import FOLDER, FRONT, Page
from reports.pages.report import read_report
from reports.pages.site import SEARCHED, Site
from reports.pages.site_data import site_data
from reports.pages.templating import html

FILE = FRONT
#: Scripts that are made: the library that draws, and the data of all pages with a question.
LIBRARY, DATA = "vega.js", "data.js"
#: Scripts of a page with a question, in the order in which they are needed.
_QUESTION_SCRIPTS = (DATA, "question.js", "answers.js", "marks.js", "plots.js", "verdict.js")
_FRONT_SCRIPTS = (*_QUESTION_SCRIPTS, "words.js", "panels.js", "heat.js", "profile.js")
#: Scripts of all pages but the front page.
_DRAWING_SCRIPTS = (LIBRARY, "charts.js", "motion.js")


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
    site = Site(read_report(folder), Path(folder), single_file)
    made = {LIBRARY: javascript_library()}
    if data := site_data(site.report):
        text = chart_json(data, separators=(",", ":")).replace("<", "\\u003c")
        head = '// The data of all questions.\n"use strict";\n'
        made[DATA] = f"{head}window.stepbenchData = {text};\n"
    if single_file:
        put(site.folder / FILE, _written(site, site.pages, made))
        return site.folder / FILE
    own = site.folder / FOLDER
    own.mkdir(parents=True, exist_ok=True)
    for old in (*own.glob("scene-*.html"), *own.glob("method-*.html")):
        if old.name not in {page.file for page in site.pages}:
            old.unlink()
    for asset in (resources.files("reports.pages") / "assets").iterdir():
        if asset.name.endswith((".css", ".js")):
            put(own / asset.name, asset.read_bytes())
    for name, text in made.items():
        put(own / name, text)
    for page in reversed(site.pages):  # the front page comes last: what it leads to is there
        put(site.folder / page.path, _written(site, [page], made))
    return site.folder / FILE


def _written(site: Site, pages: Sequence[Page], made: Mapping[str, str]) -> str:
    """The text of a file with these pages."""
    here, kind = pages[0].path, pages[0].kind
    asking = _FRONT_SCRIPTS if kind == "front" else _QUESTION_SCRIPTS if kind == "scene" else ()
    programs = (
        "kept.js",
        *(asking if DATA in made else ()),
        "page.js",
        *(_DRAWING_SCRIPTS if site.single or kind != "front" else ()),
    )
    return html(
        programs,
        assets=None if site.single else FOLDER if kind == "front" else "",
        made=made,
        address=partial(site.address, here=here),
        names=site.names,
        report=site.report,
        site=site,
        pages=pages,
        title=("" if kind == "front" else f"{pages[0].title} · ") + site.report.title,
        about=f"{site.report.title} · {site.runs_text}",
        home="../" * here.count("/") + site.link(site.pages[0]),
        contents=site.contents(here),
        searched=SEARCHED,
        single=site.single,
        data=DATA in made,
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
