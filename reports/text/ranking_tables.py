"""Tables that compare integrators: the cheapest of them, standings, claims and results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from bench.results.quantities import COST, COSTS, NORM, NORMS, RANKED_COSTS
from bench.results.records import IntegratorFacts
from bench.results.table import Table
from reports.formatting import NO_VALUE, tie_text
from reports.questions.phrases import plain
from reports.questions.question import TABLE_GROUPS, TABLE_TARGETS, Question
from reports.questions.verdict import unjudged, verdict
from reports.questions.words import Words
from reports.ranking import Answer, answers
from reports.series import Series
from reports.text.measured_orders import claims_text, orders_measured
from reports.violations import violation_text

#: Columns of the ranked costs.
_LEAST = [COSTS[cost].least for cost in RANKED_COSTS]
#: When costs tie.
_TIES = (
    "".join(
        f"{', ' if k else 'Ties '}in {COSTS[cost].words}: {tie_text(cost)}"
        for k, cost in enumerate(RANKED_COSTS)
    )
    + "; and where another one is the cheapest if the runs start later on the same motion"
)


def _row(by_cost: Sequence[Answer], scene: str, words: Words) -> list[str]:
    """The verdicts by cost on a scene, and the |Φ| of their winners, once if they are alike."""
    judged = [found.scenes[scene] for found in by_cost if scene in found.scenes]
    if not judged:
        reason = f"cannot be judged: {unjudged(by_cost[0], scene)}"
        return [reason, *[""] * len(by_cost)]
    target = by_cost[0].question.target
    held = [violation_text((s.run for s in own.first), target) or NO_VALUE for own in judged]
    shown = held if len({*held}) > 1 else held[:1]
    said = "" if {*held} == {NO_VALUE} else " · ".join(shown)
    return [*(plain(verdict(own, words)) for own in judged), said]


def _with_violations(caption: str, head: list[str], rows: list[list[str]], **more: Any) -> Table:
    """A table of winners; its last column, of violations, is left out if it is empty."""
    count = len(head) + any(row[-1] for row in rows)
    head = [*head, f"|Φ| of the winners, {NORMS[NORM]}"]
    return Table(caption, head[:count], [row[:count] for row in rows], **more)


def targets_table(series: Sequence[Series], words: Words) -> Table | None:
    """The cheapest integrators of a scene for each accuracy, by each cost.

    None for fewer than two integrators.
    """
    if len(series) < 2:
        return None
    rows = []
    found = answers({"": series}, TABLE_GROUPS, TABLE_TARGETS)
    for question in [q for q in found if q.cost == COST]:
        by_cost = [found[replace(question, cost=cost)] for cost in RANKED_COSTS]
        entries = [e for own in by_cost[0].scenes.values() for e in own.entries.values()]
        reached = f"{sum(e.reached for e in entries)} of {len(entries)}" if entries else NO_VALUE
        cells = [reached, *_row(by_cost, "", words)]
        rows.append([f"{question.group} to {question.accuracy}", *cells])
    if not rows:
        return None
    return _with_violations(
        "Cheapest way to an accuracy",
        ["relative error", "reached by", *_LEAST],
        rows,
        code=(),
        note=f"Relative error: {NORMS[NORM]}. {_TIES}. Seconds also compare languages; counts and "
        "operations do not.",
    )


def winners_table(
    found: Mapping[Question, Answer], ids: Mapping[str, str], words: Words
) -> Table | None:
    """The answers on each scene with several contestants, by cost; they ask one accuracy.

    ``ids`` are the anchors of records by key.
    """
    by_cost = [*found.values()]
    both = [(k, s) for answer in by_cost for k, s in answer.scenes.items() if s.several]
    names = dict.fromkeys([*(k for k, _ in both), *(k for own in by_cost for k in own.unjudged)])
    if not both:
        return None
    return _with_violations(
        f"Cheapest way to {by_cost[0].question.text}",
        ["scene", *(COSTS[question.cost].least for question in found)],
        [[scene, *_row(by_cost, scene, words)] for scene in names],
        note=f"{_TIES}. Integrators joined by = do the same on the scene (equal errors and equal "
        "work at every resolution) and are one contestant. Other accuracies and "
        "costs: on the scenes' pages. The numbers in brackets lead to the runs.",
        links={
            (i, j): [ids[run.key] for run in own.scenes[scene].runs if run.key in ids]
            for i, scene in enumerate(names)
            for j, own in enumerate(by_cost, 1)
            if scene in own.scenes
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
        title, source = (facts.title.rstrip("."), facts.source) if facts else ("", "")
        claimed = claims_text(series, facts)
        rows.append([label, title, claimed, orders_measured(series), source])
    if not rows:
        return None
    return Table(
        "Integrators",
        ["integrator", "what it is", "orders claimed", "orders measured", "source"],
        rows,
        note="Orders claimed: for the scenes of its runs. Orders measured: of the relative error, "
        f"{NORMS[NORM]}, from the smallest to the largest over the scenes; at constant steps only. "
        "None: the error does not converge.",
    )
