"""Sweeps, many runs as one program: `stepbench map`, and what `stepbench solve --ensemble` does."""

from __future__ import annotations

import re
import time
from collections import Counter
from functools import partial
from typing import TYPE_CHECKING

import click

from bench.commands import options
from bench.commands.options import Given
from bench.results.table import Table
from problems.base.spec import SpecError

if TYPE_CHECKING:
    from bench.sweeps.ensemble import Ensemble

#: Most points of a map, and members of an ensemble: all are in memory.
_MOST = 1_000_000


# ---- maps --------------------------------------------------------------------------------
@options.command(
    "map",
    options.PROBLEM,
    options.INTEGRATOR,
    options.option(
        "--over", "Two quantities: the step h (or rtol or atol of a method that chooses its "
        "steps), an option of the integrator, or a parameter of the scene.", required=True,
        metavar="X,Y",
    ),
    options.option(
        "--range ranges", "Range of one of them; repeatable. An option is taken over all allowed "
        "values, a parameter over a tenth to tenfold, h around the scene's nominal step, rtol "
        "from 1e-6 to 1e-1, if not given.", multiple=True, metavar="NAME:LOW..HIGH",
    ),
    options.option(
        "--grid", "Points along both; 100x100 if not given, 25 along a parameter of a scene "
        "without a closed form.", metavar="NXxNY",
    ),
    options.option("--step", "Step size h in s, if h does not vary.", type=float),
    options.PATTERN,
    *options.TOLERANCES,
    options.option(
        "--error", "Relative error to show, as in the report.", metavar="GROUP:NORM",
        default="a:end",
    ),
    options.option(
        "--threshold", "A run with a larger error is called inaccurate.", type=float, default=0.1,
    ),
    options.T_END,
    *options.SET,
    options.budget(),
    options.folder("Folder of the page.", "stepbench-map"),
    options.PLUGINS,
    options.JSON,
)  # fmt: skip
def map_(o: Given) -> None:
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
    names = tuple(name.strip() for name in o.over.split(","))
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise SpecError(
            f"--over {o.over!r} is not allowed; give two different numbers as h,rho_inf."
        )
    counts = None if o.grid is None else _read_grid(o.grid)
    scene, method = options.asked_for(o)

    from bench.commands.terminal import show
    from bench.sweeps.outcome_map import map_job
    from bench.sweeps.variation import SweepRequest
    from reports.pages.outcome_map import write_map_page

    request = SweepRequest(scene.spec, method.spec, options.sizes(o), o.t_end)
    task = request, names, o.ranges, counts, o.error, o.threshold
    about, sources = f"{o.integrator} on {o.problem}", scene.sources | method.sources
    plain = options.guarded(about, map_job, sources, o.budget, *task, threads=True)
    if o.as_json:
        options.print_json(plain)
        return
    total = sum(plain["counts"].values())
    title = f"{plain['integrator']} on {plain['problem']} over {names[0]} and {names[1]}"
    rows = [
        [name, str(count), f"{100 * count / total:.1f} %", plain["reasons"].get(name, "")]
        for name, count in plain["counts"].items()
    ]
    show(
        Table(f"{title}: {total} runs", ["outcome", "runs", "part", "reason"], rows),
        f"Prepared in {plain['compile_s']:.2g} s, run in {plain['run_s']:.2g} s.",
    )
    click.echo(f"Page: {write_map_page(plain, o.out)}")


def _read_grid(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,9})x(\d{1,9})", text.replace(" ", ""))
    counts = tuple(map(int, match.groups())) if match else (0, 0)
    if min(counts) < 2 or counts[0] * counts[1] > _MOST:
        raise SpecError(
            f"--grid {text!r} is not allowed; give two numbers of at least 2 as 200x200, and at "
            f"most {_MOST} points."
        )
    return counts[0], counts[1]


# ---- ensembles ---------------------------------------------------------------------------
#: Options of an ensemble.
ENSEMBLE = (
    options.option(
        "--ensemble", "Run N members, a million at most, in one compiled program; needs --vary. "
        "--budget is that of some 1000 members.", type=click.IntRange(1, _MOST), metavar="N",
    ),
    options.option(
        "--vary", "Draw h, a parameter or an option of each member evenly from this range (in the "
        "logarithm if it is wide); repeatable.", multiple=True, metavar="NAME:LOW..HIGH",
    ),
    options.option("--seed", "Seed of the random draw.", type=click.IntRange(min=0), default=0),
    options.cluster(
        "Run the members on the workers of a dask scheduler, such as tcp://host:8786."
    ),
    options.file("File for the members, .csv, a flat row each."),
)  # fmt: skip


def solve_ensemble(o: Given) -> None:
    """Draw and run the members, and show or write the results."""
    from bench.commands.terminal import RunProgress, show
    from bench.running.cluster import ClusterRunner
    from bench.running.process import Limits
    from bench.running.runner import Runner
    from bench.sweeps import ensemble
    from problems.base.usage import cores

    scene, method = options.asked_for(o)
    common = scene.spec, method.spec, options.sizes(o), o.t_end
    request = ensemble.EnsembleRequest(*common, o.ensemble, o.vary, o.seed)
    if not o.vary:
        raise SpecError("An ensemble needs something in which its members differ; give --vary.")
    if o.out and o.out.suffix != ".csv":
        raise SpecError(f"{o.out.name} is no table; give a name that ends in .csv.")
    began = time.perf_counter()
    limits = Limits(o.budget, processors=1 if o.cluster else cores())
    make = partial(ClusterRunner, o.cluster) if o.cluster else partial(Runner, 1)
    with RunProgress() as progress, make(limits, progress) as runner:
        found, fault = ensemble.run_members(runner, request, scene.sources | method.sources)
    if o.as_json:
        facts = ("problem", "integrator", "t_end", "work", "compile_s", "run_s")
        counts = {"statuses": Counter(found.status), "summary": found.summary()}
        options.print_json({name: getattr(found, name) for name in facts} | counts)
    else:
        show(*_shown(found, time.perf_counter() - began))
    if o.out:
        found.write(o.out)
        click.echo(f"{len(found.status)} members in {o.out}", err=o.as_json)
    if "ok" not in found.status:
        raise click.ClickException(f"No member succeeded. The first: {found.message[0]}")
    if lost := o.ensemble - len(found.status):
        raise click.ClickException(
            f"Not complete: {lost} of {o.ensemble} members are missing. {fault}"
        )


def _shown(found: Ensemble, seconds: float) -> list[Table | str]:
    """Least, median and largest end values; then statuses, work and times."""
    count = len(found.status)
    title = f"{found.integrator} on {found.problem}: {count} members at t={found.t_end:g} s"
    columns = ("min", "median", "max")
    rows = [
        [name, *(f"{numbers[column]:.9g}" for column in columns)]
        for name, numbers in found.summary().items()
    ]
    statuses = Counter(found.status)
    lines = [", ".join(f"{number} {status}" for status, number in statuses.items())]
    for status in statuses:
        k = found.status.index(status)
        member = found.values["member"][k]
        if status != "ok":
            lines.append(f"{status}, first member {member}: {found.message[k]}")
    work = ", ".join(f"{name} {counts}" for name, counts in found.work.items())
    times = (
        f"{count} members in {seconds:.3g} s: {count / seconds:.3g} members/s (all parts together: "
        f"prepared in {found.compile_s:.2g} s, run in {found.run_s:.3g} s)"
    )
    return [Table(title, ["value", *columns], rows), *lines, f"work of all: {work}", times]
