"""The command of the failure atlas: `stepbench atlas`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from bench.commands import options
from bench.commands.scenes import view
from bench.plugins.registry import Registry


@click.command()
@click.argument("names", nargs=-1, metavar="[EXPERIMENT]...")
@click.option(
    "-i",
    "--integrator",
    "integrators",
    multiple=True,
    help="Put this integrator through every experiment, too; repeatable.",
)
@click.option("--list", "only_list", is_flag=True, help="Name the experiments and stop.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default="stepbench-atlas",
    show_default=True,
    help="Folder of the results and the page.",
)
@click.option("--fresh", is_flag=True, help="Forget earlier results in that folder.")
@click.option(
    "--jobs", type=click.IntRange(min=1), default=2, show_default=True, help="Worker processes."
)
@options.with_plugins
@options.with_as_json
def atlas(
    names: tuple[str, ...],
    integrators: tuple[str, ...],
    only_list: bool,
    out: Path,
    fresh: bool,
    jobs: int,
    plugins: tuple[str, ...],
    as_json: bool,
) -> None:
    """Run the failure atlas: experiments that show where methods fail, and what helps.

    Every experiment predicts numbers and measures them. The exit code is 1 if one comes out
    differently. Results are kept in the folder: what has not changed is not measured again.

    \b
    Examples:
      stepbench atlas
      stepbench atlas undamped_index3 start_transient
      stepbench atlas -i "my_method[order=2]" --plugins my_method.py
    """
    import msgspec

    from bench.atlas.experiments import read_experiments
    from bench.atlas.runs import complete
    from bench.atlas.tables import listing, tables
    from bench.commands.terminal import RunProgress, show
    from bench.results.store import Store

    experiments = read_experiments(names)
    if only_list:
        show(listing(experiments))
        return
    registry = Registry(plugins)
    registry.require_files()
    added = [registry.integrator(name).spec for name in integrators]
    with Store(out, create=True, fresh=fresh) as store, RunProgress() as progress:
        found = complete(experiments, added, store, registry, jobs, progress)
    if as_json:
        click.echo(json.dumps(msgspec.to_builtins(found), indent=2))
    else:
        show(tables(found))
        click.echo(f"Page: {view('atlas')(found, out)}")
    differ = [f.name for f in found if not f.as_predicted]
    if differ:
        raise click.ClickException(f"Not as predicted: {', '.join(differ)}.")
