"""The commands for whole suites: `stepbench run` and `stepbench report`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import click

from bench.commands import options
from bench.commands.pages import write_reports
from bench.commands.paths import ClusterAddress
from bench.guard.interrupts import remark
from bench.results.records import INTERRUPTED, Record
from bench.results.store import Store
from bench.running.inventory import Inventory
from bench.running.plan import make_suite
from bench.running.profiles import read_profile


@click.command()
@click.argument("profile", default="quick")
@click.option("-p", "--problem", "problems", multiple=True, help="Only this scene; repeatable.")
@options.with_integrators(
    "Only this integrator; repeatable. One that the profile lacks is added.",
)
@options.with_folder(options.RESULTS, "Folder of the results.")
@options.with_fresh
@options.with_jobs("Worker processes; timing is done by one at a time.")
@click.option(
    "--cluster",
    type=ClusterAddress(),
    metavar="ADDRESS",
    help="Measure on the workers of a dask scheduler, such as tcp://host:8786; timing stays here.",
)
@options.with_given_budget(
    "Processor time of a run in s, after which it is stopped; the profile's if not given. Runs "
    "that a smaller budget stopped are run again.",
)
@options.with_plugins
def run(
    profile: str,
    problems: tuple[str, ...],
    integrators: tuple[str, ...],
    out: Path,
    fresh: bool,
    jobs: int,
    cluster: str | None,
    budget: float | None,
    plugins: tuple[str, ...],
) -> None:
    """Run a suite and write its report.

    PROFILE is the name of a built-in profile (quick, paper) or a TOML file. A run that was
    stopped goes on where it stopped when the same command is given again.

    \b
    Examples:
      stepbench run
      stepbench run paper --out paper-results
      stepbench run -p pendulum -i ida -i "generalized_alpha[rho_inf=0.6]"
      stepbench run full --cluster tcp://head:8786
    """
    from bench.atlas.experiments import read_experiments
    from bench.atlas.runs import complete
    from bench.commands.terminal import RunProgress
    from bench.running.session import measure_suite, runner_for, time_suite
    from bench.stability import damping

    registry = Inventory(plugins)  # a file that cannot be used costs its own cells
    suite = make_suite(*read_profile(profile), registry, problems, integrators, budget)
    chosen = suite.atlas if isinstance(suite.atlas, list) else []
    experiments = read_experiments(chosen) if suite.atlas else []
    with (
        RunProgress() as progress,
        runner_for(suite, jobs, progress, cluster) as runner,  # a cluster answers before it counts
        Store(out, create=True, fresh=fresh) as store,
    ):
        remark("Finished runs are stored; the same command goes on.")
        options.tell_set_aside(store, "What the suite needs of them is measured anew.")
        for sentence in suite.lost:
            progress.note(sentence)
        measured = measure_suite(suite, store, registry, runner, progress)
        damping.complete(suite, store, registry, runner, progress)
        time_suite(suite, store, registry, runner, progress)
        runner.end_workers()
        stored = store.records()
        results = complete(experiments, [], store, registry, jobs, progress)
    records = [stored[key] for key in suite.cells if key in stored]
    good = sum(record.status == "ok" for record in records)
    cut = sum(record.status == INTERRUPTED for record in records)
    interrupted = f"{cut} interrupted, which the same command runs again; " if cut else ""
    click.echo(
        f"{len(records)} cells: {good} ok, {len(records) - good - cut} failed with a reason; "
        f"{interrupted}{measured} measured now, {len(records) - measured} kept from before."
    )
    if results:
        held = sum(result.as_predicted for result in results)
        click.echo(f"{len(results)} experiments of the failure atlas: {held} as predicted.")
    write_reports(out)
    if not good:
        raise click.ClickException(f"No cell succeeded. {in_common(records)}")
    if cut:
        count = "1 cell was" if cut == 1 else f"{cut} cells were"
        raise click.ClickException(
            f"Not complete: {count} interrupted; the same command runs what is missing."
        )
    if suite.lost:
        first, *others = suite.lost
        more = f" {len(others)} more reasons are above." if others else ""
        raise click.ClickException(f"{first}{more}")


def in_common(records: Sequence[Record]) -> str:
    """Return a sentence on what failed cells have in common: their most frequent reason."""
    reasons = Counter(f"{record.status}: {record.message}" for record in records)
    ((reason, count),) = reasons.most_common(1)
    share = "All end with" if count == len(records) else f"{count} of {len(records)} end with"
    return f"{share} {reason}"


@click.command()
@options.with_results
@click.option("--single-file", is_flag=True, help="One HTML file that holds all pages, to mail.")
def report(folder: Path, single_file: bool) -> None:
    """Make the report pages anew from the results in FOLDER.

    \b
    Examples:
      stepbench report
      stepbench report before --single-file
    """
    with Store(folder) as store:  # says clearly if there is none
        options.tell_set_aside(store)
    write_reports(folder, single_file)
