"""Pages and pictures. The bench imports no writer of pages: entry points name them."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from bench.guard.process import GuardedProcess

#: A run that lasts longer than this, in s, has a page before it ends.
_FIRST_SECONDS = 15.0
#: Between two drawings of it pass so many times the seconds that one takes.
_SELDOM = 20.0


def view(name: str) -> Callable[..., Any]:
    """Load the writer of one kind of page or picture (entry points `stepbench.views`)."""
    (entry,) = entry_points(group="stepbench.views", name=name)
    return entry.load()


def write_reports(folder: Path, single_file: bool = False) -> None:
    """Write all reports (entry points `stepbench.reports`) of the results in a folder.

    Parameters
    ----------
    folder
        The run folder.
    single_file
        Whether the HTML report is one file instead of a page and a folder.

    Raises
    ------
    click.ClickException
        If one cannot be written; the others are.
    """
    from bench.guard.process import GuardedProcess, NoAnswer

    # One process for each page: they do not wait for each other, and each may fail alone.
    pages: dict[str, GuardedProcess] = {}
    failed = []
    for writer in sorted(entry_points(group="stepbench.reports"), key=lambda entry: entry.name):
        pages[writer.name] = GuardedProcess(_load_writer, (writer.value,))
        pages[writer.name].start(_write_report, str(folder), single_file and writer.name == "html")
    for name, page in pages.items():
        answer = page.answer()
        page.end()
        if printed := page.printed():
            click.echo(printed, err=True)
        if isinstance(answer, NoAnswer):
            failed.append(f"The {name} report could not be written: {answer.message}")
        else:
            click.echo(f"Report: {os.fsdecode(answer)}")
    if failed:
        raise click.ClickException(" ".join([*failed, "The results are stored."]))


class GrowingPage:
    """The HTML report of results that still come: drawn by a process beside, now and then.

    Parameters
    ----------
    folder
        The run folder.
    say
        Tells the person who waits where the page is, once, or why there is none.
    """

    def __init__(self, folder: Path, say: Callable[[str], None]) -> None:
        self._folder, self._say, self._said = folder, say, False
        self._process: GuardedProcess | None = None
        self._resting = False
        self._begun, self._next = 0.0, time.monotonic() + _FIRST_SECONDS

    def __enter__(self) -> GrowingPage:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def look(self) -> None:
        """Draw the page if it is time to; called after each result, it never waits."""
        from bench.guard.process import GuardedProcess

        if self._process:
            if (answer := self._process.take()) is not None:
                self._drawn(answer)
        elif not self._resting and time.monotonic() >= self._next:
            (writer,) = entry_points(group="stepbench.reports", name="html")
            self._begun = time.monotonic()
            self._process = GuardedProcess(_load_writer, (writer.value,))
            self._process.start(_write_report, os.fspath(self._folder), False)

    @contextmanager
    def at_rest(self) -> Iterator[None]:
        """Draw nothing meanwhile: nothing else may run where times are taken."""
        if self._process:
            self._drawn(self._process.answer())
        self._resting = True
        try:
            yield
        finally:
            self._resting = False

    def _drawn(self, answer: Any) -> None:
        from bench.guard.process import NoAnswer

        self._end()
        now = time.monotonic()
        self._next = now + _SELDOM * (now - self._begun)
        if not self._said:
            self._said = True
            lost = isinstance(answer, NoAnswer)
            self._say(
                f"The page cannot be drawn while runs go: {answer.message}"
                if lost
                else f"Page so far: {os.fsdecode(answer)}; it is drawn again while runs go."
            )

    def _end(self) -> None:
        if self._process:
            self._process.end()
            self._process = None


# ---- in the process of a page ------------------------------------------------------------
_Writer = Callable[..., Path]


def _load_writer(notify: Any, value: str) -> _Writer:
    return EntryPoint("report", value, "stepbench.reports").load()


def _write_report(writer: _Writer, folder: str, single_file: bool) -> bytes:
    more = {"single_file": True} if single_file else {}
    return os.fsencode(writer(Path(folder), **more))  # a name may be no text
