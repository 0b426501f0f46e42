"""The command that searches for cheapest resolutions: `stepbench rate`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import msgspec

from bench.commands import completion, options
from bench.commands.pages import write_reports
from bench.guard.interrupts import remark
from bench.results.store import Store
from bench.results.table import Table, number
from bench.running.inventory import Inventory
from bench.running.plan import Suite, make_suite
from bench.running.profiles import ProfileFile, StudyFile, read_profile, suite_titles
from bench.running.rating import Candidate, Demand, demand, rate
from problems.spec import SpecError
from problems.whole_files import put

#: File of the ratings in a folder.
FILE = "rating.json"

#: Demands of the rules by name; those of "work-precision" are asked for.
RULES = {"work-precision": ("a:1e-3",)}


@click.command("rate")
@click.argument("name", metavar="SCENE|SUITE")
@click.argument("methods", nargs=-1, metavar="INTEGRATOR...", shell_complete=completion.integrators)
@click.option(
    "--rule",
    type=click.Choice([*RULES]),
    default="work-precision",
    show_default=True,
    help="Accuracy that is asked for.",
)
@click.option(
    "--error",
    "errors",
    multiple=True,
    metavar="QUANTITY:LIMIT",
    help="Largest error, such as a:1e-3, q:end:1e-6 or energy:1e-4; repeatable.",
)
@options.with_t_end
@options.with_set
@options.with_folder("stepbench-rating", "Folder of the results.")
@options.with_fresh
@options.with_jobs("Worker processes; timing is done by one at a time.")
@options.with_given_budget("Processor time in s after which a run is stopped.", default=60.0)
@options.with_plugins
@options.with_as_json
def rate_(
    name: str,
    methods: tuple[str, ...],
    rule: str,
    errors: tuple[str, ...],
    t_end: float | None,
    settings: dict[str, str],
    out: Path,
    fresh: bool,
    jobs: int,
    budget: float,
    plugins: tuple[str, ...],
    as_json: bool,
) -> None:
    """Find the largest step or tolerance that meets a rule, and its cost.

    SCENE or SUITE: one scene, or all scenes of a suite, with the suite's integrators if none is
    named. Each search is a bisection that follows the convergence of its own errors.

    \b
    Examples:
      stepbench rate pendulum generalized_alpha ida --error a:1e-3
      stepbench rate quick --error q:1e-4 --error energy:1e-5
    """
    registry = options.usable_registry(plugins)
    demands = [demand(text) for text in errors or RULES[rule]]
    suite = _suite(registry, name, methods, t_end, settings, budget)
    title = f"Rating: {', '.join(map(str, demands))}"
    suite = replace(suite, plan=msgspec.structs.replace(suite.plan, title=title))
    asked = dict.fromkeys((c.problem, c.integrator, c.t_end) for c in suite.cells.values())
    candidates = [
        Candidate(registry.problem(scene), registry.integrator(method), end)
        for scene, method, end in asked
    ]
    from bench.commands.terminal import RunProgress, show
    from bench.running.session import runner_for

    with (
        RunProgress() as progress,
        runner_for(suite, jobs, progress) as runner,
        Store(out, create=True, fresh=fresh) as store,
    ):
        remark("Finished runs are stored; the same command goes on.")
        options.tell_set_aside(store)
        rate(candidates, demands, suite, store, registry, runner)
        machine = store.environments()
    ratings = [_rating(c, asked) for asked in demands for c in candidates]
    text = json.dumps({"machine": msgspec.to_builtins(machine), "ratings": ratings}, indent=2)
    put(out / FILE, text)
    if as_json:
        click.echo(text)
    else:
        show(*(table for asked in demands for table in _tables(candidates, asked)))
        click.echo(f"Record: {out / FILE}")
        write_reports(out)
    if not any(rating["met"] for rating in ratings):
        raise click.ClickException("No integrator meets the rule on any scene.")


def _suite(
    registry: Inventory,
    name: str,
    methods: Sequence[str],
    t_end: float | None,
    settings: Mapping[str, str],
    budget: float,
) -> Suite:
    """Return the suite of a scene or of a suite's name, whose cells name scenes and methods."""
    if name in suite_titles() or name.endswith(".toml"):
        if settings or t_end is not None:
            raise SpecError("--set and --t-end belong to one scene; a suite has its own.")
        return make_suite(*read_profile(name), registry, (), methods, budget)
    scene = registry.problem(name, **settings)
    if not methods:
        raise SpecError(f"No integrator is named for {scene.spec}; see `stepbench list`.")
    study = StudyFile(problems=[scene.spec], integrators=list(methods), t_end=t_end)
    return make_suite("rating", ProfileFile(study=[study], budget_s=budget), registry)


def _rating(candidate: Candidate, asked: Demand) -> dict[str, Any]:
    """Return the rating of a method on a scene, for a file that can be sent."""
    best = candidate.best(asked)
    run = best or candidate.nearest(asked)
    return {
        "problem": run.problem,
        "integrator": run.integrator,
        "formulation": run.formulation,
        "demand": str(asked),
        "met": best is not None,
        "resolution": run.resolution,
        "error": asked.error(run),
        "obstacle": "" if best else candidate.obstacle,
        "seconds": run.seconds,
        "run_s": run.run_s,
        "operations": run.cost("operations"),
        "work": run.work,
        "energy_drift": run.energy_drift,
        "constraint": run.constraint,
        "runs": len(candidate.runs),
    }


def _tables(candidates: Sequence[Candidate], asked: Demand) -> Iterator[Table]:
    """A table for each scene: the fastest method first, at the end those that do not get there."""
    scenes = dict.fromkeys(c.scene.spec for c in candidates)
    for scene in scenes:
        rows, notes = [], []
        for c in (c for c in candidates if c.scene.spec == scene):
            best = c.best(asked)
            run = best or c.nearest(asked)
            figures = run.h or run.rtol, run.cost("operations"), asked.error(run)
            time = number(run.seconds)
            if not best:
                time = "not met"
                notes.append(f"{run.integrator}: {c.obstacle}")
            more = run.energy_drift, run.constraint.get("position")
            cells = [run.integrator, *map(number, figures), time, *map(number, more)]
            rows.append(((not best, run.seconds or asked.of(run)), cells))
        rows.sort(key=lambda row: row[0])
        yield Table(
            f"{scene}: {asked}",
            ["integrator", "h [s] or rtol", "operations", "error", "time [s]", "energy", "Φ"],
            [cells for _, cells in rows],
            note="\n".join(notes),
        )
