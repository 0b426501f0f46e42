"""The commands for runs of one integrator on one scene: `stepbench solve` and `stepbench order`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import click

from bench.commands import completion, options
from bench.commands import ensemble as ensembles
from bench.plugins.facts import MethodFacts, SceneFacts
from bench.results import summary
from bench.results.records import UNSUPPORTED
from bench.running.plan import DEFAULT_HALVINGS, Cell
from bench.running.plan import resolution as resolution_of
from integrators.contract import Steps
from problems.spec import SpecError


@click.command()
@click.argument("problem", shell_complete=completion.scenes)
@click.argument("integrator", shell_complete=completion.integrators)
@click.option("--step", type=float, help="Step size h in s (with --pattern: the macro step H).")
@options.with_pattern
@options.with_tolerances
@options.with_t_end
@options.with_set
@ensembles.with_ensemble
@options.with_budget
@options.with_plugins
@options.with_as_json
def solve(
    problem: str,
    integrator: str,
    step: float | None,
    pattern: tuple[float, ...] | None,
    rtol: float | None,
    atol: float | None,
    t_end: float | None,
    settings: dict[str, str],
    ensemble: int | None,
    vary: tuple[str, ...],
    seed: int | None,
    jobs: int | None,
    cluster: str | None,
    out: Path | None,
    budget: float,
    plugins: tuple[str, ...],
    as_json: bool,
) -> None:
    """Run one integrator on one scene.

    The table has the values at the end, errors and work. With --ensemble, run many members; --vary
    says how they differ.

    \b
    Examples:
      stepbench solve spring_mass "generalized_alpha[rho_inf=0.8]" --step 0.1 --t-end 5
      stepbench solve pendulum ida --rtol 1e-8 --set th0=3.0 --json
      stepbench solve quarter_car generalized_alpha --ensemble 1000 --vary k:2e4..3e4 -o cars.csv
      stepbench solve quarter_car newmark --ensemble 1000000 --vary k:2e4..3e4 -o cars.parquet
    """
    registry = options.usable_registry(plugins)
    scene = registry.problem(problem, **settings)
    method = registry.integrator(integrator)
    if ensemble is not None:
        from bench.sweeps.jobs import EnsembleRequest, SweepRequest

        given = {"step": step, "pattern": pattern, "rtol": rtol, "atol": atol}
        sweep = SweepRequest(scene.spec, {}, method.spec, given, t_end, budget)
        request = EnsembleRequest(sweep, ensemble, vary, seed or 0)
        sources = scene.sources | method.sources
        made_by = f"{scene.fingerprint}-{method.fingerprint}"
        ensembles.solve_ensemble(sources, request, made_by, jobs, cluster, out, as_json)
        return
    ensembles.refuse_alone(vary, seed, jobs, cluster, out)
    end = options.end_time(scene, t_end)
    resolution = resolution_of(scene, method, step, pattern, rtol, atol)
    if isinstance(resolution, Steps):
        count = resolution.count(scene.interval[0], end)
        used = (end - scene.interval[0]) / count
        if abs(used - resolution.h) > 1e-9 * used:
            click.echo(
                f"Step {resolution.h:g} s does not divide the interval; {count} steps of "
                f"{used:.9g} s are taken.",
                err=True,
            )
    from bench.running.session import solve_cells

    cell = Cell(scene.spec, method.spec, end, resolution)
    with options.waiting() as working:
        ((record, rows),), names = solve_cells(
            [cell], registry, 7, budget, printed=options.say_printed, working=working
        )
    if as_json:
        click.echo(json.dumps(summary.solution(record, rows), indent=2))
    else:
        from bench.commands.terminal import show
        from bench.commands.terminal_tables import solution_table

        show(solution_table(record, rows, names))
    if record.status != "ok":
        raise click.ClickException(f"{record.status}: {record.message}")


def order_cells(
    scene: SceneFacts,
    method: MethodFacts,
    steps: Sequence[float] | None,
    pattern: tuple[float, ...] | None,
    t_end: float | None,
) -> list[Cell]:
    """Return the cells to which an order is fitted.

    Raises
    ------
    SpecError
        If the method chooses its own steps, or steps or the end time are not allowed.
    """
    if method.controls != "step":
        raise SpecError(f"{method.spec} chooses its own steps; an order over h is not defined.")
    end = options.end_time(scene, t_end)
    sizes = steps or [scene.nominal_step * 2.0**-k for k in range(DEFAULT_HALVINGS)]
    if len(sizes) < 3:
        raise SpecError(f"An order needs at least three step sizes; {len(sizes)} came.")
    resolutions = [Steps(h, pattern or (1.0,)) for h in sizes]
    for resolution in resolutions:
        resolution.count(scene.interval[0], end)  # refuses a step that does not fit
    return [Cell(scene.spec, method.spec, end, resolution) for resolution in resolutions]


@click.command()
@click.argument("problem", shell_complete=completion.scenes)
@click.argument("integrator", shell_complete=completion.integrators)
@click.option(
    "--steps",
    callback=options.numbers,
    metavar="H1,H2,...",
    help="Step sizes in s; five halvings of the scene's nominal step if not given.",
)
@options.with_pattern
@options.with_t_end
@options.with_set
@options.with_budget
@options.with_plugins
@options.with_as_json
def order(
    problem: str,
    integrator: str,
    steps: tuple[float, ...] | None,
    pattern: tuple[float, ...] | None,
    t_end: float | None,
    settings: dict[str, str],
    budget: float,
    plugins: tuple[str, ...],
    as_json: bool,
) -> None:
    """Measure the order of one integrator.

    The order of convergence at constant steps is fitted for each group of variables and each norm.

    \b
    Examples:
      stepbench order pendulum "generalized_alpha[rho_inf=0.9]" --steps 0.01,0.005,0.0025,0.00125
      stepbench order spring_mass "generalized_alpha[gamma=updated]" --pattern 0.3,0.7 --t-end 5
    """
    registry = options.usable_registry(plugins)
    scene = registry.problem(problem, **settings)
    method = registry.integrator(integrator)
    cells = order_cells(scene, method, steps, pattern, t_end)
    from bench.running.session import solve_cells

    with options.waiting() as working:
        results, _ = solve_cells(
            cells, registry, 0, budget, printed=options.say_printed, working=working
        )
    records = [record for record, _ in results]
    orders = summary.orders(records)
    failed = [record for record in records if record.status != "ok"]
    refused = all(record.status == UNSUPPORTED for record in records)
    if as_json:
        click.echo(json.dumps(orders, indent=2))
    elif len(failed) < len(records):
        from bench.commands.terminal import show
        from bench.commands.terminal_tables import order_table

        show(order_table(records, orders))
    if refused:
        reason = records[0].message
        raise click.ClickException(f"{method.spec} does not take {scene.spec}: {reason}")
    for record in failed:
        click.echo(f"{record.resolution}: {record.status}: {record.message}", err=True)
    if len(failed) == len(records):
        raise click.ClickException("No run succeeded.")
