"""Tables that compare integrators: the cheapest of them, standings, and what they claim."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from bench.results.quantities import COST, COSTS, NORM, NORMS, RANKED_COSTS
from bench.results.records import MethodFacts
from bench.results.table import Table
from reports.formatting import NO_VALUE, tie_text
from reports.questions import TABLE_GROUPS, TABLE_TARGETS, Names, Question
from reports.ranking import Answer, answers
from reports.series import Series
from reports.verdicts import unjudged, verdict, violation_text

#: When costs tie.
_TIES = (
    "".join(f"Ties in {COSTS[cost].words}: {tie_text(cost)}. " for cost in RANKED_COSTS)
    + "One that is the cheapest from a later start on the same motion ties, too."
)


def _verdicts(
    caption: str,
    head: str,
    rows: Mapping[str, Sequence[Answer]],
    names: Names,
    note: str,
    scene: str | None = None,
) -> Table:
    """A table of verdicts: a column per cost, and |Φ| of the winners, left out if it is empty.

    A row has the answers by cost to one question on ``scene``, or on that of the row's name.
    """
    cells: list[list[str]] = []
    for name, by_cost in rows.items():
        place = name if scene is None else scene
        judged = [found.scenes[place] for found in by_cost if place in found.scenes]
        if not judged:
            reason = f"cannot be judged: {unjudged(by_cost[0], place)}"
            cells.append([name, reason, *[""] * len(by_cost)])
            continue
        target = by_cost[0].question.target
        held = [violation_text((s.run for s in own.first), target) or NO_VALUE for own in judged]
        shown = held if len({*held}) > 1 else held[:1]
        said = "" if {*held} == {NO_VALUE} else " · ".join(shown)
        cells.append([name, *(verdict(own, names) for own in judged), said])
    costs = [COSTS[found.question.cost].least for found in next(iter(rows.values()))]
    whole = [head, *costs, f"|Φ| of the winners, {NORMS[NORM]}"]
    count = len(whole) - (not any(row[-1] for row in cells))
    more: dict[str, Any] = {"code": ()} if scene is not None else {}
    return Table(caption, whole[:count], [row[:count] for row in cells], note=note, **more)


def targets_table(series: Sequence[Series], names: Names) -> Table | None:
    """The cheapest integrators of a scene for each accuracy, by each cost.

    None for fewer than two integrators.
    """
    found = answers({"": series}, TABLE_GROUPS, TABLE_TARGETS) if len(series) > 1 else {}
    rows = {
        f"{question.group} to {question.accuracy}": [
            found[replace(question, cost=cost)] for cost in RANKED_COSTS
        ]
        for question in found
        if question.cost == COST
    }
    note = f"Relative error: {NORMS[NORM]}. {_TIES} Seconds also compare languages; counts and "
    note += "operations do not."
    caption, head = "Cheapest way to an accuracy", "relative error"
    return _verdicts(caption, head, rows, names, note, "") if rows else None


def winners_table(found: Mapping[Question, Answer], names: Names) -> Table | None:
    """The answers on each scene with several integrators, by cost; they ask one accuracy."""
    by_cost = [*found.values()]
    several = [k for own in by_cost for k, s in own.scenes.items() if len(s.entries) > 1]
    if not several:
        return None
    scenes = dict.fromkeys([*several, *(k for own in by_cost for k in own.unjudged)])
    caption = f"Cheapest way to {by_cost[0].question.text}"
    note = f"{_TIES} Other accuracies: on the scenes' pages."
    return _verdicts(caption, "scene", dict.fromkeys(scenes, by_cost), names, note)


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
        "on which several integrators are compared.",
    )


def claims_text(facts: MethodFacts | None) -> str:
    """The orders that an integrator claims in general, by group."""
    return "; ".join(f"{g} {p}" for g, p in facts.orders.items()) if facts else ""


def integrators_table(labels: Sequence[str], known: Mapping[str, MethodFacts]) -> Table | None:
    """Each integrator with its title, orders claimed and source."""
    rows = []
    for label in labels:
        facts = known.get(label.partition(" x ")[0])
        title, source = (facts.title.rstrip("."), facts.source) if facts else ("", "")
        rows.append([label, title, claims_text(facts), source])
    head = ["integrator", "what it is", "orders claimed", "source"]
    return Table("Integrators", head, rows) if rows else None
