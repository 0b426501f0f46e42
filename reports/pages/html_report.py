"""report.html and its folder report/: pages that need no network; or all of them in one file."""

from __future__ import annotations

import contextlib
import hashlib
from functools import partial
from importlib.metadata import version
from pathlib import Path

import platformdirs
import vl_convert

from problems.whole_files import keep, kept, put
from reports.charts.vega_lite import chart_json
from reports.pages.addresses import FOLDER, FRONT
from reports.pages.packing import packed
from reports.pages.report import read_report
from reports.pages.site import QUESTION_SCRIPTS, Page, named, report_site, write_pages
from reports.pages.site_data import for_first_question, for_front, site_data
from reports.pages.templating import html

FILE = FRONT
LIBRARY = "vega.js"
FRONT_SCRIPTS = (*QUESTION_SCRIPTS, "panels.js", "heat.js", "profile.js")


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
    report = read_report(folder, interactive=True)
    site, pages = report_site(report, single_file)
    data = site_data(report)
    more = ""  # the file with the answers to all questions but the first, which report.html holds
    if not single_file:
        write_pages(report, folder, data)
        put(folder / FOLDER / LIBRARY, javascript_library())
        rest = chart_json(packed(for_front(data)), separators=(",", ":"))
        rest = f"stepbench.more({rest});\n"
        more = f"{FOLDER}data-{hashlib.sha256(rest.encode()).hexdigest()[:8]}.js"
        put(folder / more, rest)
    text = html(
        "page_of_report.html.j2",
        address=partial(site.address, here=FILE),
        names=named(report),
        linked=not single_file,
        report=report,
        site=site,
        pages=[Page(FILE, "front.html.j2", report.title, "front"), *(pages if single_file else [])],
        root="",
        here=FILE,
        single=single_file,
        library=javascript_library() if single_file else "",
        data=packed(data if single_file else for_first_question(data)),
        more=more,
        scripts=FRONT_SCRIPTS,
        pages_at="" if single_file else FOLDER,
    )
    path = folder / FILE
    put(path, text)
    for old in folder.glob(f"{FOLDER}data*.js"):
        if old != folder / more:
            old.unlink()
    return path


def javascript_library() -> str:
    """The JavaScript that draws the charts.

    Its making takes seconds, so a copy is kept in the user's cache folder if possible.
    """
    file = Path(platformdirs.user_cache_dir("stepbench")) / f"vega-{version('vl-convert-python')}"
    if (copy := kept(file)) is not None:
        return copy.decode()
    # The type stub lacks the default of the argument.
    text = vl_convert.javascript_bundle()  # pyright: ignore[reportCallIssue]
    text = text.replace("</script", "<\\/script")
    with contextlib.suppress(OSError):
        keep(file, text.encode())
    return text
