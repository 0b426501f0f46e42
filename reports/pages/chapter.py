"""A chapter of the report that is a page of its own, too: what a study found, in sections."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from bench.results.table import Table
from reports.charts.rendering import pictures
from reports.pages.captioned_charts import CaptionedCharts
from reports.pages.page import Link, Page, write_page


@dataclass
class Section:
    """Tables and figures in their order, below a paragraph, a verdict and sentences.

    ``good`` says whether the verdict is as expected; ``facts`` are texts by name at the end.
    """

    anchor: str
    title: str
    parts: list[Table | CaptionedCharts]
    number: int | None = None
    claim: str = ""
    verdict: str = ""
    good: bool = True
    sentences: list[str] = field(default_factory=list)
    note: str = ""
    facts: dict[str, str] = field(default_factory=dict)

    @property
    def figures(self) -> list[CaptionedCharts]:
        """The figures among the parts."""
        return [part for part in self.parts if isinstance(part, CaptionedCharts)]


@dataclass
class Chapter:
    """A study: its file, what it is about, on a page of its own and in the report, its sections.

    With a ``summary``, a row for each section, it has contents.
    """

    file: str
    title: str
    about: str
    learn: str
    sections: list[Section]
    summary: Table | None = None

    @property
    def figures(self) -> Iterator[CaptionedCharts]:
        """The figures of all sections."""
        return (figure for section in self.sections for figure in section.figures)


def write_chapter(chapter: Chapter, folder: Path) -> Path:
    """Write a chapter with still charts as a page into a folder."""
    charts = {name: chart for f in chapter.figures for name, chart in f.charts.items()}
    drawn = {name: picture.svg for name, picture in pictures(charts).items()}
    values = {"chapter": chapter, "pictures": drawn}
    links = [Link(f"#{s.anchor}", s.title) for s in chapter.sections]
    return write_page(Page(chapter.file, "chapter", chapter.title, values=values), folder, links)
