"""Pages and their parts: sections of tables, figures and text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from bench.results.table import Table
from problems.base.cache import put
from reports.charts.rendering import pictures
from reports.formatting import file_name
from reports.pages.templating import html
from reports.questions import Sentence

#: The front page, and the folder of all others.
FRONT, FOLDER = "report.html", "report/"


@dataclass
class Figure:
    """Charts by name (an anchor, a file name) that share a caption; those of None are left out.

    Those ``on_paper`` are drawn by the scripts of pages: Markdown alone has them.
    """

    caption: str
    charts: Mapping[str, Any]
    on_paper: bool = False

    def __post_init__(self) -> None:
        """Leave out charts that hold nothing."""
        self.charts = {name: chart for name, chart in self.charts.items() if chart is not None}

    def __bool__(self) -> bool:
        return bool(self.charts)


class Text(NamedTuple):
    """A paragraph: text, or a sentence with references; ``kind`` is its class on a page."""

    words: str | Sentence
    kind: str = ""


@dataclass
class Section:
    """Parts under a title, with a number where sections are counted; a page folds some.

    The contents find one with an anchor by its title, and by the words ``found_by``. A part is a
    table, a figure, a text, an animation, texts by name, a list of items, or a section; those that
    hold nothing are left out.
    """

    title: str
    parts: Sequence[Any]
    anchor: str = ""
    number: int | None = None
    folded: bool = False
    found_by: str = ""

    def __post_init__(self) -> None:
        """Leave out parts that hold nothing."""
        self.parts = [part for part in self.parts if part]

    def __bool__(self) -> bool:
        return bool(self.parts)


@dataclass
class Page:
    """A page: its file, title, what a reader learns there, and sections that hold something.

    ``kind`` names its template, ``values`` are more for it; with a ``summary``, a row for each
    section, the page has contents. Pages of a report with a ``heading`` are in its contents below
    it, with ``count``. ``runs`` are anchors of runs.
    """

    file: str
    title: str
    learn: str = ""
    sections: Sequence[Section] = ()
    summary: Table | None = None
    heading: str = "Why"
    count: int | str | None = None
    kind: str = "chapter"
    values: dict[str, Any] = field(default_factory=dict)
    runs: Sequence[str] = ()

    def __post_init__(self) -> None:
        """Leave out sections that hold nothing."""
        self.sections = [section for section in self.sections if section]

    @property
    def anchor(self) -> str:
        """The anchor of the page where one file holds all."""
        return self.file.removesuffix(".html")

    @property
    def path(self) -> str:
        """The file in the run folder."""
        return self.file if self.file == FRONT else FOLDER + self.file

    @property
    def anchors(self) -> list[str]:
        """All anchors of the page."""
        inner = [p.anchor for p in _parts(self.sections) if isinstance(p, Section) and p.anchor]
        return [self.anchor, *inner, *self.runs]

    @property
    def figures(self) -> list[Figure]:
        """The figures of all sections."""
        return [part for part in _parts(self.sections) if isinstance(part, Figure)]


def _parts(parts: Sequence[Any]) -> Iterator[Any]:
    """All parts, and the parts of sections among them."""
    for part in parts:
        yield part
        yield from _parts(part.parts) if isinstance(part, Section) else ()


def page_file(kind: str, key: str) -> str:
    """The file of the page of a "scene" or a "method"."""
    return f"{kind}-{file_name(key)}.html"


class Link(NamedTuple):
    """An entry of the contents at the side, with ``number`` small behind it.

    It is found by its title and by ``words``, which are not shown.
    """

    address: str
    title: str
    number: int | str | None = None
    here: bool = False
    words: str = ""


def write_page(page: Page, folder: Path, programs: Sequence[str] = ("base.js", "page.js")) -> Path:
    """Write a page with still charts that needs no other.

    A report in the same folder is in its contents.
    """
    folder.mkdir(parents=True, exist_ok=True)
    charts = {name: chart for f in page.figures for name, chart in f.charts.items()}
    home = FRONT if (folder / FRONT).is_file() else ""
    links = [Link(f"#{s.anchor}", s.title.partition(": ")[0]) for s in page.sections if s.anchor]
    contents = {"Report": [Link(home, "Overview")] if home else [], "On this page": links}
    text = html(
        programs,
        title=page.title,
        about=page.title,
        home=home,
        searched=(),
        contents=[pair for pair in contents.items() if pair[1]],
        pages=[page],
        pictures={name: picture.svg for name, picture in pictures(charts).items()},
        single=True,
    )
    put(folder / page.file, text)
    return folder / page.file
