"""The commands of studies beside the suites: `drift`, `realtime`, `stability` and `atlas`.

A job of a worker gives the data of a study, from which a table and a page are made.
"""

from __future__ import annotations

import math

import click

from bench.commands import options
from bench.commands.options import SYSTEMS, Given
from bench.commands.terminal import RunProgress, show
from bench.results.store import Store
from bench.results.studies import LongRun, drift_table, part_table
from bench.running.interrupts import remark
from integrators.resolutions import Steps, check_end
from problems.base.spec import SpecError


@options.command(
    "drift", "problem names count step settings budget out plugins as_json",
    step={"help": "Step size h in s; the scene's nominal one if not given."},
    out="stepbench-drift",
)  # fmt: skip
def drift(o: Given) -> None:
    """Measure what drifts over many constant steps.

    It measures the energy, relative to the motion's largest kinetic energy, conserved momenta, and
    residuals of the constraints and of their rates. The table gives the value furthest from zero
    (negative: lost), the slope of a straight line through all rows, and whether the drift is none,
    linear, bounded or neither. A run that blows up ends there. The report of the folder gets a
    chapter on drift.

    \b
    Examples:
      stepbench drift pendulum rattle energy_momentum generalized_alpha --steps 100000
      stepbench drift pendulum "dopri8[constraints=projected]" dopri8 --step 0.02 --out drift
      stepbench drift oscillator newmark bdf2 --json > drift.json
    """
    scene, _ = o.asked_scene, o.asked_methods  # before there is a folder
    if o.step is not None:
        check_end(scene.interval[0], scene.interval[0] + o.count * Steps(o.step).h)
    from bench.running.constant_steps import drift_job
    from reports.pages.page import write_page
    from reports.pages.studies import drift_page

    results = []
    with Store(o.out, create=True) as store:
        for run in o.measured(drift_job, o.step, o.count):
            store.keep(run)
            results.append(run)
            if run.status != "ok":
                o.faults.append(f"{run.integrator}: {run.status}: {run.message}")
        if results:
            o.answer(results, f"{scene.spec}, h={results[0].h:g} s", drift_table(results))
            page = write_page(drift_page(store.values(LongRun)), o.out)
            click.echo(f"Page: {page}", err=o.as_json)


@options.command(
    "realtime", "problem names settings rate iterations duration budget plugins as_json"
)
def realtime(o: Given) -> None:
    """Run methods with a fixed budget per step, as in real time.

    Each step is 1/RATE long. Newton's method stops after --iterations, converged or not, and the
    run goes on; explicit and linearly implicit methods do not iterate. The tables have the time per
    step, the number of steps that took longer than 1/RATE, and errors and residuals of the run.

    \b
    Examples:
      stepbench realtime slider_crank linearly_implicit_euler generalized_alpha --rate 1000
      stepbench realtime quarter_car bdf2 --rate 500 --iterations 2
      stepbench realtime pendulum half_explicit_euler stormer_verlet --rate 1000 --duration 1 --json
    """
    from bench.running import constant_steps as job

    task = o.rate, job.steps_of(o.asked_scene, o.rate, o.duration), o.iterations
    runs = [run for runs in o.measured(job.realtime_job, *task) for run in runs]
    if runs:
        summary = job.realtime_sentence(runs)
        o.answer({"runs": runs, "summary": summary}, *job.realtime_tables(runs), summary)
    o.faults += [f"{run.name}: {run.status}: {run.message}" for run in runs if run.status != "ok"]


@options.command(
    "stability", "names at pattern zeta system ratios budget out plugins as_json",
    out="stepbench-stability",
)  # fmt: skip
def stability(o: Given) -> None:
    """Analyse stability at constant steps.

    The amplification matrix of each integrator is found by taking its step on a linear system. From
    it come the spectral radius, numerical damping, period error, overshoot, stability limit,
    bifurcation, and the largest ratio of steps that is safe. Writes a page with charts and maps.
    With --pattern, omega h and radius are those of the macro step.

    \b
    Examples:
      stepbench stability "generalized_alpha[rho_inf=0.8]" newmark kvaerno5
      stepbench stability "generalized_alpha[gamma=updated]" --pattern 0.3,0.7 --at 4.47
      stepbench stability my_method --plugins my_method.py
    """
    for value in o.at or ():
        if not 0 < value < math.inf:
            raise SpecError(f"omega h = {value:g} is not allowed; give a positive number.")
    if o.zeta is not None and o.system != SYSTEMS[0]:
        raise SpecError(f"--zeta damps the oscillator; the system {o.system} has no such number.")
    from bench.stability.analysis import analysis_job
    from bench.stability.tables import stability_tables
    from reports.pages.stability import write_stability_page

    task = o.system, o.zeta, o.pattern or (1.0,), o.at or (), o.ratios
    results = [*o.measured(analysis_job, *task)]
    if not results:
        return
    facts, *tables = stability_tables(results)
    lines = []
    for name, *cells in facts.rows:  # of many columns, which a terminal has no room for
        lines.append(f"{name}, {results[0]['system']}")
        lines += (f"  {head}: {cell}" for head, cell in zip(facts.head[1:], cells, strict=True))
    o.answer(results, *lines, *tables)
    if not o.as_json:
        click.echo(f"Page: {write_stability_page(results, o.out)}")


@options.command(
    "atlas", "experiments integrators out fresh jobs budget plugins as_json",
    integrators={"help": "Put this integrator through every experiment, too; repeatable."},
    out="stepbench-atlas", budget=60.0,
)  # fmt: skip
def atlas(o: Given) -> None:
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
    from reports.pages.page import write_page
    from reports.pages.studies import atlas_page

    experiments = read_experiments(o.experiments)
    registry = o.registry  # before there is a folder
    added = [registry.integrator(name).spec for name in o.integrators]
    with Store(o.out, create=True, fresh=o.fresh) as store, RunProgress() as progress:
        remark("Finished experiments are stored; the same command goes on.")
        task = experiments, added, store, registry, o.jobs, progress, o.budget
        results = complete_experiments(*task)
    if o.as_json:
        o.answer(results)
    else:
        for r in results:
            show(f"{r.number}. {r.title}: {r.verdict}", *map(part_table, r.parts))
        click.echo(f"Page: {write_page(atlas_page(results), o.out)}")
    differ = [f"{result.name} ({result.verdict})" for result in results if not result.as_predicted]
    if differ:
        raise click.ClickException(f"Not all is as predicted: {', '.join(differ)}.")
