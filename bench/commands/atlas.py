"""The command of the failure atlas: `stepbench atlas`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from bench.commands import completion, options
from bench.commands.pages import view
from bench.guard.interrupts import remark


@click.command()
@click.argument("names", nargs=-1, metavar="[EXPERIMENT]...", shell_complete=completion.experiments)
@options.with_integrators("Put this integrator through every experiment, too; repeatable.")
@click.option("--list", "only_list", is_flag=True, help="Name the experiments and stop.")
@options.with_folder("stepbench-atlas", "Folder of the results and the page.")
@options.with_fresh
@options.with_jobs("Worker processes.")
@options.with_given_budget("Processor time in s after which a run is stopped; 60 if not given.")
@options.with_plugins
@options.with_as_json
def atlas(
    names: tuple[str, ...],
    integrators: tuple[str, ...],
    only_list: bool,
    out: Path,
    fresh: bool,
    jobs: int,
    budget: float | None,
    plugins: tuple[str, ...],
    as_json: bool,
) -> None:
    """Show where methods fail, and what helps.

    Every experiment of the failure atlas predicts numbers and measures them. The exit code is 1 if
    a number is not as predicted. The folder keeps the results; an experiment runs again only if it
    has changed.

    \b
    Examples:
      stepbench atlas
      stepbench atlas undamped_index3 start_transient
      stepbench atlas -i "my_method[order=2]" --plugins my_method.py
    """
    import msgspec

    from bench.atlas.experiments import read_experiments
    from bench.atlas.runs import complete
    from bench.commands.terminal import RunProgress, show
    from bench.results.experiments import part_table
    from bench.results.store import Store
    from bench.results.table import Table

    experiments = read_experiments(names)
    if only_list:
        rows = [[str(e.number), e.name, e.title] for e in experiments]
        show(Table("Failure atlas", ["", "name", "what fails"], rows))
        return
    registry = options.usable_registry(plugins)
    added = [registry.integrator(name).spec for name in integrators]
    with Store(out, create=True, fresh=fresh) as store, RunProgress() as progress:
        remark("Finished experiments are stored; the same command goes on.")
        results = complete(experiments, added, store, registry, jobs, progress, budget or 60.0)
    if as_json:
        click.echo(json.dumps(msgspec.to_builtins(results), indent=2))
    else:
        for result in results:
            show(
                f"{result.number}. {result.title}: {result.verdict}", *map(part_table, result.parts)
            )
        click.echo(f"Page: {view('atlas')(results, out)}")
    differ = [f"{result.name} ({result.verdict})" for result in results if not result.as_predicted]
    if differ:
        raise click.ClickException(f"Not all is as predicted: {', '.join(differ)}.")
