"""Files of the pages of a report, and addresses from one to another."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from reports.formatting import file_name
from reports.names import scene_name
from reports.pages.report import Report

#: The front page, and the folder of all others.
FRONT, FOLDER = "report.html", "report/"


def scene_page(name: str) -> str:
    """File of a scene's page in the folder of the report."""
    return f"scene-{file_name(name)}.html"


def method_page(label: str) -> str:
    """File of a method's page in the folder of the report."""
    return f"method-{file_name(label)}.html"


@dataclass(frozen=True)
class Link:
    """An entry of the contents; ``count`` stands small behind it."""

    text: str
    address: str
    count: int | None = None


@dataclass
class Site:
    """Contents at the side of all pages of a report, and the addresses of anchors.

    ``places`` are the addresses of anchors, relative to the run folder.
    """

    title: str
    runs_text: str
    contents: list[tuple[str, list[Link]]]
    places: Mapping[str, str] = field(default_factory=dict)

    def address(self, anchor: str, here: str) -> str:
        """The address of an anchor for a page: the anchor alone if it is on the same page."""
        place = self.places.get(anchor, "")
        file, _, _ = place.partition("#")
        if not file or file == here:
            return f"#{anchor}"
        return place.removeprefix(FOLDER) if here.startswith(FOLDER) else place


def site_of(report: Report, anchors: Iterable[tuple[str, str]] = (), single: bool = False) -> Site:
    """The contents of a report.

    Parameters
    ----------
    report
        Its content.
    anchors
        Pairs of an anchor and the file in which it is.
    single
        Whether one file holds all pages; a page is then a part with an anchor.
    """

    def page(file: str) -> str:
        return f"#{file.removesuffix('.html')}" if single else FOLDER + file

    answer = [
        Link("Overview", "#main" if single else FRONT),
        Link("Methods", page("methods.html"), len(report.methods)),
        Link("Failures", page("failures.html"), report.failed),
    ]
    scenes = [Link(scene_name(s.name), page(scene_page(s.name))) for s in report.scenes]
    why = [Link("Orders", page("orders.html"))] if report.orders else []
    why += [Link("Long runs", page("drift.html"))] if report.long_runs else []
    why += [Link("Failure atlas", page("atlas.html"))] if report.atlas else []
    why.append(Link("How it was measured", page("measured.html")))
    why.append(Link("Glossary", page("glossary.html")))
    contents = [("Answer", answer), ("Scenes", scenes), ("Why", why)]
    runs = f"{len(report.run_ids)} runs"
    return Site(
        title=report.title,
        runs_text=f"{runs}, {report.failed} failed" if report.failed else runs,
        contents=[(heading, links) for heading, links in contents if links],
        places={} if single else {anchor: f"{file}#{anchor}" for anchor, file in anchors},
    )
