"""The command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bench.commands import atlas, maps, options, plugins, results, scenes, stability
from bench.commands.results import DEFAULT_OUT
from bench.plugins.registry import Registry, explain
from bench.results import summary
from bench.results.csv_text import csv_text
from bench.results.records import flatten
from bench.results.store import Store
from bench.running import plan as plans
from bench.running.plan import Cell, check_end, make_suite
from bench.running.profiles import read_profile
from integrators.contract import Steps
from problems.spec import SpecError

if TYPE_CHECKING:
    from bench.running.worker import CellResult


@click.group(
    cls=options.ShortErrors,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="""\b
Examples:
  stepbench run
  stepbench solve pendulum "generalized_alpha[rho_inf=0.8]" --step 0.01
  stepbench order pendulum newmark --steps 0.02,0.01,0.005,0.0025
  stepbench run -i my_method --plugins my_method.py
  stepbench new integrator my_method && stepbench check my_method.py
""",
)
@click.version_option(package_name="stepbench")
def main() -> None:
    """Compare time integrators for mechanical and mechatronic systems.

    Positions, velocities, accelerations, multipliers and controller states are compared
    separately, against the work that each integrator does for them.
    """


@main.command("list")
@click.argument("kind", type=click.Choice(["problems", "integrators", "all"]), default="all")
@options.with_plugins
@options.with_as_json
def list_(kind: str, plugins: tuple[str, ...], as_json: bool) -> None:
    """List the scenes and integrators, with those that are unavailable and why.

    \b
    Examples:
      stepbench list
      stepbench list integrators --json
    """
    registry = Registry(plugins)
    kinds = ["problems", "integrators"] if kind == "all" else [kind]
    if as_json:
        rows = {
            k: [
                {
                    "name": p.name,
                    "summary": p.summary,
                    "origin": p.origin,
                    "available": p.cls is not None,
                    "reason": p.reason,
                    "options": p.options,
                }
                for p in getattr(registry, k).values()
            ]
            for k in kinds
        }
        click.echo(json.dumps(rows, indent=2))
        return
    from bench.commands.terminal import plugin_table, show

    for k in kinds:
        show(plugin_table(k, list(getattr(registry, k).values())))


@main.command()
@click.argument("problem")
@click.argument("integrator")
@click.option("--step", type=float, help="Step size h in s (with --pattern: the macro step H).")
@options.with_pattern
@options.with_tolerances
@options.with_t_end
@options.with_set
@maps.with_ensemble
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
    out: Path | None,
    budget: float,
    plugins: tuple[str, ...],
    as_json: bool,
) -> None:
    """Run one integrator on one scene and show the end values, errors and work.

    With --ensemble, run many members that differ in what --vary says.

    \b
    Examples:
      stepbench solve spring_mass "generalized_alpha[rho_inf=0.8]" --step 0.1 --t-end 5
      stepbench solve pendulum ida --rtol 1e-8 --set th0=3.0 --json
      stepbench solve quarter_car generalized_alpha --ensemble 1000 --vary k:2e4..3e4 -o cars.csv
    """
    registry = Registry(plugins)
    registry.require_files()
    scene = registry.problem(problem, **settings)
    method = registry.integrator(integrator)
    if ensemble is not None:
        given = {"step": step, "pattern": pattern, "rtol": rtol, "atol": atol}
        maps.solve_ensemble(scene, method, given, t_end, ensemble, vary, seed, budget, out, as_json)
        return
    maps.refuse_alone(vary, seed, out)
    end = check_end(scene.interval[0], scene.interval[1] if t_end is None else t_end)
    resolution = options.resolution(scene, method, step, pattern, rtol, atol)
    if isinstance(resolution, Steps):
        count = resolution.count(scene.interval[0], end)
        used = (end - scene.interval[0]) / count
        if abs(used - resolution.h) > 1e-9 * used:
            click.echo(
                f"Step {resolution.h:g} s does not divide the interval; {count} steps of "
                f"{used:.9g} s are taken.",
                err=True,
            )
    cell = Cell(scene.spec, method.spec, end, resolution)
    ((record, rows),) = _solve([cell], registry, samples=5, budget=budget)
    if as_json:
        click.echo(json.dumps(summary.solution(record, rows), indent=2))
    else:
        from bench.commands.terminal import show, solution_table

        show(solution_table(record, rows))
    if record.status != "ok":
        raise click.ClickException(f"{record.status}: {record.message}")


@main.command()
@click.argument("problem")
@click.argument("integrator")
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
    """Fit the order of convergence of a fixed-step integrator, per group and norm.

    \b
    Examples:
      stepbench order pendulum "generalized_alpha[rho_inf=0.9]" --steps 0.01,0.005,0.0025,0.00125
      stepbench order spring_mass "generalized_alpha[gamma=updated]" --pattern 0.3,0.7 --t-end 5
    """
    registry = Registry(plugins)
    registry.require_files()
    scene = registry.problem(problem, **settings)
    method = registry.integrator(integrator)
    if method.controls != "step":
        raise SpecError(f"{method.spec} chooses its own steps; an order over h is not defined.")
    end = check_end(scene.interval[0], scene.interval[1] if t_end is None else t_end)
    sizes = steps or tuple(scene.nominal_step * 2.0**-k for k in range(plans.DEFAULT_HALVINGS))
    if len(sizes) < 3:
        raise SpecError(f"An order needs at least three step sizes; {len(sizes)} came.")
    cells = []
    for h in sizes:
        resolution = Steps(h, pattern or (1.0,))
        resolution.count(scene.interval[0], end)
        cells.append(Cell(scene.spec, method.spec, end, resolution))
    records = [record for record, _ in _solve(cells, registry, samples=0, budget=budget)]
    if as_json:
        click.echo(json.dumps(summary.orders(records), indent=2))
    else:
        from bench.commands.terminal import order_table, show

        show(order_table(records, summary.orders(records)))
    failed = [record for record in records if record.status != "ok"]
    for record in failed:
        click.echo(f"{record.resolution}: {record.status}: {record.message}", err=True)
    if len(failed) == len(records):
        raise click.ClickException("No run succeeded.")


@main.command()
@click.argument("profile", default="quick")
@click.option("-p", "--problem", "problems", multiple=True, help="Only this scene; repeatable.")
@click.option(
    "-i",
    "--integrator",
    "integrators",
    multiple=True,
    help="Only this integrator; repeatable. One that the profile lacks is added.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=DEFAULT_OUT,
    show_default=True,
    help="Folder of the results.",
)
@click.option("--fresh", is_flag=True, help="Forget earlier results in that folder.")
@click.option(
    "--jobs",
    type=click.IntRange(min=1),
    default=2,
    show_default=True,
    help="Worker processes; timing is done by one at a time.",
)
@click.option(
    "--cluster",
    metavar="ADDRESS",
    help="Measure on the workers of a dask scheduler, such as tcp://host:8786; timing stays here.",
)
@options.with_plugins
def run(
    profile: str,
    problems: tuple[str, ...],
    integrators: tuple[str, ...],
    out: Path,
    fresh: bool,
    jobs: int,
    cluster: str | None,
    plugins: tuple[str, ...],
) -> None:
    """Run a suite and write its report.

    PROFILE is the name of a built-in profile (quick, paper) or a TOML file. A run that was
    stopped goes on where it stopped when the same command is given again.

    \b
    Examples:
      stepbench run
      stepbench run paper --out paper-results
      stepbench run -p pendulum -i ida -i "generalized_alpha[rho_inf=0.6]"
      stepbench run full --cluster tcp://head:8786
    """
    from bench.atlas.experiments import read_experiments
    from bench.atlas.runs import complete
    from bench.commands.terminal import RunProgress
    from bench.running.session import measure_suite, runner_for, time_suite
    from bench.stability import damping

    registry = Registry(plugins)
    registry.require_files()
    suite = make_suite(*read_profile(profile), registry, problems, integrators)
    chosen = suite.atlas if isinstance(suite.atlas, list) else []
    experiments = read_experiments(chosen) if suite.atlas else []
    with Store(out, create=True, fresh=fresh) as store, RunProgress() as progress:
        with runner_for(suite, registry, jobs, cluster) as runner:
            measured = measure_suite(suite, store, registry, runner, progress)
            damping.complete(suite, store, registry, runner, progress)
            time_suite(suite, store, runner, progress)
        stored = store.records()
        atlas = complete(experiments, [], store, registry, jobs, progress)
    records = [stored[key] for key in suite.cells]
    good = sum(record.status == "ok" for record in records)
    click.echo(
        f"{len(records)} cells: {good} ok, {len(records) - good} failed with a reason; "
        f"{measured} measured now, {len(records) - measured} kept from before."
    )
    if atlas:
        held = sum(found.as_predicted for found in atlas)
        click.echo(f"{len(atlas)} experiments of the failure atlas: {held} as predicted.")
    _write_reports(out)


@main.command()
@click.argument("folder", type=click.Path(path_type=Path), default=DEFAULT_OUT)
def report(folder: Path) -> None:
    """Make the report pages anew from the results in FOLDER."""
    with Store(folder):
        pass  # says clearly if there is none
    _write_reports(folder)


@main.command()
@click.argument("folder", type=click.Path(path_type=Path), default=DEFAULT_OUT)
@click.option("--csv", "form", flag_value="csv", default=True, help="Comma-separated (default).")
@click.option("--json", "form", flag_value="json", help="A JSON array of flat rows.")
@click.option("--out", "-o", type=click.Path(path_type=Path), help="File; the screen if not given.")
def export(folder: Path, form: str, out: Path | None) -> None:
    """Write all records as flat rows, for pandas.

    \b
    Examples:
      stepbench export stepbench-results --csv -o records.csv
      stepbench export --json > records.json
    """
    with Store(folder) as store:
        rows = [flatten(record) for record in store.records().values()]
    text = json.dumps(rows, indent=1) if form == "json" else csv_text(rows)
    if out:
        out.write_text(text, encoding="utf-8")
        click.echo(f"{len(rows)} records in {out}")
    else:
        click.echo(text, nl=False)


for command in (
    *(plugins.check, plugins.new, scenes.show, scenes.catalogue),
    *(results.compare, results.merge, results.open_, results.figure),
    *(stability.stability, atlas.atlas, maps.map_),
):
    main.add_command(command)


# ---- helpers ---------------------------------------------------------------------------
def _solve(cells: list[Cell], registry: Registry, samples: int, budget: float) -> list[CellResult]:
    from bench.running.session import solve_cells

    return solve_cells(cells, registry, samples, budget)


def _write_reports(folder: Path) -> None:
    from concurrent.futures import ProcessPoolExecutor
    from importlib.metadata import entry_points
    from multiprocessing import get_context

    # Pages do not wait for each other, and a page that fails does not take the other along.
    writers = sorted(entry_points(group="stepbench.reports"), key=lambda entry: entry.name)
    failed = []
    with ProcessPoolExecutor(len(writers), mp_context=get_context("spawn")) as pool:
        pages = {w.name: pool.submit(_write_report, w.value, folder) for w in writers}
        for name, page in pages.items():
            try:
                click.echo(f"Report: {page.result()}")
            except Exception as error:
                failed.append(f"The {name} report could not be written: {explain(error)}")
    if failed:
        raise click.ClickException(" ".join([*failed, "The results are stored."]))


def _write_report(value: str, folder: Path) -> Path:
    from importlib.metadata import EntryPoint

    return EntryPoint("report", value, "stepbench.reports").load()(folder)
