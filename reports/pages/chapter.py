"""Parts of pages: sections of tables, figures and text, in chapters, and pages of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from bench.results.table import Table
from problems.base.cache import put
from reports.charts.rendering import pictures
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


@dataclass
class Text:
    """A paragraph: text, or a sentence with references; ``kind`` is its class on a page."""

    words: str | Sentence
    kind: str = ""


@dataclass
class Section:
    """Parts under a title, with a number where sections are counted; a page folds some.

    A part is a table, a figure, a text, an animation, texts by name, a list of items, or a section.
    """

    title: str
    parts: Sequence[Any]
    anchor: str = ""
    number: int | None = None
    folded: bool = False

    def __post_init__(self) -> None:
        """Leave out parts that hold nothing."""
        self.parts = [part for part in self.parts if part]

    def __bool__(self) -> bool:
        return bool(self.parts)

    @property
    def figures(self) -> Iterator[Figure]:
        """The figures among the parts."""
        for part in self.parts:
            if isinstance(part, Figure):
                yield part
            elif isinstance(part, Section):
                yield from part.figures


@dataclass
class Chapter:
    """A page of sections: file, title, what a reader learns there, and its place in the contents.

    With a ``summary``, a row for each section, the page has contents.
    """

    file: str
    title: str
    learn: str
    sections: Sequence[Section]
    summary: Table | None = None
    heading: str = "Why"
    count: int | str | None = None

    def __post_init__(self) -> None:
        """Leave out sections that hold nothing."""
        self.sections = [section for section in self.sections if section]

    @property
    def figures(self) -> Iterator[Figure]:
        """The figures of all sections."""
        return (figure for section in self.sections for figure in section.figures)


# ---- pages -------------------------------------------------------------------------------
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
    anchors: Iterable[str] = ()

    @property
    def anchor(self) -> str:
        """The anchor of the page where one file holds all."""
        return self.file.removesuffix(".html")

    @property
    def path(self) -> str:
        """The file in the run folder."""
        return self.file if self.file == FRONT else FOLDER + self.file


def chapter_page(chapter: Chapter, drawn: Mapping[str, str] | None = None) -> Page:
    """The page of a chapter, with its pictures by name as SVG or, without any, with scripts."""
    values = {"chapter": chapter, "pictures": drawn}
    anchors = [s.anchor for s in chapter.sections if s.anchor]
    at = chapter.heading, chapter.count
    return Page(chapter.file, "chapter", chapter.title, *at, values=values, anchors=anchors)


def write_chapter(chapter: Chapter, folder: Path, programs: Sequence[str] = ("page.js",)) -> Path:
    """Write a chapter with still charts as a page that needs no other.

    A report in the same folder is in its contents.
    """
    folder.mkdir(parents=True, exist_ok=True)
    charts = {name: chart for f in chapter.figures for name, chart in f.charts.items()}
    drawn = {name: picture.svg for name, picture in pictures(charts).items()}
    home = FRONT if (folder / FRONT).is_file() else ""
    links = [Link(f"#{s.anchor}", s.title.partition(": ")[0]) for s in chapter.sections if s.anchor]
    contents = {"Report": [Link(home, "Overview")] if home else [], "On this page": links}
    text = html(
        programs,
        title=chapter.title,
        about=chapter.title,
        home=home,
        searched=(),
        contents=[pair for pair in contents.items() if pair[1]],
        pages=[chapter_page(chapter, drawn)],
        single=True,
    )
    put(folder / chapter.file, text)
    return folder / chapter.file
