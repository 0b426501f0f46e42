"""Ensembles: the options and the work of `stepbench solve --ensemble`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bench.commands import options
from bench.results.csv_text import csv_export
from problems.spec import SpecError

if TYPE_CHECKING:
    from bench.plugins.facts import Sources
    from bench.sweeps.jobs import SweepRequest

_MOST_MEMBERS = 1_000_000


def with_ensemble(command: Callable) -> Callable:
    """Add the options of an ensemble to `stepbench solve`."""
    for option in (
        options.with_file("File for the members, .csv or .json, a flat row each, for pandas."),
        click.option(
            "--seed", type=click.IntRange(min=0), help="Seed of the random draw; 0 if not given."
        ),
        click.option(
            "--vary",
            multiple=True,
            metavar="NAME:LOW..HIGH",
            help="Draw h, a parameter or an option of each member evenly from this range (in the "
            "logarithm if it is wide); repeatable.",
        ),
        click.option(
            "--ensemble",
            type=click.IntRange(1, _MOST_MEMBERS),
            metavar="N",
            help="Run N members in one compiled program; needs --vary.",
        ),
    ):
        command = option(command)
    return command


def refuse_alone(vary: tuple[str, ...], seed: int | None, out: Path | None) -> None:
    """Refuse the options of an ensemble for a single run."""
    given = {"vary": vary, "seed": seed, "out": out}
    for name, value in given.items():
        if value not in (None, ()):
            raise SpecError(f"--{name} is for an ensemble; give --ensemble N, too.")


def solve_ensemble(
    sources: Sources,
    request: SweepRequest,
    count: int,
    vary: tuple[str, ...],
    seed: int | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Draw the members, run them, and show or write the results."""
    from bench.sweeps.jobs import ensemble_job

    if not vary:
        raise SpecError("An ensemble needs something in which its members differ; give --vary.")
    if out and out.suffix not in (".csv", ".json"):
        raise SpecError(f"{out.name} is no table; give a name that ends in .csv or .json.")
    task = request, count, vary, seed or 0
    about = f"{request.integrator} on {request.problem}"
    result = options.guarded(about, ensemble_job, sources, request.budget, task, threads=True)
    rows, statuses = result.rows(), result.statuses()
    if as_json:
        answer = {
            "problem": result.problem,
            "integrator": result.integrator,
            "t_end": result.t_end,
            "statuses": statuses,
            "summary": result.summary(),
            "compile_s": result.compile_s,
            "run_s": result.run_s,
            "members": rows,
        }
        click.echo(json.dumps(answer, indent=1, allow_nan=False))
    else:
        from bench.commands.terminal import show
        from bench.commands.terminal_tables import ensemble_table

        show(ensemble_table(result))
    if out:
        as_json_file = out.suffix == ".json"
        text = json.dumps(rows, indent=1, allow_nan=False) if as_json_file else csv_export(rows)
        out.write_text(text, encoding="utf-8")
        click.echo(f"{len(rows)} members in {out}", err=as_json)
    if "ok" not in statuses:
        raise click.ClickException(f"No member succeeded. The first: {result.message[0]}")
