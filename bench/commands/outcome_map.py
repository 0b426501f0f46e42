"""The command `stepbench map`."""

from __future__ import annotations

import json
import re
from pathlib import Path

import click

from bench.commands import options
from bench.commands.pages import view
from problems.spec import SpecError

#: Points of a range; fewer along a parameter each value of which needs a reference of its own.
_POINTS, _POINTS_INTEGRATED = 100, 25
_MOST_POINTS = 1_000_000


@click.command("map")
@click.argument("problem")
@click.argument("integrator")
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
    help=f"Points along both; {_POINTS}x{_POINTS} if not given, {_POINTS_INTEGRATED} along a "
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
    from bench.sweeps.batch import refuse
    from bench.sweeps.outcome_map import outcome_map
    from bench.sweeps.variation import find_range, read_ranges

    registry = options.usable_registry(plugins)
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
    x, y = (find_range(name, scene, method, spans.get(name)) for name in names)
    given = {"step": step, "pattern": pattern, "rtol": rtol, "atol": atol}
    resolution = options.unvaried_resolution(scene, method, given, t_end, (x, y))
    points = [
        _POINTS_INTEGRATED if r.quantity.owner == "scene" and not scene.has("exact") else _POINTS
        for r in (x, y)
    ]
    result = outcome_map(
        scene,
        method,
        (x, y),
        _read_grid(grid) if grid is not None else (points[0], points[1]),
        resolution,
        t_end,
        error,
        threshold,
        budget,
    )
    plain = result.as_dict()
    if as_json:
        click.echo(json.dumps(plain, allow_nan=False))
        return
    total = result.outcome.size
    click.echo(
        f"{result.integrator} on {result.problem} over {names[0]} and {names[1]}: {total} runs"
    )
    for name, count in result.counts().items():
        reason = f"  {result.reasons[name]}" if name in result.reasons else ""
        click.echo(f"  {name:13} {count:7d}  {100 * count / total:5.1f} %{reason}")
    click.echo(f"Prepared in {result.compile_s:.2g} s, run in {result.run_s:.2g} s.")
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
