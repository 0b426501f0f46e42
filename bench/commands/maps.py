"""The commands for many runs at once: `stepbench map`, and `stepbench solve` with --ensemble."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.commands import options
from bench.commands.scenes import view
from bench.plugins.registry import Registry
from bench.results.csv_text import csv_text
from bench.running.plan import check_end
from integrators.contract import Integrator, Steps, Tolerances
from problems.spec import SpecError
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    from bench.sweeps.ensemble import Ensemble
    from bench.sweeps.variation import Axis

#: Points of an axis; fewer along a parameter each value of which needs a reference of its own.
_POINTS, _POINTS_INTEGRATED = 100, 25
_MOST_POINTS = 1_000_000
_MOST_MEMBERS = 1_000_000


# ---- maps --------------------------------------------------------------------------------
@click.command("map")
@click.argument("problem")
@click.argument("integrator")
@click.option(
    "--over",
    required=True,
    metavar="X,Y",
    help="Two numbers: the step h (or rtol or atol of a method that chooses its steps), an option "
    "of the integrator, or a parameter of the scene.",
)
@click.option(
    "--range",
    "ranges",
    multiple=True,
    metavar="NAME:LOW..HIGH",
    help="Range of one of them; repeatable. An option is taken over all allowed values, a "
    "parameter over a tenth to tenfold, h around the scene's nominal step, rtol from 1e-6 to "
    "1e-1, if not given.",
)
@click.option(
    "--grid",
    metavar="NXxNY",
    help=f"Points of the axes; {_POINTS}x{_POINTS} if not given, {_POINTS_INTEGRATED} along a "
    "parameter of a scene without a closed form.",
)
@click.option("--step", type=float, help="Step size h in s, where h is not an axis.")
@options.with_pattern
@options.with_tolerances
@click.option(
    "--error",
    metavar="GROUP:NORM",
    default="a:end",
    show_default=True,
    help="The error that is looked at, relative as in the report.",
)
@click.option(
    "--threshold",
    type=float,
    default=0.1,
    show_default=True,
    help="A run with a larger error is called inaccurate.",
)
@options.with_t_end
@options.with_set
@options.with_budget
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default="stepbench-map",
    show_default=True,
    help="Folder of the page.",
)
@options.with_plugins
@options.with_as_json
def map_(
    problem: str,
    integrator: str,
    over: str,
    ranges: tuple[str, ...],
    grid: str | None,
    step: float | None,
    pattern: tuple[float, ...] | None,
    rtol: float | None,
    atol: float | None,
    error: str,
    threshold: float,
    t_end: float | None,
    settings: dict[str, str],
    budget: float,
    out: Path,
    plugins: tuple[str, ...],
    as_json: bool,
) -> None:
    """Map where a method works: over two numbers, thousands of runs as one compiled program.

    Each point is a run, which is ok, inaccurate, failed in Newton's method or diverged. Writes a
    page with the map, coloured by outcome and error. Steps and wide ranges are divided evenly in
    their logarithm. A name that stands for two things is written step.h, scene.NAME or
    integrator.NAME.

    \b
    Examples:
      stepbench map pendulum generalized_alpha --over h,rho_inf
      stepbench map stiff_bar newmark --over h,ea --range h:1e-3..0.1 --grid 60x40
      stepbench map soft_impact generalized_alpha_adaptive --over rtol,d --error q:end
      stepbench map pendulum "kvaerno5[steps=constant]" --over h,th0 --error q:max --json
    """
    from bench.sweeps.batch import refuse
    from bench.sweeps.outcome_map import outcome_map
    from bench.sweeps.variation import axis, read_ranges

    registry = Registry(plugins)
    registry.require_files()
    scene = registry.problem(problem, **settings)
    method = registry.integrator(integrator)
    refuse(method, scene)
    names = [name.strip() for name in over.split(",")]
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise SpecError(f"--over {over!r} is not allowed; give two different numbers as h,rho_inf.")
    spans = read_ranges(ranges, "--range")
    stray = next((name for name in spans if name not in names), None)
    if stray:
        raise SpecError(f"--range {stray} is of no axis; the axes are {names[0]} and {names[1]}.")
    x, y = (axis(name, scene, method, spans.get(name)) for name in names)
    given = {"step": step, "pattern": pattern, "rtol": rtol, "atol": atol}
    resolution = _resolution(scene, method, given, t_end, (x, y))
    points = [
        _POINTS_INTEGRATED if a.number.owner == "scene" and not scene.has("exact") else _POINTS
        for a in (x, y)
    ]
    found = outcome_map(
        scene,
        method,
        (x, y),
        _read_grid(grid) if grid else (points[0], points[1]),
        resolution,
        t_end,
        error,
        threshold,
        budget,
    )
    plain = found.plain()
    if as_json:
        click.echo(json.dumps(plain, allow_nan=False))
        return
    total = found.outcome.size
    click.echo(
        f"{found.integrator} on {found.problem} over {names[0]} and {names[1]}: {total} runs"
    )
    for name, count in found.counts().items():
        reason = f"  {found.reasons[name]}" if name in found.reasons else ""
        click.echo(f"  {name:13} {count:7d}  {100 * count / total:5.1f} %{reason}")
    click.echo(f"Prepared in {found.compile_s:.2g} s, run in {found.run_s:.2g} s.")
    click.echo(f"Page: {view('map')(plain, out)}")


def _read_grid(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,9})x(\d{1,9})", text.replace(" ", ""))
    counts = tuple(map(int, match.groups())) if match else (0, 0)
    if min(counts) < 2 or counts[0] * counts[1] > _MOST_POINTS:
        raise SpecError(
            f"--grid {text!r} is not allowed; give two numbers of at least 2 as 200x200, and at "
            f"most {_MOST_POINTS} points."
        )
    return counts[0], counts[1]


def _resolution(
    scene: MechatronicSystem,
    method: Integrator,
    given: dict[str, Any],
    t_end: float | None,
    axes: Iterable[Axis],
) -> Steps | Tolerances:
    """What does not vary of the runs' steps, pattern or tolerances, of which are ``given`` --step,
    --pattern, --rtol and --atol."""
    t0, own_end = scene.interval
    end = check_end(t0, own_end if t_end is None else t_end)
    for along in axes:
        _, owner, field = along.number
        option = {"step": "step", "tolerance": field}.get(owner)
        if given.get(option) is not None:
            raise SpecError(f"The {owner} varies itself; leave --{option} out.")
        if owner == "step":
            for h in (along.low, along.high):
                Steps(h).count(t0, end)  # says what is wrong
    return options.resolution(scene, method, **given)


# ---- ensembles ---------------------------------------------------------------------------
def with_ensemble(command: Callable) -> Callable:
    """Add the options of an ensemble to `stepbench solve`."""
    for option in (
        click.option(
            "--out",
            "-o",
            type=click.Path(path_type=Path),
            help="File for the members, .csv or .json, a flat row each, for pandas.",
        ),
        click.option("--seed", type=click.IntRange(min=0), help="Of the draw; 0 if not given."),
        click.option(
            "--vary",
            multiple=True,
            metavar="NAME:LOW..HIGH",
            help="What the members differ in: h, a parameter or an option, drawn evenly from this "
            "range (in the logarithm if that is wide); repeatable.",
        ),
        click.option(
            "--ensemble",
            type=click.IntRange(1, _MOST_MEMBERS),
            metavar="N",
            help="Run N members in one compiled program; needs --vary.",
        ),
    ):
        command = option(command)
    return command


def refuse_alone(vary: tuple[str, ...], seed: int | None, out: Path | None) -> None:
    """Refuse the options of an ensemble for a single run."""
    given = {"vary": vary, "seed": seed, "out": out}
    for name, value in given.items():
        if value not in (None, ()):
            raise SpecError(f"--{name} is for an ensemble; give --ensemble N, too.")


def solve_ensemble(
    scene: MechatronicSystem,
    method: Integrator,
    given: dict[str, Any],
    t_end: float | None,
    count: int,
    vary: tuple[str, ...],
    seed: int | None,
    budget: float,
    out: Path | None,
    as_json: bool,
) -> None:
    """Draw the members, run them, and show or write what came out."""
    import numpy as np

    from bench.sweeps.batch import refuse
    from bench.sweeps.ensemble import ensemble
    from bench.sweeps.variation import axis, read_ranges

    refuse(method, scene)
    if not vary:
        raise SpecError("An ensemble needs something in which its members differ; give --vary.")
    if out and out.suffix not in (".csv", ".json"):
        raise SpecError(f"{out.name} is no table; give a name that ends in .csv or .json.")
    axes = {n: axis(n, scene, method, ends) for n, ends in read_ranges(vary, "--vary").items()}
    resolution = _resolution(scene, method, given, t_end, axes.values())
    generator = np.random.default_rng(seed or 0)
    values = {name: along.random(count, generator) for name, along in axes.items()}
    found = ensemble(scene, method, values, resolution, t_end, budget)
    rows, statuses = found.rows(), found.statuses()
    if as_json:
        answer = {
            "problem": found.problem,
            "integrator": found.integrator,
            "t_end": found.t_end,
            "statuses": statuses,
            "summary": found.summary(),
            "compile_s": found.compile_s,
            "run_s": found.run_s,
            "members": rows,
        }
        click.echo(json.dumps(answer, indent=1, allow_nan=False))
    else:
        from bench.commands.terminal import show

        show(_table(found))
    if out:
        out.write_text(_text(rows, out.suffix), encoding="utf-8")
        click.echo(f"{len(rows)} members in {out}", err=as_json)
    if "ok" not in statuses:
        raise click.ClickException(f"No member succeeded. The first: {found.message[0]}")


def _text(rows: list[dict[str, Any]], suffix: str) -> str:
    if suffix == ".json":
        return json.dumps(rows, indent=1, allow_nan=False)
    return csv_text(rows)


def _table(found: Ensemble) -> Any:
    from rich.console import Group
    from rich.markup import escape
    from rich.table import Table

    count = len(found.status)
    title = f"{found.integrator} on {found.problem}: {count} members at t={found.t_end:g} s"
    table = Table(
        title=escape(title), title_justify="left", title_style="bold", box=None, pad_edge=False,
        padding=(0, 2, 0, 0),
    )  # fmt: skip
    table.add_column("value", style="cyan")
    for head in ("min", "median", "max"):
        table.add_column(head, justify="right", no_wrap=True)
    for name, numbers in found.summary().items():
        table.add_row(name, *(f"{numbers[head]:.9g}" for head in ("min", "median", "max")))
    lines = [", ".join(f"{number} {status}" for status, number in found.statuses().items())]
    for status in found.statuses():
        if status != "ok":
            first = found.status.index(status)
            lines.append(escape(f"{status}, first member {first}: {found.message[first]}"))
    work = ", ".join(f"{name} {sum(counts.tolist())}" for name, counts in found.work.items())
    lines.append(f"work of all: {work}")
    rate = count / found.run_s
    lines.append(
        f"prepared in {found.compile_s:.2g} s, run in {found.run_s:.3g} s: {rate:.3g} members/s"
    )
    return Group(table, *lines)
