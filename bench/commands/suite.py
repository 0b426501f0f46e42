"""The command for whole suites: `stepbench run`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from bench.commands import options
from bench.commands.options import Given
from bench.results.records import INTERRUPTED, Record, counted, endings
from bench.results.store import Store
from bench.results.studies import ExperimentResult
from bench.running.interrupts import remark
from bench.running.inventory import Inventory
from bench.running.plan import Suite, make_suite
from bench.running.profiles import read_profile
from problems.base.spec import SpecError


@dataclass(frozen=True)
class Outcome:
    """Outcome of a suite: the records of its cells, how many of them were measured now, the
    experiments of the failure atlas, and sentences on plugins that were lost."""

    records: list[Record]
    measured: int
    experiments: list[ExperimentResult]
    lost: tuple[str, ...]

    @property
    def interrupted(self) -> int:
        """Number of cells that something ended from outside."""
        return sum(record.status == INTERRUPTED for record in self.records)

    @property
    def sentences(self) -> list[str]:
        """Sentences that count what was run."""
        again = ", which the same command runs again" if self.interrupted else ""
        count, kept = len(self.records), len(self.records) - self.measured
        said = [
            f"{counted(count, 'cell')}: {endings(self.records)}{again}; "
            f"{self.measured} measured now, {kept} kept from before."
        ]
        if self.experiments:
            held = sum(result.as_predicted for result in self.experiments)
            many = len(self.experiments)
            said.append(f"{many} experiments of the failure atlas: {held} as predicted.")
        return said


def run_suite(
    suite: Suite,
    registry: Inventory,
    out: Path,
    fresh: bool = False,
    jobs: int = 2,
    cluster: str | None = None,
) -> Outcome:
    """Measure what a folder lacks of a suite, with a progress bar, and store it."""
    from bench.atlas.experiments import read_experiments
    from bench.atlas.runs import complete_experiments
    from bench.commands.terminal import RunProgress
    from bench.running.session import measure_suite, runner_for, time_suite

    chosen = suite.atlas if isinstance(suite.atlas, list) else []
    experiments = read_experiments(chosen) if suite.atlas else []
    added = [suite.plan.mine] if suite.plan.mine else []
    with (
        RunProgress() as progress,
        runner_for(suite, jobs, progress, cluster) as runner,  # a cluster answers before it counts
        Store(out, create=True, fresh=fresh) as store,
    ):
        remark("Finished runs are stored; the same command goes on.")
        for sentence in suite.lost:
            progress.note(sentence)
        measured = measure_suite(suite, store, registry, runner)
        time_suite(suite, store, registry, runner)
        runner.end_workers()
        stored = store.records()
        limits = suite.plan.budget_s, suite.memory_gib
        results = complete_experiments(experiments, added, store, registry, jobs, progress, *limits)
    records = [stored[key] for key in suite.cells if key in stored]
    return Outcome(records, measured, results, suite.lost)


def write_reports(folder: Path, single_file: bool = False) -> None:
    """Write the pages of the results in a folder, in HTML (perhaps as one file) and in Markdown.

    Raises
    ------
    click.ClickException
        If the disk does not take them.
    """
    from reports.pages.html_report import write_html_report
    from reports.pages.markdown_report import write_markdown_report

    try:
        page = write_html_report(folder, single_file)
        paper = write_markdown_report(folder)
        click.echo(f"Report: {page}; {paper.name} beside it is the same in Markdown.")
    except OSError as error:
        raise click.ClickException(
            f"The report could not be written: {error.strerror}. The results are stored."
        ) from None


@options.command(
    "run",
    options.argument("suite", default="quick"),
    options.SCENES,
    options.integrators("Only this integrator; repeatable. One that the suite lacks is added."),
    options.option(
        "--mine", "Your integrator: it is run beside the others, and the report opens with it "
        "highlighted.", metavar="INTEGRATOR"
    ),
    *options.SET,
    options.folder("Folder of the results.", options.RESULTS),
    options.FRESH,
    options.jobs("Worker processes; timing is done by one at a time."),
    options.cluster(
        "Measure on the workers of a dask scheduler, such as tcp://host:8786; timing stays here."
    ),
    options.budget(
        "Processor time of a run in s, after which it is stopped; the suite's if not given. Runs "
        "that a smaller budget stopped are run again.",
        None,
    ),
    options.PLUGINS,
)  # fmt: skip
def run_(o: Given) -> None:
    """Run a suite and write its report.

    SUITE is a TOML file or the name of a built-in suite, as `stepbench list suites` has them. A run
    that was stopped goes on where it stopped when the same command is given again. While it goes,
    `stepbench report` in another terminal makes pages of what there is.

    \b
    Examples:
      stepbench run
      stepbench run paper --out paper-results
      stepbench run -p pendulum -i ida -i "generalized_alpha[rho_inf=0.6]"
      stepbench run --mine my_method --plugins my_method.py
      stepbench run full --cluster tcp://head:8786
    """
    registry = Inventory(o.plugins)  # a file that cannot be used costs its own cells
    if o.settings and not o.problems:
        raise SpecError("--set and --keyframe belong to scenes; name them with -p.")
    scenes = [registry.problem(p, **o.settings).spec if o.settings else p for p in o.problems]
    suite = make_suite(*read_profile(o.suite), registry, scenes, o.integrators, o.budget, o.mine)
    if not options.is_given("suite"):
        click.echo(
            f"The suite quick: {len(suite.cells)} runs, which take about a minute; results go to "
            f"{o.out}. Other suites: stepbench list suites",
            err=True,
        )
    outcome = run_suite(suite, registry, o.out, o.fresh, o.jobs, o.cluster)
    from bench.commands.terminal import say
    from reports.questions.method_card import method_card

    answer, *others = method_card(o.out, "")
    for line in method_card(o.out, suite.plan.mine) if suite.plan.mine else [answer]:
        say(line)
    write_reports(o.out)
    say(f"Next: stepbench report {o.out} --open shows it; stepbench run --mine METHOD adds yours.")
    for line in (*[answer] * bool(suite.plan.mine), *others, *outcome.sentences):
        say(line)
    if not any(record.status == "ok" for record in outcome.records):
        raise click.ClickException(f"No cell succeeded. {in_common(outcome.records)}")
    if cut := outcome.interrupted:
        raise click.ClickException(
            f"Not complete: {counted(cut, 'run')} interrupted; the same command runs what is "
            "missing."
        )
    if outcome.lost:
        raise click.ClickException(outcome.lost[0])  # the others stand above


def in_common(records: Sequence[Record]) -> str:
    """Return a sentence on what failed cells have in common: their most frequent reason."""
    reasons = Counter(f"{record.status}: {record.message}" for record in records)
    ((reason, count),) = reasons.most_common(1)
    share = "All end with" if count == len(records) else f"{count} of {len(records)} end with"
    return f"{share} {reason}"
