"""The command `stepbench order`: orders of one method in full, or claims of many beside them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import click
from msgspec.structs import replace

from bench.commands import completion, options
from bench.commands.pages import view, write_reports
from bench.commands.suite import in_common, run_suite
from bench.plugins.facts import SceneFacts
from bench.plugins.reasons import Unavailable
from bench.results.orders import EXACT, EXACT_NOTE, order_summary
from bench.results.records import UNSUPPORTED, Record
from bench.results.table import NO_VALUE, Table, formatted
from bench.running.inventory import Inventory, PluginFailed
from bench.running.plan import Suite, make_suite
from bench.running.profiles import ProfileFile, StudyFile, is_suite, read_profile
from bench.running.progress import Progress
from problems.spec import SpecError

#: Processor time of a run in s, if no other is given.
_BUDGET_S = 300.0
#: What a report shows of runs that were made for their orders.
_FIGURES = ("orders", "convergence")


@click.command("order")
@click.argument("problem", metavar="SCENE|SUITE", shell_complete=completion.scenes)
@click.argument(
    "integrators", nargs=-1, metavar="[INTEGRATOR]...", shell_complete=completion.integrators
)
@click.option(
    "--steps",
    callback=options.numbers,
    metavar="H1,H2,...",
    help="Step sizes in s; five halvings of the scene's nominal step if not given.",
)
@options.with_pattern
@options.with_t_end
@options.with_set
@options.with_given_budget(
    f"Processor time in s after which a run is stopped; {_BUDGET_S:g}, or a suite's own, if not "
    "given."
)
@options.with_plugins
@options.with_as_json
@click.option("--markdown", is_flag=True, help="Print the table in Markdown, and write no report.")
@click.option(
    "--out",
    type=options.PathName("folder"),
    help="Folder of the runs of a table and their report; stepbench-orders if not given.",
)
@options.with_fresh
@click.option(
    "--jobs",
    type=click.IntRange(1, options.MOST_JOBS),
    help="Worker processes for a table; 2 if not given.",
)
def order_(
    problem: str,
    integrators: tuple[str, ...],
    budget: float | None,
    plugins: tuple[str, ...],
    as_json: bool,
    markdown: bool,
    out: Path | None,
    fresh: bool,
    jobs: int | None,
    **given: Any,
) -> None:
    """Measure the order of integrators at constant steps.

    Of one INTEGRATOR on a SCENE, errors and fitted orders are shown for each group of variables and
    each norm. For several, or with --markdown, a table has for each group the order that is
    claimed, the one after the start transient, and the one from the first step. A SUITE is
    measured scene by scene; without names it has its own methods. The suite orders has every
    native method that takes constant steps.

    \b
    Examples:
      stepbench order pendulum "generalized_alpha[rho_inf=0.9]" --steps 0.01,0.005,0.0025,0.00125
      stepbench order spring_mass "generalized_alpha[gamma=updated]" --pattern 0.3,0.7 --t-end 5
      stepbench order pendulum newmark bdf2 "bdf2[formulation=index2]"
      stepbench order orders my_method --plugins my_method.py
      stepbench order orders --markdown
    """
    from bench.commands.terminal import RunProgress, show

    if len(integrators) == 1 and not (markdown or is_suite(problem)):
        options.refuse("is for a table; name several integrators.", out=out, fresh=fresh, jobs=jobs)
        with RunProgress() as progress:
            seconds = budget or _BUDGET_S
            found = order_records(problem, integrators[0], plugins, seconds, progress, **given)
        _show_one(found, as_json)
        return
    if as_json:
        raise SpecError(
            "--json is for one integrator; for a table, `stepbench report FOLDER --json` has "
            "the runs."
        )
    registry, out = Inventory(plugins), out or Path("stepbench-orders")
    suite = _suite(registry, problem, integrators, budget, **given)
    outcome = run_suite(suite, registry, out, fresh, jobs or 2, drawn=not markdown)
    tables = view("order_tables")(out)
    if not tables:
        raise click.ClickException(f"No order was measured. {in_common(outcome.records)}")
    if markdown:
        click.echo(view("order_tables_in_markdown")(out))
        return
    show(*tables)
    for sentence in outcome.sentences:
        click.echo(sentence)
    write_reports(out)


# ---- one method --------------------------------------------------------------------------
def order_records(
    problem: str,
    integrator: str,
    plugins: Sequence[str | Path],
    budget: float,
    progress: Progress,
    *,
    steps: Sequence[float] | None,
    pattern: tuple[float, ...] | None,
    t_end: float | None,
    settings: Mapping[str, Any] | None,
) -> list[Record]:
    """Run a method at all steps to which an order is fitted.

    Raises
    ------
    SpecError
        If the method chooses its own steps, or steps or the end time are not allowed.
    """
    from bench.running.session import solve_cells

    registry, scene, _ = options.asked_for(problem, integrator, settings, plugins)
    cells = [
        *_on_scene(registry, scene, [integrator], budget, steps, pattern, t_end).cells.values()
    ]
    results, _ = solve_cells(cells, registry, 0, budget_s=budget, progress=progress)
    return [record for record, _ in results]


def _show_one(records: Sequence[Record], as_json: bool) -> None:
    """Show errors and orders of a method on a scene."""
    from bench.commands.terminal import show

    orders = order_summary(records)
    failed = [record for record in records if record.status != "ok"]
    if as_json:
        click.echo(json.dumps(orders, indent=2))
    elif len(failed) < len(records):
        show(*_tables(records, orders))
    first = records[0]
    if all(record.status == UNSUPPORTED for record in records):
        raise click.ClickException(
            f"{first.integrator} does not take {first.problem}: {first.message}"
        )
    for record in failed:
        click.echo(f"{record.resolution}: {record.status}: {record.message}", err=True)
    if len(failed) == len(records):
        raise click.ClickException("No run succeeded.")


def _tables(records: Sequence[Record], orders: Mapping[str, Any]) -> tuple[Table, Table]:
    """Errors at each step in the norm "settled", and the orders fitted in every norm."""
    name = f"{records[0].integrator} on {records[0].problem}"
    errors = [
        [record.resolution.removeprefix("h="), *(formatted(e, ".2e") for e in settled)]
        for record, *settled in zip(
            records, *(own["settled"] for own in orders["errors"].values()), strict=True
        )
    ]
    fits = []
    for group, by_norm in orders["orders"].items():
        for norm, order in by_norm.items():
            window = orders["window"][group][norm] or (None, None)
            found = orders["verdict"][group][norm] if order is None else f"{order:.2f}"
            points = str(orders["points"][group][norm] or NO_VALUE)
            fits.append([group, norm, found, points, *(formatted(h, ".3g") for h in window)])
    head = ["group", "norm", "order", "points", "from h", "to h"]
    note = EXACT_NOTE if any(row[2] == EXACT for row in fits) else ""
    return (
        Table(f"{name}: relative error, norm 'settled'", ["h", *orders["orders"]], errors),
        Table("Fitted orders", head, fits, note=note),
    )


# ---- many methods ------------------------------------------------------------------------
def _suite(
    registry: Inventory,
    name: str,
    integrators: Sequence[str],
    budget: float | None,
    *,
    steps: tuple[float, ...] | None,
    pattern: tuple[float, ...] | None,
    t_end: float | None,
    settings: Mapping[str, str],
) -> Suite:
    """The runs of methods on a scene, or on the scenes of a suite."""
    if not is_suite(name):
        scene = registry.problem(name, **settings)
        return _on_scene(registry, scene, integrators, budget or _BUDGET_S, steps, pattern, t_end)
    why = "belongs to one scene; a suite has its own."
    options.refuse(why, steps=steps, pattern=pattern, t_end=t_end, set=settings)
    title, profile = read_profile(name)
    files = [
        replace(
            file,
            figures=_FIGURES,
            integrators=[text for text in file.integrators if _is_measured(registry, text)],
        )
        for file in profile.study
    ]
    if integrators:
        files = _of_methods(files, registry, _of_constant_steps(registry, integrators))
    profile = replace(profile, study=files, samples=0, atlas=False)
    return make_suite(title, profile, registry, (), integrators, budget)


def _on_scene(
    registry: Inventory,
    scene: SceneFacts,
    integrators: Sequence[str],
    budget: float,
    steps: Sequence[float] | None,
    pattern: tuple[float, ...] | None,
    t_end: float | None,
) -> Suite:
    """The runs of methods on one scene."""
    if not integrators:
        raise SpecError(f"No integrator is named for {scene.spec}; see `stepbench list`.")
    _of_constant_steps(registry, integrators)
    if steps and len(steps) < 3:
        raise SpecError(f"An order needs at least three step sizes; {len(steps)} came.")
    study = StudyFile(
        problems=[scene.spec],
        integrators=list(integrators),
        t_end=t_end,
        steps=list(steps) if steps else None,  # halvings of the scene's own
        pattern=pattern or (1.0,),
        figures=_FIGURES,
    )
    profile = ProfileFile(study=[study], samples=0, budget_s=budget)
    return make_suite("orders", profile, registry, [scene.spec])


def _of_constant_steps(registry: Inventory, integrators: Sequence[str]) -> dict[str, str]:
    """The printed names of methods by the names that were given; none chooses its steps."""
    named = {}
    for text in integrators:
        with suppress(PluginFailed):  # the suite says why
            method = registry.integrator(text)
            if method.controls != "step":
                raise SpecError(
                    f"{method.spec} chooses its own steps, over which no order can be measured; "
                    "name methods of constant steps, for some with the option steps=constant."
                )
            named[text] = method.spec
    return named


def _is_measured(registry: Inventory, text: str) -> bool:
    """Whether a method of a suite takes constant steps, or is of no use, as the suite then says."""
    try:
        return registry.integrator(text).controls == "step"
    except (PluginFailed, Unavailable):
        return True


def _of_methods(
    studies: Sequence[StudyFile], registry: Inventory, named: Mapping[str, str]
) -> list[StudyFile]:
    """The studies of these methods alone; those that none of a scene has get one more."""
    files = []
    for problem in dict.fromkeys(problem for file in studies for problem in file.problems):
        rest = {*named.values()}
        more = StudyFile(problems=[problem], integrators=[*named], figures=_FIGURES)
        more.title = f"{problem}: methods named"
        for file in [*(file for file in studies if problem in file.problems), more]:
            own = [text for text in file.integrators if registry.integrator(text).spec in rest]
            rest -= {registry.integrator(text).spec for text in own}
            files += [replace(file, problems=[problem], integrators=own)] if own else []
    return files
