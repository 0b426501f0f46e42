"""Output in the terminal: lines, the style of tables, and the progress of a run."""

from __future__ import annotations

import sys
import time

from rich.console import Console, Group
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Table
from rich.text import Text

#: Without a terminal a line is printed this often, in s, instead of a moving bar.
_QUIET_SECONDS = 5.0


def show(content: Table | Group) -> None:
    """Print tables and lines on standard output."""
    Console().print(content)


def say(line: Text | str) -> None:
    """Print a line as it is, however long: the terminal wraps it."""
    Console().print(line, soft_wrap=True, markup=False, highlight=False)


def new_table(title: str = "") -> Table:
    """Make an empty table in the style of all tables of the command line."""
    return Table(
        title=escape(title) or None,
        title_justify="left",
        title_style="bold",
        box=None,
        pad_edge=False,
        padding=(0, 2, 0, 0),
    )


class RunProgress:
    """A progress bar that names the cell in work; plain lines where there is no terminal."""

    def __init__(self) -> None:
        self._console = Console(file=sys.stderr)
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("{task.fields[phase]}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("[dim]{task.description}[/dim]"),
            console=self._console,
            transient=True,
            disable=not self._console.is_terminal,
        )
        self._task: TaskID | None = None
        self._phase, self._done, self._total, self._spoken = "", 0, 0, 0.0

    def __enter__(self) -> RunProgress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def phase(self, name: str, total: int) -> None:
        """Begin a phase of this many steps."""
        if self._task is not None:
            self._bar.remove_task(self._task)
        self._task = self._bar.add_task("", total=total, phase=name)
        self._phase, self._done, self._total = name, 0, total
        self._say()

    def working(self, text: str) -> None:
        """Show the name of the work in hand."""
        if self._task is not None:
            self._bar.update(self._task, description=escape(text))

    def advance(self) -> None:
        """Count one step as done."""
        if self._task is not None:
            self._bar.advance(self._task)
        self._done += 1
        if self._done == self._total or time.monotonic() - self._spoken > _QUIET_SECONDS:
            self._say()

    def note(self, text: str) -> None:
        """Print a warning."""
        self._console.print(escape(text))

    def _say(self) -> None:
        self._spoken = time.monotonic()
        if not self._console.is_terminal:
            self._console.print(f"{self._phase}: {self._done} of {self._total}")
