"""What a person sees in the terminal: tables and the progress of a run."""

from __future__ import annotations

import sys
import time
from typing import Any

from rich.console import Console, Group
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
from rich.text import Text

from bench.conformance.verdicts import FAILED, NOT_APPLICABLE, PASSED, Finding
from bench.plugins.registry import Plugin
from bench.results.quantities import NORMS
from bench.results.records import Record, Rows, median

#: Without a terminal a line is printed this often instead of a moving bar.
_QUIET_SECONDS = 5.0


def show(content: Table | Group) -> None:
    """Print tables and lines on standard output."""
    Console().print(content)


def plugin_table(kind: str, plugins: list[Plugin]) -> Table:
    """Names, descriptions and options, and reasons of what is unavailable."""
    table = _table(kind)
    table.add_column("name", style="cyan", no_wrap=True)
    table.add_column("description")
    for plugin in plugins:
        text = escape(plugin.summary)
        if plugin.cls is None:
            text = f"[red]unavailable:[/red] {escape(plugin.reason)}"
        options = ", ".join(
            f"{o['name']}={'|'.join(map(str, o['choices'])) if 'choices' in o else o['default']}"
            for o in plugin.options
        )
        if options:
            text += f"\n[dim]{escape(options)}[/dim]"
        table.add_row(escape(plugin.name), text)
    return table


def _number(value: float | None, form: str = ".3e") -> str:
    return "-" if value is None else format(value, form)


def solution_table(record: Record, rows: Rows) -> Group:
    """End values with errors, then work and times, of one run."""
    name = f"{record.integrator} on {record.problem}, {record.resolution}: {record.status}"
    end = f"{rows.t[-1]:.6g}" if rows.t else "-"
    table = _table(name)
    table.add_column("group", style="cyan")
    table.add_column(f"at t={end} s", no_wrap=True)
    for norm in NORMS:
        table.add_column(f"error {norm}", justify="right", no_wrap=True)
    for name, values in rows.values.items():
        errors = record.errors.get(name, {})
        table.add_row(
            name,
            "\n".join(f"{v: .15g}" for v in values[-1]),
            *(_number(errors.get(norm), ".2e") for norm in NORMS),
        )
    lines = []
    for title, items in (("constraint residual", record.constraint), ("work", record.work)):
        known = [
            f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
            for key, value in items.items()
            if value is not None
        ]
        if known:
            lines.append(f"[bold]{title}[/bold]: {', '.join(known)}")
    if record.energy_drift is not None:
        lines.append(f"[bold]energy drift[/bold]: {record.energy_drift:.3g}")
    if record.run_s:
        lines.append(
            f"[bold]time[/bold]: {median(record.run_s):.3g} s (median of "
            f"{len(record.run_s)}), prepared in {_number(record.compile_s, '.2g')} s"
        )
    return Group(table, *lines)


def _table(title: str) -> Table:
    return Table(
        title=escape(title),
        title_justify="left",
        title_style="bold",
        box=None,
        pad_edge=False,
        padding=(0, 2, 0, 0),
    )


def order_table(records: list[Record], orders: dict[str, Any]) -> Table:
    """Errors per step in every group (norm "settled"), and the orders in every norm."""
    name = f"{records[0].integrator} on {records[0].problem}"
    table = _table(f"{name}: relative error, norm 'settled', and fitted orders")
    table.add_column("h", style="cyan", no_wrap=True)
    for group in orders["orders"]:
        table.add_column(group, justify="right")
    for k, record in enumerate(records):
        table.add_row(
            record.resolution.removeprefix("h="),
            *(_number(e["settled"][k]) for e in orders["errors"].values()),
        )
    table.add_section()
    for norm in NORMS:
        cells = []
        for group, fitted in orders["orders"].items():
            window = orders["window"][group][norm]
            if fitted[norm] is None:
                cells.append(orders["verdict"][group][norm].replace(" determined", "\ndetermined"))
            else:
                points = orders["points"][group][norm]
                cells.append(
                    f"{fitted[norm]:.2f}\n{points} points\n{window[1]:.2g}-{window[0]:.2g}"
                )
        table.add_row(f"order, {norm}", *cells)
    return table


_SIGNS = {PASSED: ("\u2713", "green"), FAILED: ("\u2717", "red"), NOT_APPLICABLE: ("-", "dim")}


def finding_line(finding: Finding) -> Text:
    """A check in a line: a tick, a cross or a dash, its name and what it found."""
    sign, style = _SIGNS[finding.verdict]
    why = "does not apply: " if finding.verdict == NOT_APPLICABLE else ""
    return Text.assemble((f"  {sign} {finding.check}: ", style), why, finding.text)


def say(line: Text | str) -> None:
    """Print a line as it is, however long: the terminal wraps it."""
    Console().print(line, soft_wrap=True, markup=False, highlight=False)


class RunProgress:
    """A progress bar with the cell in work; plain lines where there is no terminal."""

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

    def note(self, text: str) -> None:
        """Something went wrong that costs no cell."""
        self._console.print(escape(text))

    def _say(self) -> None:
        self._spoken = time.monotonic()
        if not self._console.is_terminal:
            self._console.print(f"{self._phase}: {self._done} of {self._total}")
