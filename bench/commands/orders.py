"""The command `stepbench order`: orders that methods claim, beside those that are measured."""

from __future__ import annotations

from collections.abc import Sequence

import click

from bench.commands import options
from bench.commands.options import BUDGET_S, Given
from bench.commands.suite import in_common, run_suite, write_reports
from bench.running.inventory import Inventory, SceneFacts
from bench.running.plan import Suite, make_suite
from bench.running.profiles import ProfileFile, StudyFile
from problems.base.spec import SpecError

#: What a report shows of runs that were made for their orders.
_FIGURES = ("orders", "convergence")


@options.command(
    "order",
    options.PROBLEM,
    options.METHODS,
    options.numbers(
        "--steps", "H1,H2,...",
        "Step sizes in s; five halvings of the scene's nominal step if not given.",
    ),
    options.PATTERN,
    options.T_END,
    *options.SET,
    options.budget(),
    options.PLUGINS,
    options.folder("Folder of the runs and their report.", "stepbench-orders"),
    options.FRESH,
    options.jobs("Worker processes."),
)  # fmt: skip
def order_(o: Given) -> None:
    """Measure the order of integrators at constant steps.

    The table has for each group of variables the order that is claimed, the one after the start
    transient, and the one from the first step; the report has errors over steps. `stepbench run
    orders` measures every native method that takes constant steps.

    \b
    Examples:
      stepbench order pendulum "generalized_alpha[rho_inf=0.9]" --steps 0.01,0.005,0.0025,0.00125
      stepbench order spring_mass "generalized_alpha[gamma=updated]" --pattern 0.3,0.7 --t-end 5
      stepbench order pendulum newmark bdf2 "bdf2[formulation=index2]"
    """
    registry = options.usable_registry(o.plugins)
    scene = registry.problem(o.problem, **o.settings)
    suite = suite_of_orders(registry, scene, o.names, o.budget, o.steps, o.pattern, o.t_end)
    outcome = run_suite(suite, registry, o.out, o.fresh, o.jobs)
    from bench.commands.terminal import show
    from reports.tables.order_table import stored_order_tables

    tables = stored_order_tables(o.out)
    if not tables:
        raise click.ClickException(f"No order was measured. {in_common(outcome.records)}")
    show(*tables)
    for sentence in outcome.sentences:
        click.echo(sentence)
    write_reports(o.out)


def suite_of_orders(
    registry: Inventory,
    scene: SceneFacts,
    integrators: Sequence[str],
    budget: float = BUDGET_S,
    steps: Sequence[float] | None = None,
    pattern: Sequence[float] | None = None,
    t_end: float | None = None,
) -> Suite:
    """Return the runs of methods on a scene to which their orders are fitted.

    Raises
    ------
    SpecError
        If a method chooses its own steps, or steps or the end time are not allowed.
    """
    for method in map(registry.integrator, integrators):
        if method.controls != "step":
            raise SpecError(
                f"{method.spec} chooses its own steps, over which no order can be measured; name "
                "methods of constant steps, for some with the option steps=constant."
            )
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
