"""The command `stepbench drift`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bench.commands import completion, options
from bench.commands.pages import view
from bench.running.plan import check_end
from integrators.contract import Steps
from problems.spec import SpecError

if TYPE_CHECKING:
    from bench.results.drift import LongRun

#: Most steps that can be asked for.
_MOST_STEPS = 10**9


@click.command()
@click.argument("problem", shell_complete=completion.scenes)
@click.argument(
    "names", nargs=-1, required=True, metavar="INTEGRATOR...", shell_complete=completion.integrators
)
@click.option(
    "--steps",
    type=click.IntRange(2, _MOST_STEPS),
    default=100_000,
    show_default=True,
    help="Number of steps.",
)
@click.option("--step", type=float, help="Step size h in s; the scene's nominal one if not given.")
@options.with_set
@options.with_budget
@options.with_folder("stepbench-drift", "Folder of the long runs and their page.")
@options.with_plugins
@click.option("--csv", "form", flag_value="csv", help="Print a row for each integrator.")
@click.option("--json", "form", flag_value="json", help="Print JSON instead of a table.")
def drift(
    problem: str,
    names: tuple[str, ...],
    steps: int,
    step: float | None,
    settings: dict[str, str],
    budget: float,
    out: Path,
    plugins: tuple[str, ...],
    form: str | None,
) -> None:
    """Measure what drifts over many constant steps.

    It measures: the energy, relative to the largest kinetic energy; conserved momenta; residuals of
    the constraints and of their rates; and the phase (the time by which a run is ahead), where a
    conservative motion has a closed form. The table gives the largest absolute value of each, the
    slope of a straight line through all rows, and whether the drift is none, linear, bounded or
    neither. The folder keeps long runs beside other results, whose report has a chapter on them.

    \b
    Examples:
      stepbench drift pendulum rattle energy_momentum generalized_alpha --steps 100000
      stepbench drift pendulum "dopri8[constraints=projected]" dopri8 --step 0.02 --out drift
      stepbench drift oscillator newmark bdf2 --csv > drift.csv
    """
    registry = options.usable_registry(plugins)
    scene = registry.problem(problem, **settings)
    methods = options.integrators_once(registry, names)
    if step is not None:
        check_end(scene.interval[0], scene.interval[0] + steps * Steps(step).h)

    from bench.results.store import Store
    from bench.running.drift import drift_job

    results, faults = [], []
    with Store(out, create=True) as store:
        for method in methods:
            sources, task = scene.sources | method.sources, (scene.spec, method.spec, step, steps)
            try:
                results.append(options.guarded(method.spec, drift_job, sources, budget, task))
                store.save_long_run(results[-1])
            except SpecError as error:
                faults.append(str(error))
    if results:
        _show(results, form)
        _write_page(out, quiet=bool(form))
    faults += [f"{r.integrator}: {r.status}: {r.message}" for r in results if r.status != "ok"]
    if faults:
        raise click.ClickException(" ".join(faults))


def _show(results: Sequence[LongRun], form: str | None) -> None:
    import msgspec

    from bench.results.drift import drift_table, flat

    if form == "json":
        click.echo(json.dumps(msgspec.to_builtins(results), indent=2, allow_nan=False))
    elif form == "csv":
        from bench.results.csv_text import csv_export

        click.echo(csv_export([flat(run) for run in results]), nl=False)
    else:
        from bench.commands.terminal import show

        show(drift_table(results))


def _write_page(out: Path, quiet: bool) -> None:
    """Write the page on all long runs that the folder has; say where it is."""
    from bench.results.store import Store

    with Store(out) as store:
        page, others = view("drift")(store.long_runs(), out), store.plan()
    click.echo(f"Page: {page}", err=quiet)
    if others:
        click.echo(
            "The report of this folder has it as a chapter after `stepbench report`.", err=quiet
        )
