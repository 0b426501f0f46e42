"""Tables that rank integrators: cheapest runs, winners, Pareto fronts, all integrators."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from operator import itemgetter
from types import MappingProxyType

from bench.results.quantities import COST, COSTS, NORM, NORMS, RANKED_COSTS
from bench.results.records import IntegratorFacts, Record
from bench.results.table import Table
from bench.results.timings import FEWEST, LEAST_OF_FEW, LEAST_QUOTIENT
from reports.formatting import named, number
from reports.pareto_front import compared_scenes, pareto_front
from reports.questions.answers import Answer
from reports.ranking import (
    GROUP,
    RANKED_GROUPS,
    TARGET,
    TARGETS,
    RankEntry,
    accuracy_text,
    reaches,
    several_contestants,
    told_apart,
)
from reports.series import (
    Series,
    cost_of,
    error_of,
    groups_of,
    label_of,
    ok_runs,
    reference_error,
    trusted_error,
    with_values,
)
from reports.text.measured_orders import orders_measured
from reports.text.winners import Verdict, cost_text

_VALUE = itemgetter(0)
#: Columns of the ranked costs.
_LEAST = [COSTS[cost].least for cost in RANKED_COSTS]
#: When costs tie.
TIES = (
    "Ties: times whose median quotient within rounds of samples is below "
    f"{LEAST_QUOTIENT:g} or has a 95 % interval that holds 1 (with fewer than {FEWEST} samples "
    f"each: below {LEAST_OF_FEW:g}); operations within a factor of {COSTS[COST].tie:g}; equal "
    "counts."
)


def targets_table(
    series: Sequence[Series], names: Mapping[str, str] = MappingProxyType({})
) -> Table | None:
    """The cheapest runs of a scene that reach each accuracy, by each cost.

    ``names`` are short names by label. None for fewer than two integrators.
    """
    groups = [g for g in groups_of(ok_runs(series)) if g in RANKED_GROUPS]
    rows = []
    for group in groups if len(series) > 1 else ():
        for target in TARGETS:
            row = _target_row(series, group, target, names)
            rows.append([f"{group} to {target:.0e}", *row])
    if not rows:
        return None
    return Table(
        "Cheapest way to an accuracy",
        ["relative error", "reached by", *_LEAST],
        rows,
        code=(),
        note=f"Relative error: {NORMS[NORM]}. The cheapest of the runs that reached it. "
        f"{TIES} Seconds also compare languages; counts and operations do not.",
    )


def _target_row(
    series: Sequence[Series], group: str, target: float, names: Mapping[str, str]
) -> list[str]:
    nothing = [""] * len(RANKED_COSTS)
    if trusted_error(ok_runs(series), group, NORM) > target:
        floor = reference_error(ok_runs(series), group, NORM)
        return [f"cannot be judged: the reference's own error is {number(floor)}", *nothing]
    reached = {s.label: [r for r in s.ok if reaches(r, group, target)] for s in series}
    runs = [r for rs in reached.values() for r in rs]
    count = f"{sum(map(bool, reached.values()))} of {len(series)}"
    if runs:
        return [count, *(_cheapest(runs, cost, names) for cost in RANKED_COSTS)]
    errors = with_values(ok_runs(series), lambda r: error_of(r, group, NORM))
    if errors:
        error, record = min(errors, key=_VALUE)
        nothing[0] = f"nearest: {number(error)} by {_run(record, names)}"
    return [count, *nothing]


def _run(record: Record, names: Mapping[str, str]) -> str:
    return f"{names.get(label_of(record), record.integrator)}, {record.resolution}"


def _cheapest(runs: Sequence[Record], cost: str, names: Mapping[str, str]) -> str:
    """The cheapest run, the integrators that tie with it, and those of unknown cost.

    Each integrator stands by its own cheapest run.
    """
    cheapest: dict[str, tuple[float, Record]] = {}
    for value, r in sorted(with_values(runs, lambda r: cost_of(r, cost)), key=_VALUE):
        cheapest.setdefault(label_of(r), (value, r))
    if not cheapest:
        return "not measured"
    (value, best), *others = cheapest.values()
    said = f"{_run(best, names)}: {cost_text(value, cost)}"
    tied = [names.get(label_of(r), label_of(r)) for _, r in others if not told_apart(best, r, cost)]
    if tied:
        said += f" (tied: {named(tied, most=2)})"
    unknown = dict.fromkeys(names.get(k, k) for r in runs if (k := label_of(r)) not in cheapest)
    return f"{said}; not measured: {named(unknown, most=2)}" if unknown else said


def winners_table(
    found: Mapping[str, Mapping[str, Verdict]], ids: Mapping[str, str], names: Mapping[str, str]
) -> Table | None:
    """The verdicts on each scene and cost, for `GROUP` and `TARGET`.

    ``ids`` are the anchors of records by key, ``names`` those of integrators by label.
    """
    if not found:
        return None
    rows = [
        [scene, *(by[cost].worded(names) for cost in RANKED_COSTS)] for scene, by in found.items()
    ]
    return Table(
        f"Cheapest way to {accuracy_text(GROUP, TARGET)}",
        ["scene", *_LEAST],
        rows,
        note=f"{TIES} Integrators joined by = do the same on the scene (equal errors and equal "
        "work at every resolution) and are one contestant. Other accuracies and "
        "costs: on the scenes' pages. The numbers in brackets lead to the runs.",
        links={
            (i, j): [ids[run.key] for run in by[cost].runs if run.key in ids]
            for i, by in enumerate(found.values())
            for j, cost in enumerate(RANKED_COSTS, 1)
        },
    )


def standings_table(found: Answer) -> Table | None:
    """First places and scenes reached of each integrator; None for one integrator or one scene."""
    rows = found.standings
    if len(rows) < 2 or len(found.scenes) < 2:
        return None
    question = found.question
    return Table(
        f"Standings: {COSTS[question.cost].least} to {question.accuracy} in {question.quantity}",
        ["integrator", "alone cheapest", "tied", "reached", "tried"],
        [[s.label, *map(str, (s.alone, s.tied, s.reached, s.tried))] for s in rows],
        note=f"Numbers of scenes. Relative error: {NORMS[NORM]}. First places count on scenes "
        f"on which several integrators are compared. {TIES}",
    )


def pareto_table(
    scenes: Mapping[str, Sequence[Series]], ids: Mapping[str, str], names: Mapping[str, str]
) -> Table | None:
    """Integrators with runs on the Pareto front of the acceleration.

    ``ids`` are anchors of records by key, ``names`` short names by label.
    """
    rows, links = [], {}
    for scene, series in compared_scenes(scenes).items():
        cells = []
        for j, cost in enumerate(RANKED_COSTS, 1):
            runs = pareto_front(series, GROUP, cost)
            counts = Counter(map(label_of, runs))
            cells.append(", ".join(f"{names[label]} ({n})" for label, n in counts.items()))
            links[len(rows), j] = [ids[r.key] for r in runs]
        if any(cells):
            rows.append([scene, *(cell or "not measured" for cell in cells)])
    if not rows:
        return None
    return Table(
        "Not beaten in acceleration and cost at once",
        ["scene", *_LEAST],
        rows,
        note="Integrators from cheap to accurate, with the number of their runs on the Pareto "
        "front: no other run of the scene has a smaller cost and no larger error, or a smaller "
        f"error and no larger cost. Error: relative, {NORMS[NORM]}.",
        links=links,
    )


def integrators_table(
    scenes: Mapping[str, Sequence[Series]],
    entries: Sequence[RankEntry],
    known: Mapping[str, IntegratorFacts],
) -> Table | None:
    """Each integrator with its orders claimed and measured, its best and its worst scene."""
    rows, compared = [], several_contestants(entries)
    for label in dict.fromkeys(s.label for series in scenes.values() for s in series):
        mine = [s for series in scenes.values() for s in series if s.label == label]
        facts = known.get(mine[0].records[0].integrator)
        claimed = ", ".join(f"{g} {p}" for g, p in facts.orders.items()) if facts else ""
        tried = [
            s
            for s in entries
            if (s.label, s.group, s.target, s.cost) == (label, GROUP, TARGET, COST)
        ]
        ratios = [(s.ratio, s.scene) for s in tried if s.ratio and s.scene in compared]
        ends = (f(ratios, default=(None, "none")) for f in (min, max))
        best, worst = (f"{name} ({number(r)})" for r, name in ends)
        if missed := [s.scene for s in tried if not s.reached]:
            worst = f"{named(missed, most=2)} (not reached)"
        rows.append(
            {
                "integrator": label,
                "what it is": facts.title.rstrip(".") if facts else "",
                "orders claimed": claimed,
                "orders measured": orders_measured(mine),
                "reached": f"{sum(s.reached for s in tried)} of {len(tried)} scenes tried"
                if tried
                else "not judged",
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
        note=f"Orders measured: of the relative error, {NORMS[NORM]}, from the smallest to "
        "the largest over the scenes; at constant steps only. None: the error does not converge. "
        f"Reached, best and worst scene: {accuracy_text(GROUP, TARGET)}; the cost "
        f"({COSTS[COST].title}) as a multiple of the cheapest integrator's on a scene with several "
        "contestants.",
    )
