"""What a person sees in the terminal: tables and the progress of a run."""

from __future__ import annotations

import sys
import time
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Table

from bench.records import NORMS, Record, Rows, median
from bench.registry import Plugin

#: Without a terminal a line is printed this often instead of a moving bar.
_QUIET_SECONDS = 5.0


def show(table: Table) -> None:
    """Print a table on standard output."""
    Console().print(table)


def plugin_table(kind: str, plugins: list[Plugin]) -> Table:
    """Names, descriptions, and reasons of what is unavailable."""
    table = Table(title=kind, title_justify="left", title_style="bold", box=None, pad_edge=False)
    table.add_column("name", style="cyan", no_wrap=True)
    table.add_column("description")
    for plugin in plugins:
        text = escape(plugin.summary)
        if plugin.cls is None:
            text = f"[red]unavailable:[/red] {escape(plugin.reason)}"
        table.add_row(escape(plugin.name), text)
    return table


def _number(value: float | None, form: str = ".3e") -> str:
    return "-" if value is None else format(value, form)


def solution_table(record: Record, rows: Rows) -> Table:
    """End values with errors, then work and times, of one run."""
    table = Table(title=escape(f"{record.integrator} on {record.problem}, {record.resolution}: "
                               f"{record.status}"),
                  title_justify="left", title_style="bold", box=None, pad_edge=False)  # fmt: skip
    end = f"{rows.t[-1]:.6g}" if rows.t else "-"
    table.add_column("group", style="cyan")
    table.add_column(f"value at t={end} s", no_wrap=True)
    for norm in NORMS:
        table.add_column(f"error, {norm}", justify="right")
    for name, values in rows.values.items():
        errors = record.errors.get(name, {})
        table.add_row(name, "\n".join(f"{v: .15g}" for v in values[-1]),
                      *(_number(errors.get(norm)) for norm in NORMS))  # fmt: skip
    table.add_section()
    for title, items in (("constraint residual", record.constraint), ("work", record.work)):
        text = ", ".join(
            f"{key} {value:.3g}" if isinstance(value, float) else f"{key} {value}"
            for key, value in items.items()
            if value is not None
        )
        if text:
            table.add_row(title, text)
    if record.energy_drift is not None:
        table.add_row("energy drift", f"{record.energy_drift:.3g}")
    if record.run_s:
        table.add_row("time", f"{median(record.run_s):.3g} s (median of {len(record.run_s)}), "
                              f"prepared in {_number(record.compile_s, '.2g')} s")  # fmt: skip
    return table


def order_table(records: list[Record], orders: dict[str, Any]) -> Table:
    """Errors per step in every group (norm "settled"), and the orders in every norm."""
    name = f"{records[0].integrator} on {records[0].problem}"
    table = Table(title=escape(f"{name}: relative error, norm 'settled', and fitted orders"),
                  title_justify="left", title_style="bold", box=None, pad_edge=False)  # fmt: skip
    table.add_column("h", style="cyan", no_wrap=True)
    for group in orders["orders"]:
        table.add_column(group, justify="right")
    for k, record in enumerate(records):
        table.add_row(record.resolution.removeprefix("h="),
                      *(_number(e["settled"][k]) for e in orders["errors"].values()))  # fmt: skip
    table.add_section()
    for norm in NORMS:
        cells = []
        for group, fitted in orders["orders"].items():
            window = orders["window"][group][norm]
            if fitted[norm] is None:
                cells.append(orders["verdict"][group][norm])
            else:
                points = orders["points"][group][norm]
                cells.append(f"{fitted[norm]:.2f} [{window[0]:.2g}..{window[1]:.2g}, {points}]")
        table.add_row(f"order, {norm}", *cells)
    return table


class RunProgress:
    """A progress bar with the cell in work; plain lines where there is no terminal."""

    def __init__(self) -> None:
        self._console = Console(file=sys.stderr)
        self._bar = Progress(
            SpinnerColumn(), TextColumn("{task.fields[phase]}"), BarColumn(), MofNCompleteColumn(),
            TimeElapsedColumn(), TextColumn("[dim]{task.description}[/dim]"),
            console=self._console, transient=True, disable=not self._console.is_terminal,
        )  # fmt: skip
        self._task: Any = None
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
        """Show what is in work."""
        self._bar.update(self._task, description=escape(text))

    def advance(self) -> None:
        """One step is done."""
        self._bar.advance(self._task)
        self._done += 1
        if self._done == self._total or time.monotonic() - self._spoken > _QUIET_SECONDS:
            self._say()

    def _say(self) -> None:
        self._spoken = time.monotonic()
        if not self._console.is_terminal:
            self._console.print(f"{self._phase}: {self._done} of {self._total}")
