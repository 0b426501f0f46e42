"""Sweeps, many runs as one program: `stepbench map`, and what `stepbench solve --ensemble` does."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bench.commands import completion, options
from bench.commands.pages import view
from bench.guard.interrupts import remark
from bench.results.table import Table
from problems.spec import SpecError

if TYPE_CHECKING:
    from bench.plugins.facts import Sources
    from bench.sweeps.jobs import EnsembleRequest
    from bench.sweeps.parts import EnsembleResults, Parts
    from bench.sweeps.shards import ShardRun

#: Most points of a map, and members of an ensemble, that can be asked for.
_MOST_POINTS, _MOST_MEMBERS = 1_000_000, 100_000_000
#: Worker processes if their number is not given.
_JOBS = 2


# ---- maps --------------------------------------------------------------------------------
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
    _, scene, method = options.asked_for(problem, integrator, settings, plugins)
    given = {"step": step, "pattern": pattern, "rtol": rtol, "atol": atol}

    from bench.commands.terminal import show
    from bench.sweeps.jobs import SweepRequest, map_job

    request = SweepRequest(scene.spec, method.spec, given, t_end, budget)
    task = request, names, ranges, counts, error, threshold
    about, sources = f"{integrator} on {problem}", scene.sources | method.sources
    plain = options.guarded(about, map_job, sources, budget, *task, threads=True)
    if as_json:
        click.echo(json.dumps(plain, allow_nan=False))
        return
    total = sum(plain["counts"].values())
    title = f"{plain['integrator']} on {plain['problem']} over {names[0]} and {names[1]}"
    rows = [
        [name, str(count), f"{100 * count / total:.1f} %", plain["reasons"].get(name, "")]
        for name, count in plain["counts"].items()
    ]
    show(Table(f"{title}: {total} runs", ["outcome", "runs", "part", "reason"], rows))
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


# ---- ensembles ---------------------------------------------------------------------------
def with_ensemble(command: Callable) -> Callable:
    """Add the options of an ensemble to `stepbench solve`."""
    for option in (
        options.with_file(
            "File for the members, .csv, .json or .parquet, a flat row each, for pandas. Finished "
            "shards are kept in PATH.parts/; the same command continues there. Without it members "
            "are in the system's temporary folder, which may be memory."
        ),
        options.with_cluster(
            "Run the members on the workers of a dask scheduler, such as tcp://host:8786."
        ),
        click.option(
            "--jobs",
            type=click.IntRange(1, options.MOST_JOBS),
            help=f"Worker processes that run members; {_JOBS} if not given, 1 on a GPU.",
        ),
        click.option(
            "--seed", type=click.IntRange(min=0), help="Seed of the random draw; 0 if not given."
        ),
        click.option(
            "--vary",
            multiple=True,
            metavar="NAME:LOW..HIGH",
            help="Draw h, a parameter or an option of each member evenly from this range (in the "
            "logarithm if it is wide); repeatable.",
        ),
        click.option(
            "--ensemble",
            type=click.IntRange(1, _MOST_MEMBERS),
            metavar="N",
            help="Run N members in shards of some 1000, each one compiled program; needs --vary. "
            "--budget is that of one shard.",
        ),
    ):
        command = option(command)
    return command


def refuse_alone(
    vary: tuple[str, ...],
    seed: int | None,
    jobs: int | None,
    cluster: str | None,
    out: Path | None,
) -> None:
    """Refuse the options of an ensemble for a single run."""
    given = {"vary": vary, "seed": seed, "jobs": jobs, "cluster": cluster, "out": out}
    for name, value in given.items():
        if value not in (None, ()):
            raise SpecError(f"--{name} is for an ensemble; give --ensemble N, too.")


def solve_ensemble(
    sources: Sources,
    request: EnsembleRequest,
    fingerprint: str,
    jobs: int | None,
    cluster: str | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Draw the members, run them in shards, and show or write the results."""
    from bench.sweeps.parts import EnsembleResults, KeptParts, check_file_name, write_members

    if not request.vary:
        raise SpecError("An ensemble needs something in which its members differ; give --vary.")
    if jobs and cluster:
        raise SpecError("--jobs is for processes of this machine; leave it out with --cluster.")
    if out:
        check_file_name(out)
        remark("Finished members are stored; the same command goes on.")
    folder = out.with_name(f"{out.name}.parts") if out else None
    run, parts = _run(sources, request, folder, fingerprint, jobs, cluster)
    results = EnsembleResults((parts, run.lost), run.plan.shards, run.plan.ranges)
    if as_json:
        _print_json(run, results)
    else:
        from bench.commands.terminal import show

        show(*_shown(run, results))
    if out:
        write_members(out, results.parts())
        click.echo(f"{request.count} members in {out}", err=as_json)
    lost = len(run.lost.numbers())
    if isinstance(parts, KeptParts) and not lost:
        parts.remove()
    if not results.statuses["ok"]:
        _, message = results.first[next(iter(results.statuses))]
        raise click.ClickException(f"No member succeeded. The first: {message}")
    if lost:
        again = "; the same command runs them again, with a larger --budget, too" if out else ""
        raise click.ClickException(
            f"Not complete: {lost} of {run.plan.shards} shards were lost{again}."
        )


def _run(
    sources: Sources,
    request: EnsembleRequest,
    folder: Path | None,
    fingerprint: str,
    jobs: int | None,
    cluster: str | None,
) -> tuple[ShardRun, Parts]:
    """Run the members that the folder lacks; return what is known of the run, and its parts."""
    from bench.commands.terminal import RunProgress
    from bench.guard.limits import Limits
    from bench.running.cluster import ClusterRunner
    from bench.running.runner import Runner
    from bench.sweeps.parts import KeptParts, TemporaryParts
    from bench.sweeps.shards import ShardRun
    from problems.usage import cores

    workers = processes(jobs, request.count)
    threads = max(1, cores() // workers)
    # A shard watches its budget itself, and has half as much again to end by it.
    limits = Limits(1.5 * request.budget, processors=threads)
    with RunProgress() as progress:
        with Runner(workers, limits, progress) as here:
            run = ShardRun(here, request, sources, progress)
            about = run.about | {"sources": fingerprint}
            parts = KeptParts(folder, about) if folder else TemporaryParts()
            if not cluster:
                run.complete(here, parts, threads)
                return run, parts
        with ClusterRunner(cluster, replace(limits, processors=1), progress) as there:
            missing = run.plan.shards - len(parts.numbers())
            run.complete(there, parts, 1, there.together(missing))
    return run, parts


def processes(jobs: int | None, members: int) -> int:
    """Return how many worker processes run members on this machine; ``jobs`` if it is given."""
    from bench.sweeps.jobs import shards_of

    # A process takes most of a GPU's memory for itself.
    usual = _JOBS if os.environ.get("JAX_PLATFORMS", "cpu") == "cpu" else 1
    return min(jobs or usual, shards_of(members))


def _shown(run: ShardRun, results: EnsembleResults) -> list[Table | str]:
    """Least, median and largest end values; then statuses, work and times."""
    plan, count = run.plan, results.statuses.total()
    title = f"{plan.integrator} on {plan.problem}: {count} members at t={plan.t_end:g} s"
    columns = ("min", "median", "max")
    rows = [
        [name, *(f"{numbers[column]:.9g}" for column in columns)]
        for name, numbers in results.summary().items()
    ]
    lines = [", ".join(f"{number} {status}" for status, number in results.statuses.items())]
    lines += [
        f"{status}, first member {member}: {message}"
        for status, (member, message) in results.first.items()
        if status != "ok"
    ]
    work = ", ".join(f"{name} {counts}" for name, counts in results.work.items())
    lines.append(f"work of all: {work}")
    if run.members:
        lines.append(
            f"{run.members} members run now, in {run.wall_s:.3g} s: "
            f"{run.members / run.wall_s:.3g} members/s (all shards together: prepared in "
            f"{run.compile_s:.2g} s, run in {run.run_s:.3g} s)"
        )
    return [Table(title, ["value", *columns], rows), *lines]


def _print_json(run: ShardRun, results: EnsembleResults) -> None:
    from bench.sweeps.parts import json_texts

    answer = {
        "problem": run.plan.problem,
        "integrator": run.plan.integrator,
        "t_end": run.plan.t_end,
        "statuses": results.statuses,
        "summary": results.summary(),
        "compile_s": run.compile_s,
        "run_s": run.run_s,
    }
    click.echo(json.dumps(answer, indent=1, allow_nan=False)[:-2] + ',\n "members": ', nl=False)
    for text in json_texts(results.parts()):
        click.echo(text, nl=False)
    click.echo("}")
