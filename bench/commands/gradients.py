"""The command `gradient`: derivatives through runs, their errors and their cost."""

from __future__ import annotations

from typing import Any

import click

from bench.commands import options
from bench.commands.measuring import measured, show_or_json, with_scene_and_methods
from bench.running.entries import GradientEntry


def _names(context: click.Context, parameter: click.Parameter, text: str | None) -> list[str]:
    """Read "m,k" as a list of names."""
    return [name.strip() for name in text.split(",")] if text else []


@click.command()
@with_scene_and_methods
@click.option(
    "--of", default="q:end", show_default=True, metavar="GROUP[:end]",
    help="Numbers at the end of the run: q, v, a, lam, x or y, or a component such as q[1].",
)  # fmt: skip
@click.option(
    "--by", required=True, callback=_names, metavar="NAME,...",
    help="Float parameters of the scene.",
)  # fmt: skip
@click.option(
    "--ways", callback=_names, metavar="WAY,...",
    help="Ways to differentiate, of forward and reverse; all that a method has if not given.",
)  # fmt: skip
@click.option(
    "--steps", callback=options.numbers, metavar="H1,H2,...",
    help="Steps in s; the scene's nominal one and three halvings if not given.",
)  # fmt: skip
@options.with_t_end
@options.with_as_json
def gradient(as_json: bool, **given: Any) -> None:
    """Measure derivatives of a run's end by parameters of the scene.

    Runs are differentiated through their steps, forward (a Jacobian-vector product for each
    parameter) or in reverse (a vector-Jacobian product for each number, with checkpoints). Newton's
    solutions are differentiated by the implicit function theorem. The start counts, where it
    depends on a parameter. Exact derivatives solve the variational equations. Costs are processor
    seconds, in plain runs that were measured beside.

    \b
    Examples:
      stepbench gradient iftomm_pendulum generalized_alpha --by g,length
      stepbench gradient iftomm_pendulum newmark bdf2 --of q[0]:end --by g --ways forward
      stepbench gradient pendulum "dopri8[steps=constant]" --of lam --by m --json
    """
    asked, answers, faults = measured(GradientEntry, **given)
    from bench.results.gradients import gradient_sentence, gradient_table

    runs = [run for answer in answers for run in answer.runs]
    if runs:
        exact, said = answers[0].exact, gradient_sentence(runs)
        title = f"{asked.scene.spec}, {given['of']}, t={exact.t_end:g} s"
        value = {"exact": exact, "runs": runs}
        show_or_json(as_json, value, title, gradient_table(exact, runs), said)
    faults += [f"{r.integrator}, {r.way}, {r.resolution}: {r.message}" for r in runs if r.message]
    if faults:
        raise click.ClickException(" ".join(faults))
