"""The pages of a report: one for each scene and method, and those on what all have in common."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from bench.results.records import Record
from reports.charts.mechanism import motion
from reports.formatting import file_name
from reports.names import scene_name
from reports.pages.chapter import FOLDER, FRONT, Link, Page, Section, chapter_page
from reports.pages.report import Report
from reports.pages.scene_chapter import SceneChapter
from reports.tables.glossary import TERMS
from reports.tables.mathml import mathml
from reports.tables.scene_tables import unknowns

#: Pages beside a report that commands write into its folder, with their titles in the contents.
_BESIDE = {
    "catalogue.html": "Catalogue of scenes",
    "map.html": "Map of outcomes",
    "stability.html": "Stability",
}
#: Parts of the contents that show what is searched for, and nothing before.
SEARCHED = ("Methods by name", "Words")


def scene_page(name: str) -> str:
    """File of a scene's page in the folder of the report."""
    return f"scene-{file_name(name)}.html"


def method_page(label: str) -> str:
    """File of a method's page in the folder of the report."""
    return f"method-{file_name(label)}.html"


@dataclass
class Site:
    """All pages of a report, and the addresses from one to another.

    ``folder`` is the run folder. ``single`` says whether one file holds all pages; a page is then a
    part with an anchor.
    """

    report: Report
    folder: Path
    single: bool = False

    @cached_property
    def pages(self) -> list[Page]:
        """All pages, the front page first."""
        return list(_pages(self.report))

    def contents(self, here: str) -> list[tuple[str, list[Link]]]:
        """The contents at the side of a page: headings, and the links below each."""
        root = "../" * here.count("/")  # the way to the run folder
        headings = "Answer", "Scenes", "Not measured yet", "Why"
        below: dict[str, list[Link]] = {heading: [] for heading in headings}
        for p in self.pages:
            if p.heading:
                now = p.path == here and not self.single
                below[p.heading].append(Link(root + self.link(p), p.title, p.count, now))
        below["Beside"] = [
            Link(root + file, title)
            for file, title in _BESIDE.items()
            if not self.single and (self.folder / file).is_file()
        ]
        below[SEARCHED[0]] = [
            Link(root + self.link(p), p.title) for p in self.pages if p.kind == "method"
        ]
        words = next(root + self.link(p) for p in self.pages if p.kind == "glossary")
        below[SEARCHED[1]] = [
            Link(f"{words.partition('#')[0]}#{term.anchor}", term.title) for term in TERMS
        ]
        return [(heading, links) for heading, links in below.items() if links]

    @property
    def runs_text(self) -> str:
        """How many runs there are, and how many of them failed."""
        failed = self.report.failed
        return f"{len(self.report.run_ids)} runs{f', {failed} failed' if failed else ''}"

    @cached_property
    def names(self) -> dict[str, tuple[str, str]]:
        """Anchors and short names of the integrators and scenes that have a page."""
        methods = {k: (method_page(k), name) for k, name in self.report.names.items()}
        scenes = {s.name: (scene_page(s.name), scene_name(s.name)) for s in self.report.scenes}
        both = methods | scenes
        return {key: (file.removesuffix(".html"), name) for key, (file, name) in both.items()}

    @cached_property
    def _places(self) -> dict[str, str]:
        """The files of anchors."""
        return {anchor: p.path for p in self.pages for anchor in (p.anchor, *p.anchors)}

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


def _pages(report: Report) -> Iterator[Page]:
    yield Page(FRONT, "front", "Overview", "Answer")
    for chapter in report.scenes:
        yield _scene(report, chapter)
    for m in report.methods:
        yield Page(method_page(m.label), "method", report.names[m.label], values={"method": m})
    yield from map(chapter_page, report.chapters)
    terms, anchors = {"terms": TERMS}, [term.anchor for term in TERMS]
    yield Page("glossary.html", "glossary", "Glossary", "Why", values=terms, anchors=anchors)


def _scene(report: Report, chapter: SceneChapter) -> Page:
    scene = report.stored.scenes.get(chapter.name)
    runs = [r for s in report.series[chapter.name] for r in s.records]
    plugins = {m.label: m.plugins for m in report.methods}
    values = {
        "scene": chapter,
        "place": list(report.measured).index(chapter.name) if runs else None,
        "motion": motion(scene.drawings) if scene else None,
        "equations": [*map(mathml, scene.equations)] if scene else [],
        "unknowns": unknowns(scene) if scene else "",
        "end": f"{runs[0].t_end:g}" if runs and all(map(_usual, runs)) else "",
        "plugins": {label: option for label, option in plugins.items() if option},
    }
    anchors = [chapter.anchor, *(report.run_ids[r.key] for r in runs)]
    anchors += [part.anchor for part in chapter.tabs[0].parts if isinstance(part, Section)]
    name = chapter.name
    heading = "Scenes" if runs else "Not measured yet"
    return Page(
        scene_page(name), "scene", scene_name(name), heading, values=values, anchors=anchors
    )


def _usual(run: Record) -> bool:
    """Whether the absolute tolerance is the one that is usual for the relative one."""
    return not (run.rtol and run.atol) or math.isclose(run.atol, run.rtol / 100)
