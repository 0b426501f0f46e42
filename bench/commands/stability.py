"""The command `stepbench stability`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from bench.commands import completion, options
from bench.commands.pages import view
from problems.spec import SpecError

_SYSTEMS = ("oscillator", "relaxation", "loop", "coupled", "joined")


@click.command()
@click.argument(
    "names", nargs=-1, required=True, metavar="INTEGRATOR...", shell_complete=completion.integrators
)
@click.option(
    "--at", callback=options.numbers, metavar="WH1,WH2,...", help="Values of omega h to report."
)
@options.with_pattern
@click.option("--zeta", type=float, help="Damping ratio of the oscillator; 0 if not given.")
@click.option(
    "--system",
    type=click.Choice(_SYSTEMS),
    default=_SYSTEMS[0],
    show_default=True,
    help="Linear test system; for relaxation, omega is the decay rate.",
)
@click.option(
    "--ratios",
    type=click.Choice(["none", "alternating", "any"]),
    default="alternating",
    show_default=True,
    help="Patterns in which the largest safe step ratio is sought: two steps in turns, which takes "
    "seconds, or any of up to six, which takes a minute.",
)
@options.with_budget
@options.with_folder("stepbench-stability", "Folder of the page.")
@options.with_plugins
@options.with_as_json
def stability(
    names: tuple[str, ...],
    at: tuple[float, ...] | None,
    pattern: tuple[float, ...] | None,
    zeta: float | None,
    system: str,
    ratios: str,
    budget: float,
    out: Path,
    plugins: tuple[str, ...],
    as_json: bool,
) -> None:
    """Analyse stability at constant steps.

    The amplification matrix of each integrator is found by taking its step on a linear system. From
    it come the spectral radius, numerical damping, period error, overshoot, stability limit,
    bifurcation, and the largest ratio of steps that is safe. Writes a page with charts and maps.
    With --pattern omega h is that of the macro step, and so is the radius.

    \b
    Examples:
      stepbench stability "generalized_alpha[rho_inf=0.8]" newmark kvaerno5
      stepbench stability "generalized_alpha[gamma=updated]" --pattern 0.3,0.7 --at 4.47
      stepbench stability "generalized_alpha[gamma=guarded]" --pattern 0.3,0.7 --at 4.47
      stepbench stability "newmark[beta=0]" --at 1,1.9,2.1 --json
      stepbench stability my_method --plugins my_method.py
    """
    for value in at or ():
        if not 0 < value < float("inf"):
            raise SpecError(f"omega h = {value:g} is not allowed; give a positive number.")
    if zeta is not None and system != _SYSTEMS[0]:
        raise SpecError(f"--zeta damps the oscillator; the system {system} has no such number.")
    registry = options.usable_registry(plugins)
    methods = options.integrators_once(registry, names)
    from bench.stability.analysis import analysis_job

    results, faults = [], []
    for method in methods:
        task = method.spec, system, zeta, pattern or (1.0,), at or (), ratios
        try:
            found = options.guarded(method.spec, analysis_job, method.sources, budget, task)
            results.append(found)
        except SpecError as error:
            faults.append(str(error))
    if results:
        _show(results, out, as_json)
    if faults:
        raise click.ClickException(" ".join(faults))


def _show(results: list[dict[str, Any]], out: Path, as_json: bool) -> None:
    if as_json:
        click.echo(json.dumps(results, indent=2, allow_nan=False))
        return
    from bench.commands.terminal import show
    from bench.stability.tables import stability_tables

    facts, *tables = stability_tables(results)
    for name, *cells in facts.rows:  # of many columns, which a terminal has no room for
        lines = (f"  {head}: {cell}" for head, cell in zip(facts.head[1:], cells, strict=True))
        show(f"{name}, {results[0]['system']}", *lines)
    show(*tables)
    click.echo(f"Page: {view('stability')(results, out)}")
