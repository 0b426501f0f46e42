"""The atlas in the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.console import Group
from rich.markup import escape
from rich.table import Table

from bench.atlas.experiments import Experiment
from bench.results.experiments import CaseResult, ExperimentResult, bounds


def listing(experiments: Sequence[Experiment]) -> Table:
    """Numbers, names and titles."""
    table = _table("Failure atlas")
    table.add_column("", justify="right")
    table.add_column("name", style="cyan", no_wrap=True)
    table.add_column("what fails")
    for experiment in experiments:
        table.add_row(str(experiment.number), experiment.name, escape(experiment.title))
    return table


def tables(found: Sequence[ExperimentResult]) -> Group:
    """Every number that was measured, beside what was predicted."""
    made: list[Any] = []
    for f in found:
        verdict = "as predicted" if f.as_predicted else "[red]not as predicted[/red]"
        made.append(f"[bold]{f.number}. {escape(f.title)}: {verdict}[/bold]")
        for part in f.parts:
            table = _table("")
            for name in ("", "found", "predicted", "", ""):
                table.add_column(name, justify="right" if name else "left")
            for case in part.cases:
                table.add_row("  " + escape(case.label), *_case(case))
            made += [f"[cyan]{escape(part.text)}[/cyan]", table]
        made.append("")
    return Group(*made[:-1])


def _case(case: CaseResult) -> tuple[str, str, str, str]:
    number = "-" if case.number is None else f"{case.number:.4g}"
    mark = {True: "[green]as predicted[/green]", False: "[red]differs[/red]", None: ""}
    return (
        number,
        "" if case.predicted is None else bounds(case.predicted),
        mark[case.as_predicted],
        ("spared" if case.healthy else "hit") if case.x else "does not apply",
    )


def _table(title: str) -> Table:
    style = {"title_justify": "left", "title_style": "bold", "pad_edge": False}
    return Table(title=title or None, box=None, padding=(0, 2, 0, 0), **style)
