"""report.html and its folder report/: pages that need no network; or all of them in one file."""

from __future__ import annotations

import contextlib
import hashlib
import os
from functools import partial
from importlib.metadata import version
from pathlib import Path

import platformdirs
import vl_convert

from reports.charts.vega_lite import chart_json
from reports.pages.addresses import FOLDER, FRONT
from reports.pages.packing import packed
from reports.pages.report import read_report
from reports.pages.site import QUESTION_SCRIPTS, Page, named, report_site, write_pages
from reports.pages.site_data import for_first_question, for_front, site_data
from reports.pages.templating import html

FILE = FRONT
LIBRARY = "vega.js"
#: Answers to all questions but the first, which report.html holds.
DATA = "data.js"
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
    if not single_file:
        write_pages(report, folder, data)
        (folder / FOLDER / LIBRARY).write_text(javascript_library(), encoding="utf-8")
        rest = chart_json(packed(for_front(data)), separators=(",", ":"))
        rest = f"stepbench.more({rest});\n"
        (folder / FOLDER / DATA).write_text(rest, encoding="utf-8")
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
        more="" if single_file else FOLDER + DATA,
        scripts=FRONT_SCRIPTS,
        pages_at="" if single_file else FOLDER,
    )
    path, new = folder / FILE, folder / f".{FILE}.new"
    new.write_text(text, encoding="utf-8")
    new.replace(path)  # somebody may be reading it while runs go
    return path


def javascript_library() -> str:
    """The JavaScript that draws the charts.

    Its making takes seconds, so a copy is kept in the user's cache folder if possible. Its first
    line is the digest of the others; a copy that differs is made anew.
    """
    folder = Path(platformdirs.user_cache_dir("stepbench"))
    kept = folder / f"vega-{version('vl-convert-python')}.js"
    with contextlib.suppress(OSError, UnicodeDecodeError):
        digest, _, text = kept.read_text(encoding="utf-8").partition("\n")
        if digest == _digest(text):
            return text
    # The type stub lacks the default of the argument.
    text = vl_convert.javascript_bundle()  # pyright: ignore[reportCallIssue]
    text = text.replace("</script", "<\\/script")
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        # Two processes may write at a time: each puts a whole file in place.
        own = kept.with_suffix(f".{os.getpid()}")
        own.write_text(f"{_digest(text)}\n{text}", encoding="utf-8")
        own.replace(kept)
    return text


def _digest(text: str) -> str:
    return f"// sha256 {hashlib.sha256(text.encode()).hexdigest()}"
