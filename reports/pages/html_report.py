"""report.html and its folder report/: pages that need no network; or all of them in one file."""

from __future__ import annotations

from functools import partial
from importlib import resources
from importlib.metadata import version
from pathlib import Path

import platformdirs
import vl_convert

from problems.base.cache import cached, put
from reports.charts.vega_lite import chart_json
from reports.pages.page import FOLDER, FRONT, Link, Page
from reports.pages.report import Report, read_report
from reports.pages.site_data import site_data
from reports.pages.templating import html
from reports.tables.glossary import TERMS

#: Scripts that are made: the library that draws, and the data of all pages with a question.
LIBRARY, DATA = "vega.js", "data.js"
#: Scripts of a page with a question, in the order in which they are needed.
_QUESTION_SCRIPTS = (DATA, "question.js", "marks.js", "plots.js", "verdict.js")
_FRONT_SCRIPTS = (*_QUESTION_SCRIPTS, "front.js")
#: Scripts of all pages but the front page.
_DRAWING_SCRIPTS = (LIBRARY, "charts.js", "motion.js")
#: Pages beside a report that commands write into its folder, with their titles in the contents.
_BESIDE = {"catalogue.html": "Catalogue of scenes", "stability.html": "Stability"}
#: Parts of the contents that show what is searched for, and nothing before.
SEARCHED = ("Methods by name", "Sections", "Words")


class Site:
    """All pages of a report, and the addresses from one to another.

    ``folder`` is the run folder. ``single`` says whether one file holds all pages; a page is then a
    part with an anchor.
    """

    def __init__(self, report: Report, folder: Path, single: bool = False) -> None:
        self.report, self.folder, self.single = report, folder, single
        front = Page(FRONT, "Overview", heading="Answer", kind="front")
        self.glossary = Page("glossary.html", "Glossary", kind="glossary", values={"terms": TERMS})
        self.glossary.runs = [term.anchor for term in TERMS]
        own = [*report.scenes, *report.methods]
        self.pages = [front, *own, *report.chapters, self.glossary]
        #: Anchors and short names of the integrators and scenes that have a page.
        self.names = {p.values["key"]: (p.anchor, p.title) for p in reversed(own)}
        self._places = {anchor: p.path for p in self.pages for anchor in p.anchors}

    def contents(self, here: str) -> list[tuple[str, list[Link]]]:
        """The contents at the side of a page: headings, and the links below each."""
        root = "../" * here.count("/")  # the way to the run folder
        headings = "Answer", "Why", "Scenes", "Not measured yet", "Beside", *SEARCHED
        below: dict[str, list[Link]] = {heading: [] for heading in headings}
        for p in self.pages:
            if p.heading:
                now = p.path == here and not self.single
                link = Link(root + self.link(p), p.title, p.count, now, p.values.get("words", ""))
                below[p.heading].append(link)
        for file, title in _BESIDE.items():
            if not self.single and (self.folder / file).is_file():
                below["Beside"].append(Link(root + file, title))
        methods, sections, words = (below[heading] for heading in SEARCHED)
        for p in self.report.methods:
            words_of = f"{p.values['title']} {p.values['key']}"
            methods.append(Link(root + self.link(p), p.title, words=words_of))
        for p in self.report.chapters:
            for s in p.sections:
                if s.anchor:
                    place = root + self.address(s.anchor, "")
                    sections.append(Link(place, s.title, words=s.found_by))
        place = (root + self.link(self.glossary)).partition("#")[0]
        signs = {"Multiplier": "λ lambda"}
        words += [Link(f"{place}#{t.anchor}", t.title, words=signs.get(t.name, "")) for t in TERMS]
        return [(heading, links) for heading, links in below.items() if links]

    def link(self, page: Page) -> str:
        """The address of a page, relative to the run folder."""
        if self.single:
            return "#main" if page.kind == "front" else f"#{page.anchor}"
        return page.path

    def address(self, anchor: str, here: str) -> str:
        """The address of an anchor for a page: the anchor alone if it is on the same page."""
        file = "" if self.single else self._places.get(anchor, "")
        if file in ("", here):
            return f"#{anchor}"
        return f"{file.removeprefix(FOLDER) if here.startswith(FOLDER) else file}#{anchor}"


def write_html_report(folder: Path, single_file: bool = False) -> Path:
    """Write report.html and report/ into a run folder, from its store alone; return the first page.

    With ``single_file`` report.html holds all pages, and there is no folder.

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
    own, first = site.folder / FOLDER, site.folder / FRONT
    if single_file:
        put(first, _written(site, site.pages, made))
        return first
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
    return first


def _written(site: Site, pages: list[Page], made: dict[str, str]) -> str:
    """The text of a file with these pages."""
    here, kind, report = pages[0].path, pages[0].kind, site.report
    scripts = {"front": _FRONT_SCRIPTS, "scene": _QUESTION_SCRIPTS, "method": _QUESTION_SCRIPTS}
    drawing = _DRAWING_SCRIPTS if site.single or kind != "front" else ()
    failed = f", {report.failed} failed" if report.failed else ""
    return html(
        ("base.js", *(scripts.get(kind, ()) if DATA in made else ()), "page.js", *drawing),
        assets=None if site.single else FOLDER if kind == "front" else "",
        made=made,
        address=partial(site.address, here=here),
        names=site.names,
        report=report,
        pages=pages,
        pictures=None,
        title=("" if kind == "front" else f"{pages[0].title} · ") + report.title,
        about=f"{report.title} · {len(report.run_ids)} runs{failed}",
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
