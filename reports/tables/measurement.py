"""Sentences about the measurement: its state, missing data, repeatability of times, method."""

from __future__ import annotations

from bench.results.orders import SPREAD
from bench.results.quantities import COST, COSTS
from bench.results.records import Plan, counted
from bench.results.timings import FEWEST, LEAST_OF_FEW, LEAST_QUOTIENT, REPEATABLE, Repeatability
from reports.formatting import number
from reports.ranking import LUCK
from reports.scenes import NO_PLAN, StoredRuns


def missing_data(stored: StoredRuns) -> list[str]:
    """Sentences about missing plans, runs, scenes, errors and times."""
    plan, records, planned = stored.plan, stored.records, stored.planned
    waiting = len(planned - set(records))
    ok = [r for r in records.values() if r.status == "ok"]
    untimed = sum(not r.run_s for r in ok)
    not_finite = any(e is None for r in ok for norms in r.errors.values() for e in norms.values())
    sentences = {
        "The store holds no plan: all runs of a scene are shown together.": plan is NO_PLAN,
        f"{waiting} of {len(planned)} planned runs are not measured yet. If the run is in work, "
        "load this page again later; if it was stopped, the same command goes on.": waiting,
        "The store holds no finished run.": not records,
        **{
            f"The scene {problem} (t_end={number(t_end)} s) has no description, picture and "
            "reference curve.": title not in stored.scenes
            for (problem, t_end), title in stored.titles.items()
        },
        "No run reached the end: there are no errors, orders and times.": records and not ok,
        f"Without timing samples: {untimed} of {len(ok)} runs that reached the end.": untimed,
        "Some errors of runs that reached the end are not finite; they are not drawn.": not_finite,
    }
    return [sentence for sentence, holds in sentences.items() if holds]


def times_sentence(times: Repeatability) -> str:
    """The cost by which integrators are ranked first, and the reason."""
    first = f"so this report asks for {times.cost} first"
    if times.width is None:
        return f"No run has the {FEWEST} timing samples that an interval takes, {first}."
    if times.machines > 1:
        of = f"{times.machines} different machines, clocks or versions"
        return f"Times were taken on {of} and cannot be compared, {first}."
    of = f"median of {counted(times.runs, 'run')}"
    limit = f"{'less' if times.cost == 'seconds' else 'more'} than {100 * REPEATABLE:g} %"
    return f"Repeated times scatter by {100 * times.width:.2g} % ({of}), {limit}, {first}."


def method_of_measurement(plan: Plan) -> list[str]:
    """Sentences about times, costs, errors and orders."""
    samples = f"{plan.samples} samples were asked for per run"
    samples = samples if plan is not NO_PLAN else "Samples per run vary"
    return [
        "Timed is the bare solve from start to end, in processor seconds of all threads; tracing, "
        "compiling and consistent initial values are done before. A sample repeats the run for "
        "hundredths of a second and takes the least: another process makes a run longer, never "
        f"shorter. {samples}, fewer of runs that last long, in rounds over all runs; shown is the "
        "median of a run's samples.",
        "Two runs differ in time if the 95 % interval of the median of their quotients within "
        f"rounds lies on one side of 1 and the median is beyond {LEAST_QUOTIENT:g}; with fewer "
        f"than {FEWEST} common rounds the median must be beyond {LEAST_OF_FEW:g}.",
        f"Operations count as different beyond a factor of {COSTS[COST].tie:g}: the cost model is "
        "no more exact. Other counts tie where they are equal. A method that is among the "
        f"cheapest from a later start of the motion ties, too, at {LUCK:g} times the cost at most; "
        "beside it, a run that was not started later has its own error.",
        "A run ends as 'budget exceeded' at the suite's processor time, or at the limit of its own "
        "method, in calls (max_calls: IDA, CVODE, SciPy) or in steps (max_steps: others), which "
        "are not equal work. Finer runs of a method may end there before others do.",
        "Errors are relative, per group of variables and per norm. Orders are fitted to the "
        f"finest steps, as many as have slopes within {SPREAD:g} of each other, three at least.",
    ]
