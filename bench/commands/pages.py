"""Reports of a folder: pages that writers make (entry points `stepbench.reports`)."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from bench.guard.process import GuardedProcess, NoAnswer

#: A page is drawn at the first result after this time, in s.
_FIRST_SECONDS = 15.0
#: Between two drawings of it pass so many times the seconds that one takes.
_SELDOM = 20.0


def write_reports(folder: Path, single_file: bool = False) -> None:
    """Write all reports of the results in a folder.

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
    from bench.guard.process import NoAnswer

    # One process for each page: they do not wait for each other, and each may fail alone.
    names = sorted(entry_points(group="stepbench.reports").names)
    pages = {name: _writing(name, folder, single_file and name == "html") for name in names}
    failed = []
    for name, page in pages.items():
        answer = page.answer()
        page.end()
        if printed := page.printed():
            click.echo(printed, err=True)
        if isinstance(answer, NoAnswer):
            failed.append(f"The {name} report could not be written: {answer.message}")
        else:
            click.echo(f"Report: {os.fsdecode(answer[0])}")
    if failed:
        raise click.ClickException(" ".join([*failed, "The results are stored."]))


class GrowingPage:
    """The HTML report of results that still come: drawn by a process beside, now and then.

    Parameters
    ----------
    folder
        The run folder.
    say
        Tells the person who waits, once, where the page is or why there is none.
    """

    def __init__(self, folder: Path, say: Callable[[str], None]) -> None:
        self._folder, self._say = folder, say
        self._process: GuardedProcess | None = None
        self._drawn = self._resting = False
        self._next = time.monotonic() + _FIRST_SECONDS

    def __enter__(self) -> GrowingPage:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def look(self) -> None:
        """Draw the page if it is time to; called after each result, it never waits."""
        if self._process:
            if (answer := self._process.poll()) is not None:
                self._take(answer)
        elif not self._resting and time.monotonic() >= self._next:
            try:
                self._process = _writing("html", self._folder)
            except OSError as error:  # no processes, files or memory are left
                self._give_up(f"{error}.")

    @contextmanager
    def at_rest(self) -> Iterator[None]:
        """Draw nothing meanwhile: nothing else may run where times are taken."""
        if self._process:
            self._take(self._process.answer())
        self._resting = True
        try:
            yield
        finally:
            self._resting = False

    def _take(self, answer: tuple[bytes, float] | NoAnswer) -> None:
        self._end()
        if not isinstance(answer, tuple):
            self._give_up(answer.message)
            return
        path, seconds = answer
        self._next = time.monotonic() + _SELDOM * seconds
        if not self._drawn:
            self._drawn = True
            self._say(f"Page so far: {os.fsdecode(path)}")

    def _give_up(self, reason: str) -> None:
        self._next = math.inf
        self._say(f"No page is drawn while runs go: {reason}")

    def _end(self) -> None:
        if self._process:
            self._process.end()
            self._process = None


def _writing(name: str, folder: Path, single_file: bool = False) -> GuardedProcess:
    """Begin to write a report in a process of its own; it answers with the file and the seconds."""
    from bench.guard.process import GuardedProcess

    process = GuardedProcess(_load_writer, (name,))
    process.start(_write_report, str(folder), single_file)
    return process


# ---- in the process of a page ------------------------------------------------------------
def _load_writer(notify: Any, name: str) -> Callable[..., Path]:
    return next(iter(entry_points(group="stepbench.reports", name=name))).load()


def _write_report(writer: Callable[..., Path], folder: str, single: bool) -> tuple[bytes, float]:
    begun = time.monotonic()
    path = writer(Path(folder), **({"single_file": True} if single else {}))
    return os.fsencode(path), time.monotonic() - begun  # a name may be no text
