"""A page: its place, title and body; those that no report holds are written here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from problems.whole_files import put
from reports.pages.templating import html

#: The front page, and the folder of all others.
FRONT, FOLDER = "report.html", "report/"


class Link(NamedTuple):
    """An entry of the contents at the side, with ``number`` small behind it."""

    address: str
    title: str
    number: int | str | None = None
    here: bool = False


@dataclass
class Page:
    """A page: file in its folder, title, template of its body, values, anchors.

    Pages of a report with a ``heading`` are in its contents below it, with ``count``.
    """

    file: str
    kind: str
    title: str
    heading: str = ""
    count: int | str | None = None
    values: dict[str, Any] = field(default_factory=dict)
    anchors: list[str] = field(default_factory=list)

    @property
    def template(self) -> str:
        """The template of the body."""
        return f"{self.kind}.html.j2"

    @property
    def anchor(self) -> str:
        """The anchor of the page where one file holds all."""
        return self.file.removesuffix(".html")

    @property
    def path(self) -> str:
        """The file in the run folder."""
        return self.file if self.file == FRONT else FOLDER + self.file


def write_page(
    page: Page, folder: Path, links: Sequence[Link] = (), programs: Sequence[str] = ("tables.js",)
) -> Path:
    """Write a page that needs no other; a report in the same folder is in its contents."""
    folder.mkdir(parents=True, exist_ok=True)
    home = FRONT if (folder / FRONT).is_file() else ""
    report = [("Report", [Link(home, "Overview")])] if home else []
    text = html(
        "layout.html.j2",
        title=page.title,
        about=page.title,
        home=home,
        searched=(),
        contents=[*report, *([("On this page", links)] if links else [])],
        pages=[page],
        single=True,
        programs=programs,
    )
    put(folder / page.file, text)
    return folder / page.file
