"""The commands that measure many runs into a folder: `run`, `order` and `recommend`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import click

from bench.commands import options
from bench.commands.options import BUDGET_S, RESULTS, Given
from bench.commands.terminal import RunProgress, show
from bench.plugins.registry import SUFFIXES
from bench.results.records import INTERRUPTED, Record, counted, endings
from bench.results.store import Store
from bench.running.interrupts import remark
from bench.running.inventory import Inventory, SceneFacts
from bench.running.plan import ProfileFile, StudyFile, Suite, make_suite, read_profile
from bench.running.process import Limits
from bench.running.recommend import Recommendation
from bench.running.runner import Runner
from bench.running.session import measure_suite, time_suite
from problems.base.cache import put
from problems.base.spec import SpecError
from problems.base.text import said

#: File of a recommendation in its folder.
FILE = "recommendation.json"


def run_suite(
    suite: Suite, registry: Inventory, out: Path, fresh: bool, jobs: int
) -> tuple[list[Record], list[str]]:
    """Measure what a folder lacks of a suite, with a progress bar, and store it; return the records
    of its cells, and sentences that count what was run."""
    from bench.atlas.experiments import read_experiments
    from bench.atlas.runs import complete_experiments

    chosen = suite.atlas if isinstance(suite.atlas, list) else []
    experiments = read_experiments(chosen) if suite.atlas else []
    added = [suite.plan.mine] if suite.plan.mine else []
    limits = suite.plan.budget_s, suite.memory_gib
    with (
        RunProgress() as progress,
        Runner(jobs, Limits(*limits), progress) as runner,
        Store(out, create=True, fresh=fresh) as store,
    ):
        remark("Finished runs are stored; the same command goes on.")
        for sentence in suite.lost:
            progress.note(sentence)
        measured = measure_suite(suite, store, runner)
        time_suite(suite, store, runner)
        runner.end_workers()
        stored = store.records()
        results = complete_experiments(experiments, added, store, registry, jobs, progress, *limits)
    records = [stored[key] for key in suite.cells if key in stored]
    cut = any(record.status == INTERRUPTED for record in records)
    again = ", which the same command runs again" if cut else ""
    told = [
        f"{counted(len(records), 'run')}: {endings(records)}{again}; {measured} measured now, "
        f"{len(records) - measured} kept from before."
    ]
    if results:
        held = sum(result.as_predicted for result in results)
        told += [f"{len(results)} experiments of the failure atlas: {held} as predicted."]
    return records, told


def write_reports(folder: Path, single_file: bool = False) -> None:
    """Write the pages of the results in a folder, in HTML (perhaps as one file) and in Markdown;
    raise ClickException if the disk does not take them, or a library cannot be loaded."""
    try:
        from reports.pages.html_report import write_html_report
        from reports.pages.markdown_report import write_markdown_report

        page = write_html_report(folder, single_file)
        paper = write_markdown_report(folder)
        click.echo(f"Report: {page}; {paper.name} beside it is the same in Markdown.")
    except (OSError, ImportError, MemoryError) as error:
        reason = getattr(error, "strerror", None) or said(error)
        raise click.ClickException(
            f"The report could not be written: {reason}. The results are stored."
        ) from None


# ---- suites ------------------------------------------------------------------------------
@options.command(
    "run",
    "suite problems integrators mine settings out fresh jobs budget plugins",
    budget={"help": "Processor time of a run in s, after which it is stopped; the suite's if not "
            "given. Runs that a smaller budget stopped are run again.", "default": None},
    out=RESULTS,
)  # fmt: skip
def run_(o: Given) -> None:
    """Run a suite and write its report.

    SUITE is a TOML file or the name of a built-in suite, as `stepbench list suites` has them. A run
    that was stopped goes on where it stopped when the same command is given again. While it goes,
    `stepbench report` in another terminal makes pages of what there is.

    \b
    Examples:
      stepbench run paper --out paper-results
      stepbench run -p pendulum -i ida -i "generalized_alpha[rho_inf=0.6]"
      stepbench run --mine my_method --plugins my_method.py
    """
    if not o.problems:
        options.refuse("belongs to scenes; name them with -p.", "settings")
    registry = Inventory(o.plugins)  # a file that cannot be used costs its own cells
    scenes = [registry.problem(p, **o.settings).spec if o.settings else p for p in o.problems]
    profile = read_profile("quick" if o.suite is None else o.suite)
    suite = make_suite(*profile, registry, scenes, o.integrators, o.budget, o.mine)
    if o.suite is None:
        click.echo(
            f"The suite quick: {len(suite.cells)} runs, which take about a minute; results go to "
            f"{o.out}. Other suites: stepbench list suites",
            err=True,
        )
    records, told = run_suite(suite, registry, o.out, o.fresh, o.jobs)
    from reports.verdicts import method_card

    answer, *others = method_card(o.out, "")
    for line in method_card(o.out, suite.plan.mine) if suite.plan.mine else [answer]:
        click.echo(line)
    mine = "" if suite.plan.mine else "; stepbench run --mine METHOD puts yours beside these"
    try:
        write_reports(o.out)
        click.echo(f"Next: stepbench report {o.out} --open shows it{mine}.")
    finally:
        for line in (*[answer] * bool(suite.plan.mine), *others, *told):
            click.echo(line)
    statuses = [record.status for record in records]
    if "ok" not in statuses:
        raise click.ClickException(f"No run succeeded. {in_common(records)}")
    if cut := statuses.count(INTERRUPTED):
        raise click.ClickException(
            f"Not complete: {counted(cut, 'run')} interrupted; the same command runs what is "
            "missing."
        )
    if suite.lost:
        raise click.ClickException(suite.lost[0])  # the others stand above


def in_common(records: Sequence[Record]) -> str:
    """Return a sentence on what failed cells have in common: their most frequent reason."""
    reasons = Counter(f"{record.status}: {record.message}" for record in records)
    ((reason, count),) = reasons.most_common(1)
    share = "All end with" if count == len(records) else f"{count} of {len(records)} end with"
    return f"{share} {reason}"


# ---- orders ------------------------------------------------------------------------------
@options.command(
    "order", "problem names steps pattern t_end settings budget plugins out fresh jobs",
    out="stepbench-orders",
)  # fmt: skip
def order_(o: Given) -> None:
    """Measure the order of integrators at constant steps.

    The table has for each group of variables the order that is claimed, the one after the start
    transient, and the one from the first step; the report has errors over steps. `stepbench run
    orders` measures every native method that takes constant steps.

    \b
    Examples:
      stepbench order pendulum "generalized_alpha[rho_inf=0.9]" --steps 0.01,0.005,0.0025,0.00125
      stepbench order spring_mass "generalized_alpha[gamma=updated]" --pattern 0.3,0.7 --t-end 5
      stepbench order pendulum newmark bdf2 "bdf2[formulation=index2]"
    """
    asked = o.names, o.budget, o.steps, o.pattern, o.t_end
    suite = suite_of_orders(o.registry, o.asked_scene, *asked)
    records, told = run_suite(suite, o.registry, o.out, o.fresh, o.jobs)
    from reports.scenes import StoredRuns
    from reports.tables.order_table import order_tables

    with Store(o.out) as store:
        tables = order_tables(StoredRuns.of(store))
    if not tables:
        raise click.ClickException(f"No order was measured. {in_common(records)}")
    show(*tables, *told)
    write_reports(o.out)


def suite_of_orders(
    registry: Inventory,
    scene: SceneFacts,
    integrators: Sequence[str],
    budget: float = BUDGET_S,
    steps: Sequence[float] | None = None,
    pattern: Sequence[float] | None = None,
    t_end: float | None = None,
) -> Suite:
    """Return the runs of methods on a scene to which their orders are fitted; raise SpecError if a
    method chooses its own steps, or steps or the end time are not allowed."""
    for method in map(registry.integrator, integrators):
        if method.controls != "step":
            raise SpecError(
                f"{method.spec} chooses its own steps, over which no order can be measured; name "
                "methods of constant steps, for some with the option steps=constant."
            )
    if steps and len(steps) < 3:
        raise SpecError(f"An order needs at least three step sizes; {len(steps)} came.")
    study = StudyFile(
        problems=[scene.spec],
        integrators=list(integrators),
        t_end=t_end,
        steps=list(steps) if steps else None,  # halvings of the scene's own
        pattern=tuple(pattern or (1.0,)),
        figures=("orders", "convergence"),
    )
    profile = ProfileFile(study=[study], samples=0, budget_s=budget)
    return make_suite("orders", profile, registry, [scene.spec])


# ---- recommendations ---------------------------------------------------------------------
@options.command(
    "recommend",
    "subject methods errors rule ranked_by budget t_end settings out fresh jobs plugins as_json",
    budget={"help": "Time in s for all runs together; where integrators are named, processor time "
            "after which a run is stopped.", "default": 60.0},
    out="stepbench-recommendation",
)  # fmt: skip
def recommend_(o: Given) -> None:
    """Find the integrator, and its step or tolerance, that reaches an accuracy at the least cost.

    Without INTEGRATOR all methods that can solve the scene are tried, the best also with constant
    steps and another Newton's method. FILE is a Python file with one scene, or a model of MuJoCo or
    URDF. The same command continues a search; a larger --budget tries more.

    With INTEGRATOR, the largest step or tolerance that meets every error is found for each one, by
    bisection. The rule iftomm is that of the IFToMM benchmark library; on a scene without named
    points it limits the change of energy.

    \b
    Examples:
      stepbench recommend slider_crank --error a:1e-3
      stepbench recommend my_scene.py --error q:1e-4 --cost operations
      stepbench recommend robot.xml --set contacts=left_out --budget 20
      stepbench recommend pendulum generalized_alpha ida --error a:1e-3
      stepbench recommend iftomm_pendulum rattle ida --rule iftomm
    """
    name = o.subject
    if name.endswith((".py", *SUFFIXES)):
        o.plugins = [*o.plugins, name]
        file = str(Path(name).absolute())
        names = [scene for scene, plugin in o.registry.problems.items() if file in plugin.sources]
        if len(names) != 1:
            there = f"the scenes {', '.join(names)}" if names else "no scene"
            raise SpecError(
                f"{name} has {there}; name one scene, and give the file with --plugins."
            )
        (name,) = names
    asked = {"errors": o.errors, "rule": o.rule, "cost": o.ranked_by, "budget": o.budget}
    scene = o.registry.problem(name, **o.settings)
    found = Recommendation(o.registry, scene, o.methods, **asked, t_end=o.t_end)
    for sentence in found.remarks:
        click.echo(sentence, err=True)
    with RunProgress(lines=False) as progress:
        try:
            found.search(o.out, progress, o.jobs, o.fresh)
        finally:  # what was found before an error is not lost by it
            if found.runs:
                put(o.out / FILE, options.json_text(found.plain))
                shown = []
                for race in found.races:
                    program = [race.program] if race.order else []
                    shown += [race.table(), *race.sentences(), *program]
                o.answer(found.plain, *shown)
    if not o.as_json:
        write_reports(o.out)
    if not any(race.order for race in found.races):
        raise click.ClickException(f"No integrator reaches {found.about} on {scene.spec}.")
