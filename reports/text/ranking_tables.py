"""Tables that compare integrators: the cheapest of them, standings, claims and results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from types import MappingProxyType

from bench.results.quantities import COST, COSTS, NORM, NORMS, RANKED_COSTS
from bench.results.records import IntegratorFacts
from bench.results.table import Table
from reports.formatting import number
from reports.questions.answers import Answer
from reports.ranking import (
    GROUP,
    RANKED_GROUPS,
    TARGET,
    TARGETS,
    RankEntry,
    accuracy_text,
    rank,
)
from reports.series import Series, groups_of, ok_runs, reference_error
from reports.text.measured_orders import orders_measured
from reports.text.winners import Verdict, tie_text, verdict

#: Columns of the ranked costs.
_LEAST = [COSTS[cost].least for cost in RANKED_COSTS]
#: When costs tie.
_TIES = "".join(
    f"{', ' if k else 'Ties '}in {COSTS[cost].words}: {tie_text(cost)}"
    for k, cost in enumerate(RANKED_COSTS)
)


def targets_table(
    series: Sequence[Series], names: Mapping[str, str] = MappingProxyType({})
) -> Table | None:
    """The cheapest integrators of a scene for each accuracy, by each cost.

    ``names`` are short names by label. None for fewer than two integrators.
    """
    groups = [g for g in groups_of(ok_runs(series)) if g in RANKED_GROUPS]
    if not groups or len(series) < 2:
        return None
    cases: dict[tuple[str, float], dict[str, list[RankEntry]]] = {}
    for entry in rank({"": series}):
        by_cost = cases.setdefault((entry.group, entry.target), {})
        by_cost.setdefault(entry.cost, []).append(entry)
    rows = []
    for group, target in product(groups, TARGETS):
        if by_cost := cases.get((group, target)):
            reached = sum(entry.reached for entry in by_cost[COST])
            cells = [verdict(by_cost[cost]).worded(names) for cost in RANKED_COSTS]
            found = [f"{reached} of {len(by_cost[COST])}", *cells]
        else:
            own = number(reference_error(ok_runs(series), group, NORM))
            sentence = f"cannot be judged: the reference's own error is {own}"
            found = [sentence, *[""] * len(RANKED_COSTS)]
        rows.append([f"{group} to {target:.0e}", *found])
    return Table(
        "Cheapest way to an accuracy",
        ["relative error", "reached by", *_LEAST],
        rows,
        code=(),
        note=f"Relative error: {NORMS[NORM]}. {_TIES}. Seconds also compare languages; counts and "
        "operations do not.",
    )


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
        note=f"{_TIES}. Integrators joined by = do the same on the scene (equal errors and equal "
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
        f"on which several integrators are compared. {_TIES}.",
    )


def integrators_table(
    scenes: Mapping[str, Sequence[Series]], known: Mapping[str, IntegratorFacts]
) -> Table | None:
    """Each integrator with its orders claimed and measured."""
    own: dict[str, list[Series]] = {}
    for s in (s for series in scenes.values() for s in series):
        own.setdefault(s.label, []).append(s)
    rows = []
    for label, series in own.items():
        facts = known.get(series[0].records[0].integrator)
        title, claims, source = (
            (facts.title.rstrip("."), facts.orders, facts.source) if facts else ("", {}, "")
        )
        claimed = ", ".join(f"{group} {order}" for group, order in claims.items())
        rows.append([label, title, claimed, orders_measured(series), source])
    if not rows:
        return None
    return Table(
        "Integrators",
        ["integrator", "what it is", "orders claimed", "orders measured", "source"],
        rows,
        note=f"Orders measured: of the relative error, {NORMS[NORM]}, from the smallest to "
        "the largest over the scenes; at constant steps only. None: the error does not converge.",
    )
