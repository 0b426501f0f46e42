"""The command that runs methods in several precisions: `stepbench precision`."""

from __future__ import annotations

import click

from bench.commands import completion, options
from bench.commands.studies import of_each, once_each, print_json, with_names
from bench.plugins.facts import MethodFacts
from problems.spec import SpecError

#: Steps that are taken if none are given: the scene's nominal one, and halves of it.
_HALVINGS = 6


@click.command()
@click.argument("problem", metavar="SCENE", shell_complete=completion.scenes)
@with_names
@click.option(
    "--steps", callback=options.numbers, metavar="H1,H2,...",
    help="Steps in s; the scene's nominal one and six halvings if not given.",
)  # fmt: skip
@options.with_t_end
@options.with_set
@options.with_budget
@options.with_plugins
@click.option("--csv", "form", flag_value="csv", help="Print a row for each run.")
@click.option("--json", "form", flag_value="json", help="Print JSON.")
def precision(
    problem: str,
    names: tuple[str, ...],
    steps: tuple[float, ...] | None,
    t_end: float | None,
    settings: dict[str, str],
    budget: float,
    plugins: tuple[str, ...],
    form: str | None,
) -> None:
    """Run methods in double, single and mixed precision.

    In single all floats of a step have 32 bits. In mixed, states and residuals have 64 bits, and
    linear systems are solved in 32, so that Newton's method corrects what they lack. All runs are
    compared with the same reference. A sentence for each method says from which step on rounding
    decides its errors, and the slope of the error there: -2 for multipliers on index 3.

    \b
    Examples:
      stepbench precision pendulum generalized_alpha --steps 1e-2,2.5e-3,1e-3,2.5e-4
      stepbench precision pendulum bdf2 "bdf2[formulation=index2]" --csv > errors.csv
      stepbench precision slider_crank "generalized_alpha[formulation=stabilised_index2]" --json
    """
    registry = options.usable_registry(plugins)
    scene, methods = registry.problem(problem, **settings), once_each(registry, names)
    end = options.end_time(scene, t_end)
    sizes = steps or tuple(scene.nominal_step * 2.0**-k for k in range(_HALVINGS + 1))
    from bench.commands.terminal import show
    from bench.results.csv_text import csv_export
    from bench.results.precision import (
        PrecisionRun,
        csv_row,
        precision_sentences,
        precision_tables,
    )
    from bench.running.precision import precision_job

    def measured(method: MethodFacts) -> list[PrecisionRun]:
        task = scene.spec, method.spec, sizes, end
        sources = scene.sources | method.sources
        return options.guarded(method.spec, precision_job, sources, budget, *task)

    results, faults = of_each(methods, measured)
    runs = [run for result in results for run in result]
    if runs and form == "json":
        print_json({"runs": runs, "summary": precision_sentences(runs)})
    elif runs and form == "csv":
        click.echo(csv_export([csv_row(run) for run in runs]), nl=False)
    elif runs:
        show(*precision_tables(runs), *precision_sentences(runs))
    if faults:
        raise SpecError(" ".join(faults))
