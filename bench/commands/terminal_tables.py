"""The tables that commands show in the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from bench.commands.terminal import new_table
from bench.conformance.verdicts import FAILED, NOT_APPLICABLE, PASSED, CheckResult
from bench.results.drift import RULE, LongRun, titled
from bench.results.experiments import CaseResult, ExperimentResult, bounds
from bench.results.quantities import NORMS
from bench.results.records import Record, Rows, median

if TYPE_CHECKING:
    from bench.atlas.experiments import Experiment
    from bench.sweeps.parts import Results
    from bench.sweeps.shards import ShardRun


def _number(value: float | None, form: str = ".3e", nothing: str = "-") -> str:
    return nothing if value is None else format(value, form)


def _add_numbers(table: Table, heads: Iterable[str]) -> None:
    for head in heads:
        table.add_column(head, justify="right", no_wrap=True)


# ---- checks -----------------------------------------------------------------------------
_SIGNS = {PASSED: ("\u2713", "green"), FAILED: ("\u2717", "red"), NOT_APPLICABLE: ("-", "dim")}


def check_line(result: CheckResult) -> Text:
    """A check in a line: a tick, a cross or a dash, its name and its result."""
    sign, style = _SIGNS[result.verdict]
    why = "does not apply: " if result.verdict == NOT_APPLICABLE else ""
    return Text.assemble((f"  {sign} {result.check}: ", style), why, result.text)


# ---- single runs and ensembles -----------------------------------------------------------
def solution_table(record: Record, rows: Rows, names: Mapping[str, Sequence[str]]) -> Group:
    """End values with errors, then work and times, of one run; ``names`` of components by group."""
    name = f"{record.integrator} on {record.problem}, {record.resolution}: {record.status}"
    end = f"{rows.t[-1]:.6g}" if rows.t else "-"
    table = new_table(name)
    table.add_column("", style="cyan")
    table.add_column("component")
    table.add_column(f"at t={end} s", no_wrap=True)
    _add_numbers(table, NORMS)
    for group, values in rows.values.items():
        errors = record.components.get(group, {})
        for i, value in enumerate(values[-1]):
            table.add_row(
                "" if i else group,
                Text(names[group][i]),
                f"{value: .10g}",
                *(_number(errors[norm][i] if norm in errors else None, ".2e") for norm in NORMS),
            )
    lines = []
    if record.components:
        steps = record.work.get("steps") or 0
        where = f", at {record.rows} of {steps} steps" if record.rows < steps else ""
        named = ", ".join(NORMS)
        lines.append(
            f"[bold]{named}[/bold]: errors relative to the component's largest value{where}"
        )
    for title, items in (
        ("constraint residual", record.constraint),
        ("work", record.work),
        ("floating-point operations", record.operations),
    ):
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


def order_table(records: list[Record], orders: dict[str, Any]) -> Table:
    """Errors per step in every group (norm "settled"), and the orders in every norm."""
    name = f"{records[0].integrator} on {records[0].problem}"
    table = new_table(f"{name}: relative error, norm 'settled', and fitted orders")
    table.add_column("h", style="cyan", no_wrap=True)
    _add_numbers(table, orders["orders"])
    for k, record in enumerate(records):
        table.add_row(
            record.resolution.removeprefix("h="),
            *(_number(e["settled"][k], ".2e") for e in orders["errors"].values()),
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
                    f"{fitted[norm]:.2f}\n{points} points\n{window[1]:.2g} to\n{window[0]:.2g}"
                )
        table.add_row(f"order, {norm}", *cells)
    return table


def ensemble_table(run: ShardRun, results: Results) -> Group:
    """Least, median and largest end values; then statuses, work and times."""
    plan, count = run.plan, results.statuses.total()
    title = f"{plan.integrator} on {plan.problem}: {count} members at t={plan.t_end:g} s"
    table = new_table(title)
    table.add_column("value", style="cyan")
    _add_numbers(table, ("min", "median", "max"))
    for name, numbers in results.summary().items():
        table.add_row(name, *(f"{numbers[head]:.9g}" for head in ("min", "median", "max")))
    lines = [", ".join(f"{number} {status}" for status, number in results.statuses.items())]
    for status, (member, message) in results.first.items():
        if status != "ok":
            lines.append(escape(f"{status}, first member {member}: {message}"))
    work = ", ".join(f"{name} {counts}" for name, counts in results.work.items())
    lines.append(f"work of all: {work}")
    if run.members == count and plan.shards == 1:
        lines.append(
            f"prepared in {run.compile_s:.2g} s, run in {run.run_s:.3g} s: "
            f"{count / run.run_s:.3g} members/s"
        )
    elif run.members:
        lines.append(
            f"{run.members} members run now, in {run.wall_s:.3g} s: "
            f"{run.members / run.wall_s:.3g} members/s (shards together: prepared in "
            f"{run.compile_s:.2g} s, run in {run.run_s:.3g} s)"
        )
    return Group(table, *lines)


def drift_table(results: Sequence[LongRun]) -> Group:
    """Drift in long runs, a line for each integrator and quantity."""
    table = new_table(f"Long runs of {results[0].problem}, h={results[0].h:g} s")
    table.add_column("integrator", style="cyan", overflow="fold")
    table.add_column("quantity")
    _add_numbers(table, ("largest", "per s"))
    table.add_column("drift")
    for run in results:
        steps = "-" if run.steps is None else run.steps
        name = f"{run.integrator}, {steps} steps: {run.status}"
        for k, (quantity, found) in enumerate(run.measured):
            numbers = _number(found.largest), _number(found.per_s)
            table.add_row(Text("" if k else name), Text(titled(quantity)), *numbers, found.verdict)
        if not run.measured:
            table.add_row(Text(name), *"----")
    return Group(table, RULE)


# ---- stability -----------------------------------------------------------------------------
_STABILITY_COLUMNS = ("radius", "damping", "period error", "overshoot q", "overshoot v")


def stability_tables(results: Sequence[dict[str, Any]]) -> Group:
    """Numbers over omega h and properties, for each integrator."""
    parts: list[RenderableType] = []
    for f in results:
        several = len(f["pattern"]) > 1
        name = "omega H" if several else "omega h"
        over = f"a pattern of {len(f['pattern'])} steps" if several else "a step"
        table = new_table(f"{f['integrator']}, {f['system']}: growth over {over}")
        table.add_column(name, style="cyan", no_wrap=True, justify="right")
        _add_numbers(table, _STABILITY_COLUMNS)
        for omega_h, radius, *others in zip(*f["at"].values(), strict=True):
            lost = any(low <= omega_h <= high for low, high in f["unsolved"])
            size = "not solved" if lost else "inf" if radius is None else f"{radius:.12f}"
            table.add_row(f"{omega_h:.6g}", size, *(_number(value, ".5e") for value in others))
        properties = "\n".join(
            f"[bold]{title}[/bold]: {text}" for title, text in _properties(f, name)
        )
        parts += [table, properties, ""]
    return Group(*parts[:-1])


def _properties(f: dict[str, Any], name: str) -> list[tuple[str, str]]:
    """Titles and texts of the properties of one integrator."""
    solved = not f["unsolved"] or f["unsolved"][-1][1] < f["omega_h"][-1]
    at_infinity = "infinite" if solved else "not solved"
    properties = [
        ("radius at infinity", _number(f["radius_at_infinity"], ".6f", at_infinity)),
        ("order", _number(f["order"], "d")),
        (f"grows for {name} in", _ranges(f["growing"])),
        ("bifurcation", _number(f["bifurcation"], ".6g", "none")),
    ]
    if f["unsolved"]:
        where = f"for {name} in {_ranges(f['unsolved'])}; there are no numbers there"
        properties.insert(0, ("Newton's method did not converge", where))
    if f["overshoot_orders"]:
        q, v = f["overshoot_orders"]
        properties.append(("overshoot", f"of q like ({name})^{q}, of v like ({name})^{v}"))
    for kind, words in (("alternating", "two steps in turns"), ("any", "up to six steps")):
        if kind in f["safe"]:
            ratio = _number(f["safe"][kind]["ratio"], ".3f", "above 10")
            properties.append((f"largest safe ratio, {words}", ratio))
    return properties


def _ranges(ranges: list[tuple[float, float | None]]) -> str:
    """Ranges of omega h in words."""
    return "; ".join(f"{a:.9g} to {_number(b, '.9g', 'infinity')}" for a, b in ranges) or "none"


# ---- the failure atlas ---------------------------------------------------------------------
def experiment_table(experiments: Sequence[Experiment]) -> Table:
    """Numbers, names and titles."""
    table = new_table("Failure atlas")
    table.add_column("", justify="right")
    table.add_column("name", style="cyan", no_wrap=True)
    table.add_column("what fails")
    for experiment in experiments:
        table.add_row(str(experiment.number), experiment.name, escape(experiment.title))
    return table


def atlas_tables(results: Sequence[ExperimentResult]) -> Group:
    """Every number that was measured, beside what was predicted."""
    made: list[RenderableType] = []
    for f in results:
        verdict = f.verdict if f.as_predicted else f"[red]{f.verdict}[/red]"
        made.append(f"[bold]{f.number}. {escape(f.title)}: {verdict}[/bold]")
        for part in f.parts:
            table = new_table()
            for name in ("", "found", "predicted", "", ""):
                table.add_column(name, justify="right" if name else "left")
            for case in part.cases:
                table.add_row("  " + escape(case.label), *_case_columns(case))
            made += [f"[cyan]{escape(part.text)}[/cyan]", table]
        made.append("")
    return Group(*made[:-1])


def _case_columns(case: CaseResult) -> tuple[str, str, str, str]:
    number = "-" if case.number is None else f"{case.number:.4g}"
    mark = {True: "[green]as predicted[/green]", False: "[red]differs[/red]", None: ""}
    return (
        number,
        "" if case.predicted is None else bounds(case.predicted),
        "[red]not measured[/red]" if case.stopped else mark[case.as_predicted],
        case.verdict + (f" ({escape(case.message)})" if case.message else ""),
    )
