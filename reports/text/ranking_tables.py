"""Tables that rank integrators: cheapest runs, winners, Pareto fronts, all integrators."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from operator import itemgetter

from bench.results.records import IntegratorFacts, Record
from reports.formatting import milliseconds, number, order_text, text_range
from reports.pareto_front import compared_scenes, pareto_front
from reports.ranking import (
    COST,
    GROUP,
    LEAST_COST,
    RANKED_COSTS,
    RANKED_GROUPS,
    TARGET,
    TARGETS,
    RankEntry,
    reaches,
)
from reports.series import (
    Series,
    error_of,
    groups_of,
    label_of,
    ok_runs,
    reference_error,
    run_name,
    seconds_of,
    trusted_error,
    with_values,
)
from reports.text.table import Table
from reports.text.winners import Winners

_VALUE = itemgetter(0)


def targets_table(series: Sequence[Series]) -> Table | None:
    """The cheapest runs of a scene that reach each accuracy, by time and by evaluations.

    None for fewer than two integrators.
    """
    groups = [g for g in groups_of(ok_runs(series)) if g in RANKED_GROUPS]
    rows = []
    for group in groups if len(series) > 1 else ():
        for target in TARGETS:
            row = _target_row(series, group, target)
            rows.append([f"{group} to {target:.0e}", *row])
    if not rows:
        return None
    return Table(
        "Cheapest way to an accuracy",
        ["relative error", "reached by", "least time", "fewest residual evaluations"],
        rows,
        code=(),
        note="Relative error: the largest over all times. The cheapest of the runs that reached "
        "it; seconds also compare languages, counts do not.",
    )


def _target_row(series: Sequence[Series], group: str, target: float) -> list[str]:
    if trusted_error(ok_runs(series), group, "max") > target:
        floor = reference_error(ok_runs(series), group, "max")
        return [f"cannot be judged: the reference's own error is {number(floor)}", "", ""]
    tried = [s for s in series if s.ok]
    reached = {s.label: [r for r in s.ok if reaches(r, group, target)] for s in tried}
    runs = [r for rs in reached.values() for r in rs]
    count = f"{sum(map(bool, reached.values()))} of {len(series)}"
    if not runs:
        errors = [(e, r) for s in tried for r in s.ok if (e := error_of(r, group, "max"))]
        if not errors:
            return [count, "", ""]
        error, record = min(errors, key=_VALUE)
        nearest = f"nearest: {number(error)} by {run_name(record)}"
        return [count, nearest, number(None)]
    return [count, _fastest(runs), _fewest(runs)]


def _fastest(runs: Sequence[Record]) -> str:
    timed = sorted(with_values(runs, seconds_of), key=_VALUE)
    if not timed:
        return "no timing samples"
    (seconds, best), *others = timed
    text = f"{run_name(best)}: {milliseconds(seconds)} ms"
    # Another method whose samples overlap the winner's has not lost.
    close = [label_of(r) for _, r in others if min(r.run_s) <= max(best.run_s)]
    rivals = [label for label in dict.fromkeys(close) if label != label_of(best)]
    if rivals:
        more = f" and {len(rivals) - 1} more" if len(rivals) > 1 else ""
        text += f" (not told apart by its samples: {rivals[0]}{more})"
    return text


def _fewest(runs: Sequence[Record]) -> str:
    counted = with_values(runs, lambda r: r.work.get("residuals"))
    if not counted:
        return "not counted"
    count, best = min(counted, key=_VALUE)
    return f"{run_name(best)}: {count}"


def winners_table(found: Sequence[Winners], ids: Mapping[str, str]) -> Table | None:
    """The winners of each scene; ``ids`` are the anchors of records by key."""
    if not found:
        return None
    rows = [[v.scene, *(v.by.get(cost, "not known") for cost in LEAST_COST)] for v in found]
    return Table(
        "Cheapest way to an acceleration within 1e-4",
        ["scene", *LEAST_COST.values()],
        rows,
        note="Largest relative error over all times. Who cannot be told apart from the winner by "
        "timing samples, or has the same count, ties. Other accuracies and costs: below. The "
        "numbers in brackets lead to the runs.",
        links={
            (i, j): [ids[key] for key in v.keys.get(cost, ()) if key in ids]
            for i, v in enumerate(found)
            for j, cost in enumerate(LEAST_COST, 1)
        },
    )


def pareto_table(scenes: Mapping[str, Sequence[Series]], ids: Mapping[str, str]) -> Table | None:
    """Integrators with runs on the Pareto front of the acceleration; ``ids`` are anchors by key."""
    rows, links = [], {}
    for scene, series in compared_scenes(scenes).items():
        cells = []
        for j, cost in enumerate(RANKED_COSTS, 1):
            runs = pareto_front(series, GROUP, cost)
            counts = Counter(map(label_of, runs))
            cells.append(", ".join(f"{label} ({n})" for label, n in counts.items()))
            links[len(rows), j] = [ids[r.key] for r in runs]
        if any(cells):
            rows.append([scene, *(cell or "not measured" for cell in cells)])
    if not rows:
        return None
    return Table(
        "Not beaten in acceleration and cost at once",
        ["scene", *(LEAST_COST[cost] for cost in RANKED_COSTS)],
        rows,
        note="Integrators from cheap to accurate, with the number of their runs that no other run "
        "of the scene beats or equals in both (the Pareto front).",
        links=links,
    )


def integrators_table(
    scenes: Mapping[str, Sequence[Series]],
    entries: Sequence[RankEntry],
    known: Mapping[str, IntegratorFacts],
) -> Table | None:
    """Each integrator with its orders claimed and measured, its best and its worst scene."""
    rows = []
    for label in dict.fromkeys(s.label for series in scenes.values() for s in series):
        mine = [s for series in scenes.values() for s in series if s.label == label]
        facts = known.get(mine[0].records[0].integrator)
        claimed = ", ".join(f"{g} {p}" for g, p in facts.orders.items()) if facts else ""
        ratios = [
            (s.ratio, s.scene)
            for s in entries
            if (s.label, s.group, s.target, s.cost) == (label, GROUP, TARGET, COST) and s.ratio
        ]
        best, worst = (f"{name} ({number(r)})" for r, name in _ends(ratios))
        rows.append(
            {
                "integrator": label,
                "what it is": facts.title.rstrip(".") if facts else "",
                "orders claimed": claimed,
                "orders measured": _measured(mine),
                "best scene": best,
                "worst scene": worst,
                "source": facts.source if facts else "",
            }
        )
    if not rows:
        return None
    return Table.from_dicts(
        "Integrators",
        rows,
        note="Orders measured: of the largest error after the start transient, from the smallest "
        "to the largest over the scenes; at constant steps only. Best and worst scene: residual "
        "evaluations to an acceleration within 1e-4, as a multiple of the best integrator's.",
    )


def _ends(ratios: Sequence[tuple[float, str]]) -> Sequence[tuple[float | None, str]]:
    return (min(ratios), max(ratios)) if ratios else ((None, "none"), (None, "none"))


def _measured(series: Sequence[Series]) -> str:
    said = []
    for group in groups_of(ok_runs(series)):
        fits = [s.fit(group, "settled") for s in series if s.controls == "step"]
        orders = sorted(f.order for f in fits if f.verdict == "converges" and f.order is not None)
        if orders:
            said.append(f"{group} {text_range(map(order_text, orders))}")
    return ", ".join(said)
