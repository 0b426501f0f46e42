"""The commands of studies beside the suites: `drift`, `realtime`, `stability` and `atlas`.

A job of a worker gives the data of a study, from which a table and a page are made.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import click
import msgspec

from bench.commands import completion, options
from bench.commands.pages import view
from bench.guard.interrupts import remark
from bench.plugins.facts import MethodFacts
from bench.running.inventory import Inventory
from integrators.resolutions import Steps, check_end
from problems.spec import SpecError

#: Most steps of a long run that can be asked for.
_MOST_STEPS = 10**9
#: Largest limit of iterations that can be asked for.
_MOST_ITERATIONS = 1000
_SYSTEMS = ("oscillator", "relaxation", "loop", "coupled", "joined")
with_names = click.argument(
    "names", nargs=-1, required=True, metavar="INTEGRATOR...", shell_complete=completion.integrators
)


def of_each(
    methods: Sequence[MethodFacts], one: Callable[[MethodFacts], Any]
) -> tuple[list[Any], list[str]]:
    """Call a function for each integrator; return what it gave, and what failed."""
    results, faults = [], []
    for method in methods:
        try:
            results.append(one(method))
        except SpecError as error:
            faults.append(str(error))
    return results, faults


def once_each(registry: Inventory, names: Sequence[str]) -> list[MethodFacts]:
    """Return the facts of integrators; raise SpecError if one is named twice."""
    methods = [registry.integrator(name) for name in names]
    for k, method in enumerate(methods):
        if method in methods[:k]:
            raise SpecError(f"{method.spec} is named twice.")
    return methods


def _fail(faults: Sequence[str]) -> None:
    """Tell what failed, each once, and end with exit code 1."""
    if faults:
        raise click.ClickException(" ".join(dict.fromkeys(faults)))


def print_json(value: Any) -> None:
    click.echo(json.dumps(msgspec.to_builtins(value), indent=2, allow_nan=False))


# ---- long runs ---------------------------------------------------------------------------
@click.command()
@click.argument("problem", shell_complete=completion.scenes)
@with_names
@click.option(
    "--steps",
    type=click.IntRange(2, _MOST_STEPS),
    default=100_000,
    show_default=True,
    help="Number of steps.",
)
@click.option("--step", type=float, help="Step size h in s; the scene's nominal one if not given.")
@options.with_set
@options.with_budget
@options.with_folder("stepbench-drift", "Folder of the long runs and their page.")
@options.with_plugins
@options.with_as_json
def drift(
    problem: str,
    names: tuple[str, ...],
    steps: int,
    step: float | None,
    settings: dict[str, str],
    budget: float,
    out: Path,
    plugins: tuple[str, ...],
    as_json: bool,
) -> None:
    """Measure what drifts over many constant steps.

    It measures: the energy, relative to the motion's largest kinetic energy; conserved momenta;
    residuals of the constraints and of their rates; and the phase (the time by which a run is
    ahead), where a conservative motion has a closed form. The table gives the value of each
    furthest from zero (negative: lost, behind), the slope of a straight line through all rows, and
    whether the drift is none, linear, bounded or neither. A run that blows up ends there, and says
    when. The folder keeps long runs beside other results, whose report has a chapter on them.

    \b
    Examples:
      stepbench drift pendulum rattle energy_momentum generalized_alpha --steps 100000
      stepbench drift pendulum "dopri8[constraints=projected]" dopri8 --step 0.02 --out drift
      stepbench drift oscillator newmark bdf2 --json > drift.json
    """
    registry = options.usable_registry(plugins)
    scene, methods = registry.problem(problem, **settings), once_each(registry, names)
    if step is not None:
        check_end(scene.interval[0], scene.interval[0] + steps * Steps(step).h)

    from bench.commands.terminal import show
    from bench.results.drift import LongRun, drift_table
    from bench.results.store import Store
    from bench.running.drift import drift_job

    with Store(out, create=True) as store:

        def kept(method: MethodFacts) -> LongRun:
            sources, task = scene.sources | method.sources, (scene.spec, method.spec, step, steps)
            found = options.guarded(method.spec, drift_job, sources, budget, *task)
            store.keep(found)
            return found

        results, faults = of_each(methods, kept)
        if results and as_json:
            print_json(results)
        elif results:
            show(f"{scene.spec}, h={results[0].h:g} s", drift_table(results))
        if results:
            click.echo(f"Page: {view('drift')(store.long_runs(), out)}", err=as_json)
            if store.plan():
                said = "The report of this folder has it as a chapter after `stepbench report`."
                click.echo(said, err=as_json)
    faults += [f"{r.integrator}: {r.status}: {r.message}" for r in results if r.status != "ok"]
    _fail(faults)


# ---- runs at a fixed rate ----------------------------------------------------------------
def _rate(context: click.Context, parameter: click.Parameter, text: str) -> float:
    """Read "1kHz", "500Hz" or "1000" as a number of Hz."""
    match = re.fullmatch(r"([+\d.e-]+) ?(?:(k?)hz)?", text, re.IGNORECASE)
    with suppress(ValueError):
        rate = float(match[1]) * (1000.0 if match[2] else 1.0) if match else 0.0
        if 0 < rate < math.inf:
            return rate
    raise click.BadParameter(
        f"{text!r} is no rate; give a positive one such as 1kHz, 500Hz or 1000."
    )


@click.command()
@click.argument("problem", metavar="SCENE", shell_complete=completion.scenes)
@with_names
@options.with_set
@click.option(
    "--rate", required=True, callback=_rate, help="Steps per second: 1kHz, 500Hz or 1000."
)
@click.option(
    "--iterations",
    type=click.IntRange(1, _MOST_ITERATIONS),
    help="Most iterations in each call of Newton's method; 1 and unlimited side by side if not "
    "given.",
)
@click.option(
    "--duration", type=float, help="Length of the run in s; the scene's interval if not given."
)
@options.with_budget
@options.with_plugins
@options.with_as_json
def realtime(
    problem: str,
    names: tuple[str, ...],
    settings: dict[str, str],
    rate: float,
    iterations: int | None,
    duration: float | None,
    budget: float,
    plugins: tuple[str, ...],
    as_json: bool,
) -> None:
    """Run methods with a fixed budget per step, as in real time.

    Each step of 1/RATE takes at most so many iterations of Newton's method and goes on, converged
    or not; explicit and linearly implicit methods have none. The host calls one compiled step for
    each tick. The tables have the time per step, the steps that took longer than 1/RATE, and errors
    and residuals of the same run.

    \b
    Examples:
      stepbench realtime slider_crank linearly_implicit_euler generalized_alpha --rate 1kHz
      stepbench realtime quarter_car bdf2 --rate 500Hz --iterations 2
      stepbench realtime pendulum half_explicit_euler stormer_verlet --rate 1000 --duration 1 --json
    """
    registry = options.usable_registry(plugins)
    scene, methods = registry.problem(problem, **settings), once_each(registry, names)
    length = scene.interval[1] - scene.interval[0]
    duration = length if duration is None else duration
    from bench.commands.terminal import show
    from bench.results.realtime import MOST_STEPS, realtime_sentence, realtime_tables
    from bench.running.realtime import realtime_job

    if not 0 < duration <= length * (1 + 1e-9):
        raise SpecError(
            f"The duration {duration:g} s is not allowed; give a positive one of at most "
            f"{length:g} s, the interval of {scene.spec}, where the reference is known."
        )
    steps = math.floor(min(duration * rate * (1 + 1e-9), 2.0 * MOST_STEPS))
    if not 2 <= steps <= MOST_STEPS:
        raise SpecError(
            f"{rate:g} Hz over {duration:g} s is not allowed; give a rate and a duration that make "
            f"from 2 to {MOST_STEPS} steps."
        )

    def measured(method: MethodFacts) -> Any:
        sources, task = scene.sources | method.sources, (scene.spec, method.spec, rate, steps)
        return options.guarded(method.spec, realtime_job, sources, budget, *task, iterations)

    answers, faults = of_each(methods, measured)
    runs = [run for answer in answers for run in answer]
    if runs and as_json:
        print_json({"runs": runs, "summary": realtime_sentence(runs)})
    elif runs:
        show(*realtime_tables(runs), realtime_sentence(runs))
    faults += [f"{run.name}: {run.status}: {run.message}" for run in runs if run.status != "ok"]
    _fail(faults)


# ---- stability ---------------------------------------------------------------------------
@click.command()
@with_names
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
    "--ratios/--no-ratios",
    default=True,
    help="Seek the largest safe ratio of two steps in turns, which takes seconds.",
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
    ratios: bool,
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
    from bench.commands.terminal import show
    from bench.stability.analysis import analysis_job
    from bench.stability.tables import stability_tables

    def analysed(method: MethodFacts) -> dict[str, Any]:
        task = method.spec, system, zeta, pattern or (1.0,), at or (), ratios
        return options.guarded(method.spec, analysis_job, method.sources, budget, *task)

    results, faults = of_each(once_each(registry, names), analysed)
    if results and as_json:
        print_json(results)
    elif results:
        facts, *tables = stability_tables(results)
        for name, *cells in facts.rows:  # of many columns, which a terminal has no room for
            lines = (f"  {head}: {cell}" for head, cell in zip(facts.head[1:], cells, strict=True))
            show(f"{name}, {results[0]['system']}", *lines)
        show(*tables)
        click.echo(f"Page: {view('stability')(results, out)}")
    _fail(faults)


# ---- the failure atlas -------------------------------------------------------------------
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
    from bench.atlas.experiments import read_experiments
    from bench.atlas.runs import complete_experiments
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
        results = complete_experiments(
            experiments, added, store, registry, jobs, progress, budget or 60.0
        )
    if as_json:
        print_json(results)
    else:
        for result in results:
            show(
                f"{result.number}. {result.title}: {result.verdict}", *map(part_table, result.parts)
            )
        click.echo(f"Page: {view('atlas')(results, out)}")
    differ = [f"{result.name} ({result.verdict})" for result in results if not result.as_predicted]
    if differ:
        raise click.ClickException(f"Not all is as predicted: {', '.join(differ)}.")
