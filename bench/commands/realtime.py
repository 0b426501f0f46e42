"""The command that runs methods at a fixed rate: `stepbench realtime`."""

from __future__ import annotations

from typing import Any

import click

from bench.commands import options
from bench.commands.measuring import measured, show_or_json, with_scene_and_methods
from bench.running.entries import MOST_ITERATIONS, RealTimeEntry


@click.command("realtime")
@with_scene_and_methods
@click.option(
    "--rate", required=True, metavar="RATE", help="Steps per second: 1kHz, 500Hz or 1000."
)
@click.option(
    "--iterations",
    type=click.IntRange(1, MOST_ITERATIONS),
    help="Most iterations in each call of Newton's method; 1 and unlimited side by side if not "
    "given.",
)
@click.option(
    "--duration", type=float, help="Length of the run in s; the scene's interval if not given."
)
@options.with_as_json
def realtime_(as_json: bool, **given: Any) -> None:
    """Run methods with a fixed budget per step, as in real time.

    Each step of 1/RATE takes at most so many iterations of Newton's method and goes on, converged
    or not; explicit and linearly implicit methods have none. The host calls one compiled step for
    each tick. The tables have the time per step, the steps that took longer than 1/RATE, and errors
    and residuals of the same run.

    \b
    Examples:
      stepbench realtime slider_crank linearly_implicit_euler generalized_alpha --rate 1kHz
      stepbench realtime quarter_car "bdf2[newton=modified]" --rate 500Hz --iterations 2
      stepbench realtime pendulum half_explicit_euler stormer_verlet --rate 1000 --duration 1 --json
    """
    _, answers, faults = measured(RealTimeEntry, **given)
    from bench.results.realtime import realtime_sentence, realtime_tables

    runs = [run for answer in answers for run in answer]
    if runs:
        said = realtime_sentence(runs)
        show_or_json(as_json, {"runs": runs, "summary": said}, *realtime_tables(runs), said)
    faults += [f"{run.name}: {run.status}: {run.message}" for run in runs if run.status != "ok"]
    if faults:
        raise click.ClickException(" ".join(faults))
