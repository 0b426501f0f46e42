"""What the pages say, read from a store into plain dataclasses that every page shares."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from bench.results.records import TIMING_SECONDS, Environment, Plan, Record, SceneRecord, Study
from bench.results.store import Store
from reports.charts import cost_by_size, overview, pareto_front
from reports.pages import atlas
from reports.pages.scene_chapter import Figure, ScenePart, SceneReader
from reports.series import (
    TRUST,
    Look,
    Series,
    error_of,
    label_of,
    looks_of,
    number,
    series_of,
)
from reports.text import damping, tables
from reports.text.ranking import Standing, overall, standings, verdicts
from reports.text.tables import Table

#: Timing samples that spread further than this, relative to their median, are noisy.
NOISY = 0.5
#: Part of the timed runs that may be noisy before the page says that the machine is.
NOISY_PART = 0.25


@dataclass
class Page:
    """Everything that a report says."""

    title: str
    state: str
    missing: list[str]
    verdict: Table | None
    overall: list[str]
    overview: list[Figure]
    front: Table | None
    scenes: list[ScenePart]
    integrators: Table | None
    damping: Table | None
    failures: Table | None
    timing: Table | None
    noise: str
    environments: list[tuple[int, Environment]]
    fairness: list[str] = field(default_factory=list)
    atlas: atlas.Chapter | None = None


def read_page(folder: Path, interactive: bool) -> Page:
    """Read the store in a folder and say what is there and what is missing.

    ``interactive`` asks for charts that answer to a pointer instead of pictures.

    Raises
    ------
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    with Store(folder) as store:
        plan, scenes, records = store.plan(), store.scenes(), store.records()
        looks = looks_of((label_of(r), r.family) for r in records.values())
        keys = _scene_keys(plan, scenes, records.values())
        names = _names(keys)
        ids = {key: f"run-{i}" for i, key in enumerate(records, 1)}
        parts, series = [], {}
        for i, key in enumerate(keys, 1):
            own = [r for r in records.values() if (r.problem, r.t_end) == key]
            series[names[key]] = series_of(own)
            twins = [k for k in keys[: i - 1] if _same(scenes.get(k), scenes.get(key))]
            part = SceneReader(
                anchor=f"scene-{i}",
                name=names[key],
                scene=scenes.get(key),
                records=own,
                looks=looks,
                rows=store.rows,
                ids=ids,
                interactive=interactive,
                described=names[twins[0]] if twins else "",
            )
            parts.append(part.read([s for s in _studies(plan) if (s.problem, s.t_end) == key]))
        environments, experiments = store.environments(), list(store.experiments().values())
        known = {
            name: d for name, d in store.damping().items() if plan and name in plan.integrators
        }
    everything, found = list(records.values()), standings(series)
    return Page(
        title=(plan.title or plan.name) if plan else "Results",
        state=_state(plan, everything),
        missing=_missing(plan, scenes, records, keys, environments),
        verdict=tables.verdict(verdicts(found), ids),
        overall=overall(found),
        overview=[
            *_overview(found, series, looks, interactive),
            *_growth(everything, scenes, looks),
        ],
        front=pareto_front.table(series, ids),
        scenes=parts,
        integrators=tables.integrators(series, found, plan.integrators if plan else {}),
        damping=damping.table(known, [(names[k], scenes[k]) for k in keys if k in scenes]),
        failures=tables.failures(everything),
        timing=tables.timing(series_of(everything)),
        noise=_noise(everything),
        environments=list(environments.items()),
        fairness=_fairness(plan),
        atlas=atlas.chapter(experiments),
    )


def _overview(
    found: Sequence[Standing],
    scenes: Mapping[str, Sequence[Series]],
    looks: Mapping[str, Look],
    interactive: bool,
) -> list[Figure]:
    """The charts over all scenes, with more than one integrator to compare."""
    if len({s.label for s in found}) < 2:
        return []
    which = "(choose above)" if interactive else "(acceleration to 1e-4, residual evaluations)"
    made = [
        (
            "Cost of the cheapest run that reaches an accuracy, as a multiple of the best on the "
            f"scene {which}. Grey: not reached.",
            {"overview-heat": overview.heat(found, interactive)},
        ),
        (
            f"Performance profile {which}: part of the scenes on which an integrator costs at "
            "most so many times the best (Dolan and More 2002). High on the left: often the "
            "cheapest; high on the right: reaches the accuracy almost everywhere.",
            {"overview-profile": overview.profile(found, looks, interactive)},
        ),
        (
            "Largest relative error over all times (up) against cost (to the right) "
            f"{which if interactive else '(acceleration, residual evaluations)'}. The broad line "
            "joins the runs that no other run of the scene beats in both (Pareto front); errors "
            f"below {TRUST:g} times the reference's own count as equal.",
            {"overview-front": pareto_front.chart(scenes, looks, interactive)},
        ),
    ]
    return [Figure(text, charts) for text, charts in made if all(charts.values())]


def _growth(
    records: Sequence[Record],
    scenes: Mapping[tuple[str, float], SceneRecord],
    looks: Mapping[str, Look],
) -> list[Figure]:
    """How cost grows with size, for every kind of scene that was run in several sizes."""
    return [
        Figure(
            f"Cost of {kind} against its size (unknowns: coordinates, multipliers, controller "
            "states, outputs), of the run with the most steps. A flat line on the right is a cost "
            "that grows like the size.",
            {f"sizes-{kind}": chart},
        )
        for kind, chart in cost_by_size.charts(records, scenes, looks).items()
    ]


# ---- words -------------------------------------------------------------------------------
def _scene_keys(
    plan: Plan | None, scenes: Iterable[tuple[str, float]], records: Iterable[Record]
) -> list[tuple[str, float]]:
    keys = [(s.problem, s.t_end) for s in _studies(plan)]
    keys += [(r.problem, r.t_end) for r in records]
    return list(dict.fromkeys([*keys, *scenes]))


def _names(keys: Sequence[tuple[str, float]]) -> dict[tuple[str, float], str]:
    """A scene's name, with its interval where it has several."""
    problems = [problem for problem, _ in keys]
    return {
        (problem, t_end): problem
        if problems.count(problem) == 1
        else f"{problem}, t_end={t_end:g} s"
        for problem, t_end in keys
    }


def _same(one: SceneRecord | None, other: SceneRecord | None) -> bool:
    """Whether two scenes differ in nothing but their interval."""
    return bool(
        one
        and other
        and (one.problem, one.parameters, one.description)
        == (other.problem, other.parameters, other.description)
    )


def _studies(plan: Plan | None) -> list[Study]:
    return plan.studies if plan else []


def _state(plan: Plan | None, records: Sequence[Record]) -> str:
    ok = sum(r.status == "ok" for r in records)
    planned = {key for study in _studies(plan) for key in study.cells}
    of_plan = f" of {len(planned | {r.key for r in records})} planned" if planned else ""
    return f"{len(records)}{of_plan} runs measured: {ok} ok, {len(records) - ok} with a reason."


def _missing(
    plan: Plan | None,
    scenes: dict[tuple[str, float], SceneRecord],
    records: dict[str, Record],
    keys: Sequence[tuple[str, float]],
    environments: dict[int, Environment],
) -> list[str]:
    """What a reader might look for and not find."""
    said = []
    if plan is None:
        said.append("The store holds no plan: all runs of a scene are shown together.")
    planned = {key for study in _studies(plan) for key in study.cells}
    waiting = len(planned - set(records))
    if waiting:
        said.append(f"{waiting} of {len(planned)} planned runs are not measured yet.")
    if not records:
        said.append("The store holds no finished run.")
    for problem, t_end in keys:
        if (problem, t_end) not in scenes:
            said.append(
                f"The scene {problem} (t_end={number(t_end)} s) has no description, picture "
                "and reference curve."
            )
    ok = [r for r in records.values() if r.status == "ok"]
    if records and not ok:
        said.append("No run reached the end: there are no errors, orders and times to show.")
    untimed = sum(not r.run_s for r in ok)
    if untimed:
        said.append(f"{untimed} of {len(ok)} runs that reached the end have no timing samples.")
    # Long runs are timed less often, and lack nothing.
    short = (
        sum(0 < len(r.run_s) < plan.samples and sum(r.run_s) <= TIMING_SECONDS for r in ok)
        if plan
        else 0
    )
    if short:
        said.append(f"{short} runs have fewer than the {plan.samples} timing samples planned.")
    if any(error_of(r, g, n) is None for r in ok for g in r.errors for n in r.errors[g]):
        said.append("Some errors of runs that reached the end are not finite; they are not drawn.")
    used = {r.environment: environments.get(r.environment) for r in ok if r.run_s}
    machines = {(e.cpu, e.cores, tuple(e.versions.items())) for e in used.values() if e}
    if len(machines) > 1:
        numbers = ", ".join(map(str, sorted(used)))
        said.append(
            f"The times come from different machines or versions (environments {numbers}): "
            "do not compare them."
        )
    return said


def _noise(records: Iterable[Record]) -> str:
    spreads = [x for r in records if (x := tables.spread(r)) is not None]
    if not spreads:
        return "No run has two timing samples: the noise of the machine is not known."
    noisy = sum(x > NOISY for x in spreads)
    verdict = (
        "The machine was noisy: judge by counts, or time again on a quiet one"
        if noisy > NOISY_PART * len(spreads)
        else "The machine was quiet enough to tell larger differences"
    )
    return (
        f"{verdict} ({noisy} of {len(spreads)} timed runs spread by more than {NOISY:.0%} of "
        f"their median)."
    )


def _fairness(plan: Plan | None) -> list[str]:
    samples = f"{plan.samples} samples were asked for per run" if plan else "Samples per run vary"
    return [
        "Timed is the bare solve from start to end, on one thread and warmed up. Tracing, "
        "compiling and consistent initial values are done before and listed apart.",
        f"{samples}; they are taken in turns over all runs, so that a slow minute of the machine "
        "hits all alike. Shown is the median, as bars the fastest and the slowest sample.",
        "Work is counted where it happens. What a library does not let us count is 'not counted'.",
        "Errors are relative, per group of variables and per norm; 'after the start transient' "
        "is the last part of the interval. Orders are fitted by rule in the finest window where "
        "the slope holds; fewer than three points give 'not determined'.",
    ]
