"""Output in the terminal: lines, tables, and the progress of a run."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterable
from typing import Any, TextIO

from rich import table as rich_table
from rich.console import Console, RenderableType
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from bench.results.table import Table
from bench.running import progress

#: Tables are never narrower, in characters, however small COLUMNS is.
_LEAST_WIDTH = 40
#: Columns of text have so many characters, or as many as they need.
_LEAST_TEXT = 16
#: Without a terminal a line is printed this often, in s, instead of a moving bar.
_LINE_EVERY_SECONDS = 5.0


class _WideConsole(Console):
    """A console that is never too narrow for a table."""

    def __init__(self, file: TextIO) -> None:
        super().__init__(file=file)
        if self.width < _LEAST_WIDTH:
            self.width = _LEAST_WIDTH


def show(*parts: Table | str) -> None:
    """Print tables with their notes and texts on standard output, within its width."""
    console = _WideConsole(sys.stdout)
    for part in parts:
        if isinstance(part, str):
            console.print(Text(part))
            continue
        console.print(_drawn(part))
        if part.note:
            console.print(Text(part.note))


def _drawn(table: Table) -> rich_table.Table:
    """A table without lines; a name that the row above begins with is left out."""
    drawn = rich_table.Table(
        title=Text(table.caption) if table.caption else None,
        title_justify="left",
        title_style="bold",
        box=None,
        pad_edge=False,
        padding=(0, 2, 0, 0),
    )
    for j, head in enumerate(table.head):
        style, number = "" if j else "cyan", j in table.numbers
        justify = "right" if number else "left"
        longest = max(len(cell) for cell in (head, *(row[j] for row in table.rows)))
        drawn.add_column(
            Text(head), style=style, justify=justify, no_wrap=number, overflow="fold",
            min_width=None if number else min(_LEAST_TEXT, longest),
        )  # fmt: skip
    above = ""
    for i, (name, *others) in enumerate(table.rows):
        cells = ["" if name == above else name, *others]
        styles = ["bold" if (i, j) in table.best else "" for j in range(len(cells))]
        drawn.add_row(*map(Text, cells, styles))
        above = name
    return drawn


def say(line: Text | str, cut: bool = False) -> None:
    """Print a line, however long: the terminal wraps it, unless it is ``cut`` where that ends."""
    how: dict[str, Any] = {"no_wrap": True, "overflow": "ellipsis"} if cut else {"soft_wrap": True}
    _WideConsole(sys.stdout).print(line, markup=False, highlight=False, **how)


class _Bar(Progress):
    """A progress bar with a line below it."""

    found = ""

    def get_renderables(self) -> Iterable[RenderableType]:
        yield from super().get_renderables()
        if self.found:
            yield Text(self.found, style="dim", no_wrap=True, overflow="ellipsis")


class RunProgress(progress.Progress):
    """A progress bar with the cell in work and the last result; plain lines without a terminal.

    Parameters
    ----------
    lines
        Whether, without a terminal, phases, the first result, and work that belongs to no phase
        and takes long are told in lines.
    """

    def __init__(self, lines: bool = True) -> None:
        super().__init__()
        self._lines = lines
        self._console = _WideConsole(sys.stderr)
        self._bar = _Bar(
            SpinnerColumn(),
            TextColumn("{task.fields[phase]}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("[dim]{task.description}[/dim]"),
            console=self._console,
            transient=True,
            disable=not self._console.is_terminal,
        )
        self._spoken = 0.0
        self._wait = threading.Timer(0.0, lambda: None)

    def __enter__(self) -> RunProgress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._wait.cancel()
        self._bar.stop()

    def phase(self, name: str, total: int | None) -> None:
        """Begin a phase of this many steps, or of an unknown number."""
        self._wait.cancel()
        for earlier in self._bar.task_ids:
            self._bar.remove_task(earlier)
        self._bar.add_task("", total=total, phase=name)
        self._say()

    def working(self, text: str) -> None:
        """Show the name of the work in hand, which may belong to no phase."""
        if not self._bar.tasks:
            self._bar.add_task("", total=None, phase="")
        task = self._bar.tasks[0]
        if task.description == escape(text):
            return
        self._bar.update(task.id, description=escape(text))
        self._wait.cancel()
        if self._lines and not (task.fields["phase"] or self._console.is_terminal):
            self._wait = threading.Timer(_LINE_EVERY_SECONDS, self.note, [f"Waiting: {text}"])
            self._wait.daemon = True
            self._wait.start()

    def advance(self) -> None:
        """Count one step as done."""
        for task in self._bar.tasks:
            self._bar.advance(task.id)
            if task.finished or time.monotonic() - self._spoken > _LINE_EVERY_SECONDS:
                self._say()

    def found(self, text: str) -> None:
        """Show the last result below the bar; without a terminal, the first one as a line."""
        if self._lines and not (self._bar.found or self._console.is_terminal):
            self._console.print(escape(f"First result: {text}"), soft_wrap=True)
        self._bar.found = text

    def note(self, text: str) -> None:
        """Print a warning."""
        self._console.print(escape(text))

    def _say(self) -> None:
        self._spoken = time.monotonic()
        for task in self._bar.tasks:
            phase, total = task.fields["phase"], task.total
            if self._lines and phase and total != 0 and not self._console.is_terminal:
                of = f" of {total:g}" if total else " runs"
                self._console.print(f"{phase}: {task.completed:g}{of}")
