"""Sentences about the measurement: its state, missing data, noise of the machine, method."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from bench.results.orders import SPREAD
from bench.results.quantities import COST, COSTS
from bench.results.records import TIMING_SECONDS, Environment, Plan, Record, SceneRecord, endings
from bench.results.timings import FEWEST, LEAST_OF_FEW, LEAST_QUOTIENT
from reports.formatting import number
from reports.series import timing_spread

#: Timing samples that spread further than this, relative to their median, are noisy.
NOISY = 0.5
#: A machine is called noisy from this part of noisy runs on.
NOISY_PART = 0.25


def state_sentence(plan: Plan | None, records: Sequence[Record]) -> str:
    """Counts of runs: planned, measured, ended well."""
    planned = _planned_keys(plan)
    of_plan = f" of {len(planned | {r.key for r in records})} planned" if planned else ""
    return f"{len(records)}{of_plan} runs measured: {endings(records)}."


def missing_data(
    plan: Plan | None,
    scenes: Mapping[tuple[str, float], SceneRecord],
    records: Mapping[str, Record],
    keys: Sequence[tuple[str, float]],
    environments: Mapping[int, Environment],
) -> list[str]:
    """Sentences about missing plans, runs, scenes, errors and times."""
    planned = _planned_keys(plan)
    waiting = len(planned - set(records))
    ok = [r for r in records.values() if r.status == "ok"]
    samples = plan.samples if plan else 0
    untimed = sum(not r.run_s for r in ok)
    # Long runs are timed less often on purpose.
    short = sum(0 < len(r.run_s) < samples and sum(r.run_s) <= TIMING_SECONDS for r in ok)
    not_finite = any(e is None for r in ok for norms in r.errors.values() for e in norms.values())
    used = {r.environment: environments.get(r.environment) for r in ok if r.run_s}
    machines = {(e.cpu, e.cores, e.clock, *e.versions.items()) for e in used.values() if e}
    sentences = {
        "The store holds no plan: all runs of a scene are shown together.": plan is None,
        f"{waiting} of {len(planned)} planned runs are not measured yet. If the run is in work, "
        "load this page again later; if it was stopped, the same command goes on.": waiting,
        "The store holds no finished run.": not records,
        **{
            f"The scene {problem} (t_end={number(t_end)} s) has no description, picture and "
            "reference curve.": (problem, t_end) not in scenes
            for problem, t_end in keys
        },
        "No run reached the end: there are no errors, orders and times.": records and not ok,
        noise_sentence(ok): _noisy(_spreads(ok)),
        f"{untimed} of {len(ok)} runs that reached the end have no timing samples.": untimed,
        f"{short} runs have fewer than the {samples} timing samples planned.": short,
        "Some errors of runs that reached the end are not finite; they are not drawn.": not_finite,
        "The times come from different machines, clocks or versions (environments "
        f"{', '.join(map(str, sorted(used)))}): do not compare them.": len(machines) > 1,
    }
    return [sentence for sentence, holds in sentences.items() if holds]


def noise_sentence(records: Sequence[Record]) -> str:
    """Whether the machine was quiet enough to compare times."""
    spreads = _spreads(records)
    if not spreads:
        return "No run has two timing samples: the noise of the machine is not known."
    instead = "operations" if any(r.operations for r in records) else "counts"
    verdict = (
        f"The machine was noisy: judge by {instead}, or time again on a quiet one"
        if _noisy(spreads)
        else "The machine was quiet enough to tell larger differences"
    )
    noisy = sum(x > NOISY for x in spreads)
    return (
        f"{verdict} ({noisy} of {len(spreads)} timed runs spread by more than {NOISY:.0%} of "
        f"their median)."
    )


def _noisy(spreads: Sequence[float]) -> bool:
    return sum(x > NOISY for x in spreads) > NOISY_PART * len(spreads)


def _spreads(records: Iterable[Record]) -> list[float]:
    return [x for r in records if (x := timing_spread(r)) is not None]


def method_of_measurement(plan: Plan | None) -> list[str]:
    """Sentences about times, costs, errors and orders."""
    samples = f"{plan.samples} samples were asked for per run" if plan else "Samples per run vary"
    return [
        "Timed is the bare solve from start to end, warmed up, in processor seconds: a wait for a "
        "processor that is busy with others does not count, the work of further threads does. "
        "Tracing, compiling and consistent initial values are done before and listed apart.",
        f"{samples}, fewer of runs that last long; they are taken in rounds over all runs, those "
        "of a scene one after the other: a slow minute of the machine hits all alike, noise that "
        "is shorter than a round does not. "
        "Shown is the median, as bars the fastest and the slowest sample.",
        "Two runs differ in time if the 95 % interval of the median of their quotients within "
        f"rounds (order statistics) lies on one side of 1 and the median is beyond "
        f"{LEAST_QUOTIENT:g}. With fewer than {FEWEST} common rounds there is no such interval, "
        f"and the quotients must be beyond {LEAST_OF_FEW:g}. Runs that were not measured together "
        "are compared by the intervals of their own medians.",
        f"Operations count as different beyond a factor of {COSTS[COST].tie:g}: the cost model is "
        "no more exact. Work is counted where it happens; any difference of counts counts. A "
        "count that a library does not give is 'not counted'.",
        "Errors are relative, per group of variables and per norm. Orders are fitted to the "
        f"finest steps, as many as have slopes within {SPREAD:g} of each other; fewer than three "
        "points give 'not determined'.",
    ]


def _planned_keys(plan: Plan | None) -> set[str]:
    return {key for study in (plan.studies if plan else ()) for key in study.cells}
