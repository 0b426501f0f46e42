"""The command `stepbench map`."""

from __future__ import annotations

import json
import re
from pathlib import Path

import click

from bench.commands import completion, options
from bench.commands.pages import view
from problems.spec import SpecError

_MOST_POINTS = 1_000_000


@click.command("map")
@click.argument("problem", shell_complete=completion.scenes)
@click.argument("integrator", shell_complete=completion.integrators)
@click.option(
    "--over",
    required=True,
    metavar="X,Y",
    help="Two quantities: the step h (or rtol or atol of a method that chooses its steps), an "
    "option of the integrator, or a parameter of the scene.",
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
    help="Points along both; 100x100 if not given, 25 along a "
    "parameter of a scene without a closed form.",
)
@click.option("--step", type=float, help="Step size h in s, if h does not vary.")
@options.with_pattern
@options.with_tolerances
@click.option(
    "--error",
    metavar="GROUP:NORM",
    default="a:end",
    show_default=True,
    help="Relative error to show, as in the report.",
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
@options.with_folder("stepbench-map", "Folder of the page.")
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
    """Map where a method works, over two quantities.

    Each point is a run: ok, inaccurate, failed in Newton's method, or diverged; all are run in one
    compiled program. Writes a page with the map, coloured by outcome and error. Steps and wide
    ranges are divided evenly in their logarithm. Write step.h, scene.NAME or integrator.NAME for a
    name that stands for two things.

    \b
    Examples:
      stepbench map pendulum generalized_alpha --over h,rho_inf
      stepbench map stiff_bar newmark --over h,ea --range h:1e-3..0.1 --grid 60x40
      stepbench map soft_impact generalized_alpha_adaptive --over rtol,d --error q:end
      stepbench map pendulum "kvaerno5[steps=constant]" --over h,th0 --error q:max --json
    """
    names = tuple(name.strip() for name in over.split(","))
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise SpecError(f"--over {over!r} is not allowed; give two different numbers as h,rho_inf.")
    counts = None if grid is None else _read_grid(grid)
    registry = options.usable_registry(plugins)
    given = {"step": step, "pattern": pattern, "rtol": rtol, "atol": atol}
    sources = (
        registry.problem(problem, **settings).sources | registry.integrator(integrator).sources
    )

    from bench.sweeps.jobs import SweepRequest, map_job

    request = SweepRequest(problem, settings, integrator, given, t_end, budget)
    task = request, names, ranges, counts, error, threshold
    about = f"{integrator} on {problem}"
    plain = options.guarded(about, map_job, sources, budget, task, threads=True)
    if as_json:
        click.echo(json.dumps(plain, allow_nan=False))
        return
    total = sum(plain["counts"].values())
    click.echo(
        f"{plain['integrator']} on {plain['problem']} over {names[0]} and {names[1]}: {total} runs"
    )
    for name, count in plain["counts"].items():
        reason = f"  {plain['reasons'][name]}" if name in plain["reasons"] else ""
        click.echo(f"  {name:13} {count:7d}  {100 * count / total:5.1f} %{reason}")
    click.echo(f"Prepared in {plain['compile_s']:.2g} s, run in {plain['run_s']:.2g} s.")
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
