"""Tables that compare integrators: the cheapest of them, standings, and what they claim."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from bench.results.quantities import COST, COSTS, NORM, NORMS
from bench.results.records import MethodFacts
from bench.results.table import Table
from reports.formatting import NO_VALUE, tie_text
from reports.questions import TABLE_GROUPS, TABLE_TARGETS, Names, Question
from reports.ranking import LUCK, Answer, answers
from reports.scenes import NO_FACTS
from reports.series import Series
from reports.verdicts import unjudged, verdict, violation_text

#: When costs tie.
_TIES = (
    "".join(f"Ties in {cost.words}: {tie_text(name)}. " for name, cost in COSTS.items())
    + "One that is among the cheapest from a later start on the same motion ties, too, if it costs "
    f"{LUCK:g} times as much at most."
)


def _verdicts(rows: Mapping[str, tuple[str, Sequence[Answer]]], names: Names) -> list[list[str]]:
    """Rows of verdicts: a column per cost, and |Φ| of the winners, left out if it is empty.

    A row has a scene, and the answers by cost to one question. The first row is the head.
    """
    cells: list[list[str]] = []
    for name, (scene, by_cost) in rows.items():
        judged = [found.scenes[scene] for found in by_cost if scene in found.scenes]
        if judged:
            target = by_cost[0].question.target
            held = [violation_text((s.run for s in a.first), target) or NO_VALUE for a in judged]
            shown = held if len({*held}) > 1 else held[:1]
            cells.append([name, *(verdict(own, names) for own in judged), " · ".join(shown)])
        else:
            reason = f"cannot be judged: {unjudged(by_cost[0], scene)}"
            cells.append([name, reason, *[""] * len(by_cost)])
    _, first = next(iter(rows.values()))
    costs = [COSTS[found.question.cost].least for found in first]
    count = len(costs) + 1 + any(row[-1] not in ("", NO_VALUE) for row in cells)
    head = ["", *costs, f"|Φ| of the winners, {NORMS[NORM]}"]
    return [row[:count] for row in (head, *cells)]


def targets_table(series: Sequence[Series], names: Names) -> Table | None:
    """The cheapest integrators of a scene for each accuracy, by each cost.

    None for fewer than two integrators.
    """
    found = answers({"": series}, TABLE_GROUPS, TABLE_TARGETS) if len(series) > 1 else {}
    asked = [question for question in found if question.cost == COST]
    if not asked:
        return None
    rows = {
        f"{q.group} to {q.accuracy}": ("", [found[replace(q, cost=c)] for c in COSTS])
        for q in asked
    }
    (_, *head), *cells = _verdicts(rows, names)
    note = f"Relative error: {NORMS[NORM]}. {_TIES} Seconds also compare languages; counts and "
    note += "operations do not."
    head = ["relative error", *head]
    return Table("Cheapest way to an accuracy", head, cells, code=(), note=note)


def winners_table(found: Mapping[Question, Answer], names: Names) -> Table | None:
    """The answers on each scene with several integrators, by cost; they ask one accuracy."""
    by_cost = [*found.values()]
    several = [k for own in by_cost for k, s in own.scenes.items() if len(s.entries) > 1]
    if not several:
        return None
    scenes = dict.fromkeys([*several, *(k for own in by_cost for k in own.unjudged)])
    (_, *head), *cells = _verdicts({k: (k, by_cost) for k in scenes}, names)
    caption = f"Cheapest way to {by_cost[0].question.text}"
    note = f"{_TIES} Other accuracies: on the scenes' pages."
    return Table(caption, ["scene", *head], cells, note=note)


def standings_table(found: Answer) -> Table | None:
    """First places and scenes reached of each integrator; None for one integrator or one scene."""
    rows = found.standings
    if len(rows) < 2 or len(found.scenes) < 2:
        return None
    question = found.question
    return Table(
        f"Standings: {COSTS[question.cost].least} to {question.accuracy} in {question.quantity}",
        ["integrator", "alone cheapest", "tied", "reached", "tried"],
        [[label, *map(str, counts)] for label, *counts in rows],
        note=f"Numbers of scenes. Relative error: {NORMS[NORM]}. First places count on scenes "
        "on which several integrators are compared.",
    )


def claims_text(facts: MethodFacts) -> str:
    """The orders that an integrator claims in general, by group."""
    return "; ".join(f"{g} {p}" for g, p in facts.orders.items()) or "none stated"


def integrators_table(labels: Sequence[str], known: Mapping[str, MethodFacts]) -> Table | None:
    """Each integrator with its title, orders claimed and source."""
    rows = []
    for label in labels:
        facts = known.get(label.partition(" x ")[0], NO_FACTS)
        what = " [".join([facts.title.rstrip("."), *label.replace(",", ", ").split("[")[1:]])
        rows.append([label, what, claims_text(facts), facts.source])
    head = ["integrator", "what it is", "orders claimed in general", "source"]
    return Table("Integrators", head, rows) if rows else None
