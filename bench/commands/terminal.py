"""Output in the terminal: lines, tables, and the progress of a run."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Any, TextIO

from bench.results.table import Table
from bench.running.runner import Progress

if TYPE_CHECKING:  # slow to import, and not needed for lists as JSON, help and pages
    from rich.console import Console

#: Tables are never narrower, in characters, however small COLUMNS is.
_LEAST_WIDTH = 40
#: Columns of text have so many characters, or as many as they need.
_LEAST_TEXT = 16
#: Without a terminal a line is printed this often, in s, instead of a moving bar.
_LINE_EVERY_SECONDS = 5.0


def _console(file: TextIO) -> Console:
    from rich.console import Console

    console = Console(file=file)
    console.width = max(console.width, _LEAST_WIDTH)
    return console


def say(*parts: str | tuple[str, str], cut: bool = False) -> None:
    """Print a line of texts, some with a style; it is ``cut`` where the terminal's line ends."""
    from rich.text import Text

    how: dict[str, Any] = {"no_wrap": True, "overflow": "ellipsis"} if cut else {"soft_wrap": True}
    _console(sys.stdout).print(Text.assemble(*parts), highlight=False, **how)


def show(*parts: Table | str) -> None:
    """Print tables with their notes and texts on standard output, within its width.

    Tables have no lines; a name that the row above begins with is left out.
    """
    from rich import table
    from rich.text import Text

    console = _console(sys.stdout)
    for part in parts:
        if isinstance(part, str):
            console.print(Text(part))
            continue
        drawn = table.Table(
            title=Text(part.caption) if part.caption else None, title_justify="left",
            title_style="bold", box=None, pad_edge=False, padding=(0, 2, 0, 0),
        )  # fmt: skip
        for j, head in enumerate(part.head):
            number = j in part.numbers
            longest = max(len(cell) for cell in (head, *(row[j] for row in part.rows)))
            drawn.add_column(
                Text(head), style="" if j else "cyan", justify="right" if number else "left",
                no_wrap=number, overflow="fold",
                min_width=None if number else min(_LEAST_TEXT, longest),
            )  # fmt: skip
        above = ""
        for i, (name, *others) in enumerate(part.rows):
            cells = ["" if name == above else name, *others]
            styles = ["bold" if (i, j) in part.best else "" for j in range(len(cells))]
            drawn.add_row(*map(Text, cells, styles))
            above = name
        console.print(drawn)
        if part.note:
            console.print(Text(part.note))


class RunProgress(Progress):
    """A progress bar with the work in hand; without a terminal a line now and then.

    Parameters
    ----------
    lines
        Whether phases have a line, without a terminal.
    """

    def __init__(self, lines: bool = True) -> None:
        from rich import progress as bars

        super().__init__()
        self._console = _console(sys.stderr)
        self._lines = lines and not self._console.is_terminal
        self._bar = bars.Progress(
            bars.SpinnerColumn(), bars.TextColumn("{task.fields[phase]}"), bars.BarColumn(),
            bars.MofNCompleteColumn(), bars.TimeElapsedColumn(), bars.TimeRemainingColumn(),
            bars.TextColumn("{task.description}", style="dim", markup=False),
            console=self._console, transient=True, disable=not self._console.is_terminal,
        )  # fmt: skip
        self._spoken = 0.0

    def __enter__(self) -> RunProgress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def phase(self, name: str, total: int | None) -> None:
        """Begin a phase of this many steps, or of an unknown number."""
        for earlier in self._bar.task_ids:
            self._bar.remove_task(earlier)
        self._bar.add_task("", total=total, phase=name)
        self._say()

    def working(self, text: str) -> None:
        """Show the name of the work in hand, which may belong to no phase."""
        if not self._bar.tasks:
            self._bar.add_task("", total=None, phase="")
        self._bar.update(self._bar.tasks[0].id, description=text)

    def advance(self) -> None:
        """Count one step as done."""
        for task in self._bar.tasks:
            self._bar.advance(task.id)
            if task.finished or time.monotonic() - self._spoken > _LINE_EVERY_SECONDS:
                self._say()

    def note(self, text: str) -> None:
        """Print a line."""
        self._console.print(text, markup=False, soft_wrap=True)

    def _say(self) -> None:
        self._spoken = time.monotonic()
        for task in self._bar.tasks if self._lines else ():
            if (phase := task.fields["phase"]) and task.total != 0:
                of = f" of {task.total:g}" if task.total else " runs"
                self._console.print(f"{phase}: {task.completed:g}{of}")
