"""The command that runs methods in several precisions: `stepbench precision`."""

from __future__ import annotations

from typing import Any

import click

from bench.commands import options
from bench.commands.measuring import measured, show_or_json, with_scene_and_methods
from bench.running.entries import PrecisionEntry


@click.command()
@with_scene_and_methods
@click.option(
    "--steps", callback=options.numbers, metavar="H1,H2,...",
    help="Steps in s; the scene's nominal one and six halvings if not given.",
)  # fmt: skip
@options.with_t_end
@click.option("--csv", "form", flag_value="csv", help="Print a row for each run.")
@click.option("--json", "form", flag_value="json", help="Print JSON.")
def precision(form: str | None, **given: Any) -> None:
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
    _, answers, faults = measured(PrecisionEntry, **given)
    from bench.results.csv_text import csv_export
    from bench.results.precision import csv_row, precision_sentences, precision_tables

    runs = [run for answer in answers for run in answer]
    if runs and form == "csv":
        click.echo(csv_export([csv_row(run) for run in runs]), nl=False)
    elif runs:
        said = precision_sentences(runs)
        value = {"runs": runs, "summary": said}
        show_or_json(form == "json", value, *precision_tables(runs), *said)
    if faults:
        raise click.ClickException(" ".join(faults))
