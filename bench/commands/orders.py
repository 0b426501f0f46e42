"""The command `stepbench order`: orders of one method in full, or claims of many beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import click
from msgspec.structs import replace

from bench.commands import options
from bench.commands.options import BUDGET_S, Given
from bench.commands.suite import in_common, run_suite, write_reports
from bench.plugins.registry import Unavailable
from bench.results.orders import EXACT, EXACT_NOTE, order_summary
from bench.results.records import UNSUPPORTED, Record
from bench.results.table import NO_VALUE, Table, formatted
from bench.running.inventory import Inventory, SceneFacts
from bench.running.plan import Suite, make_suite
from bench.running.profiles import ProfileFile, StudyFile, is_suite, read_profile
from bench.running.progress import Progress
from problems.base.spec import SpecError

#: What a report shows of runs that were made for their orders.
_FIGURES = ("orders", "convergence")


@options.command(
    "order",
    options.argument("problem", "SCENE|SUITE"),
    options.argument("integrators", "[INTEGRATOR]...", nargs=-1),
    options.numbers(
        "--steps", "H1,H2,...",
        "Step sizes in s; five halvings of the scene's nominal step if not given.",
    ),
    options.PATTERN,
    options.T_END,
    *options.SET,
    options.budget(
        f"Processor time in s after which a run is stopped; {BUDGET_S:g}, or a suite's own, if not "
        "given.",
        None,
    ),
    options.PLUGINS,
    options.JSON,
    options.flag("--markdown", "Print the table in Markdown, and write no report."),
    options.folder("Folder of the runs of a table and their report.", "stepbench-orders"),
    options.FRESH,
    options.jobs("Worker processes for a table."),
)  # fmt: skip
def order_(o: Given) -> None:
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

    sizes = {"steps": o.steps, "pattern": o.pattern, "t_end": o.t_end}
    if len(o.integrators) == 1 and not (o.markdown or is_suite(o.problem)):
        options.refuse("is for a table; name several integrators.", "out", "fresh", "jobs")
        registry = options.usable_registry(o.plugins)
        scene = registry.problem(o.problem, **o.settings)
        with RunProgress() as progress:
            found = order_records(
                registry, scene, o.integrators[0], o.budget or BUDGET_S, progress, **sizes
            )
        _show_one(found, o.as_json)
        return
    if o.as_json:
        raise SpecError(
            "--json is for one integrator; for a table, `stepbench report FOLDER --json` has "
            "the runs."
        )
    registry = Inventory(o.plugins)
    if is_suite(o.problem):
        options.refuse(
            "belongs to one scene; a suite has its own.",
            *("steps", "pattern", "t_end", "settings", "keyframe"),
        )
        suite = _of_suite(registry, o.problem, o.integrators, o.budget)
    else:
        scene = registry.problem(o.problem, **o.settings)
        suite = _on_scene(registry, scene, o.integrators, o.budget or BUDGET_S, **sizes)
    outcome = run_suite(suite, registry, o.out, o.fresh, o.jobs)
    from reports.pages.templating import markdown_table
    from reports.tables.order_table import stored_order_tables

    tables = stored_order_tables(o.out)
    if not tables:
        raise click.ClickException(f"No order was measured. {in_common(outcome.records)}")
    if o.markdown:
        click.echo("\n\n".join(map(markdown_table, tables)))
        return
    show(*tables)
    for sentence in outcome.sentences:
        click.echo(sentence)
    write_reports(o.out)


# ---- one method --------------------------------------------------------------------------
def order_records(
    registry: Inventory,
    scene: SceneFacts,
    integrator: str,
    budget: float,
    progress: Progress,
    *,
    steps: Sequence[float] | None,
    pattern: Sequence[float] | None,
    t_end: float | None,
) -> list[Record]:
    """Run a method at all steps to which an order is fitted.

    Raises
    ------
    SpecError
        If the method chooses its own steps, or steps or the end time are not allowed.
    """
    from bench.running.session import solve_cells

    suite = _on_scene(registry, scene, [integrator], budget, steps, pattern, t_end)
    cells = [*suite.cells.values()]
    return [record for record, _ in solve_cells(cells, registry, budget, progress=progress)]


def _show_one(records: Sequence[Record], as_json: bool) -> None:
    """Show errors and orders of a method on a scene."""
    from bench.commands.terminal import show

    orders = order_summary(records)
    failed = [record for record in records if record.status != "ok"]
    if as_json:
        options.print_json(orders)
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
    settled = zip(*(own["settled"] for own in orders["errors"].values()), strict=True)
    errors = [
        [record.resolution.removeprefix("h="), *(formatted(e, ".2e") for e in own)]
        for record, own in zip(records, settled, strict=True)
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
def _on_scene(
    registry: Inventory,
    scene: SceneFacts,
    integrators: Sequence[str],
    budget: float,
    steps: Sequence[float] | None,
    pattern: Sequence[float] | None,
    t_end: float | None,
) -> Suite:
    """The runs of methods on one scene."""
    if not integrators:
        raise SpecError(f"No integrator is named for {scene.spec}; see `stepbench list`.")
    _refuse_chosen_steps(registry, integrators)
    if steps and len(steps) < 3:
        raise SpecError(f"An order needs at least three step sizes; {len(steps)} came.")
    study = StudyFile(
        problems=[scene.spec],
        integrators=list(integrators),
        t_end=t_end,
        steps=list(steps) if steps else None,  # halvings of the scene's own
        pattern=tuple(pattern or (1.0,)),
        figures=_FIGURES,
    )
    profile = ProfileFile(study=[study], samples=0, budget_s=budget)
    return make_suite("orders", profile, registry, [scene.spec])


def _of_suite(
    registry: Inventory, name: str, integrators: Sequence[str], budget: float | None
) -> Suite:
    """The runs of a suite's methods of constant steps, or of those named, on its scenes."""
    title, profile = read_profile(name)
    _refuse_chosen_steps(registry, integrators)
    files = [
        replace(file, integrators=own, figures=_FIGURES)
        for file in profile.study
        if (own := [text for text in file.integrators if _has_constant_steps(registry, text)])
    ]
    profile = replace(profile, study=files, samples=0, atlas=False)
    return make_suite(title, profile, registry, (), integrators, budget)


def _refuse_chosen_steps(registry: Inventory, integrators: Sequence[str]) -> None:
    for text in (text for text in integrators if not _has_constant_steps(registry, text)):
        raise SpecError(
            f"{registry.integrator(text).spec} chooses its own steps, over which no order can be "
            "measured; name methods of constant steps, for some with the option steps=constant."
        )


def _has_constant_steps(registry: Inventory, text: str) -> bool:
    """Whether a method takes constant steps; one that is of no use is told of by its suite."""
    try:
        return registry.integrator(text).controls == "step"
    except Unavailable:
        return True
