"""The ranking: on each scene the cheapest runs that reach an accuracy, who ties, and who does not.

A target that lies within a hundred times the reference's own error is not judged.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from itertools import product
from operator import itemgetter
from typing import NamedTuple

from bench.results.quantities import ASKED, COSTS, NORM, TRUST
from bench.results.records import NOT_TRIED, Record
from bench.results.timings import by_round, quotient
from reports.questions import TARGETS, Question
from reports.series import Series, groups_of, ok_runs, reference_error

#: Luck with the places of its steps saves an integrator up to a tolerance, half a decade, in cost.
LUCK = 3.0
#: The cheapest run of an integrator with its cost.
_Cheapest = tuple[float, Record]
#: The errors of an integrator's runs, rising, and the cheapest run up to each of them.
_Ladder = tuple[list[float], list[_Cheapest | None]]


class RankEntry(NamedTuple):
    """One integrator that was tried on one scene, for one question.

    ``reached`` says whether a run reaches the target, ``run`` is the cheapest of those whose cost
    is known, ``value`` its cost, ``ratio`` its multiple of the least (`compared`), 1 at least.
    """

    label: str
    series: Series
    reached: bool = False
    run: Record | None = None
    value: float | None = None
    ratio: float | None = None

    @property
    def state(self) -> float | str:
        """The multiple of the least cost, or why there is none.

        "unknown": it reaches the target at a cost that is not measured; "far": its runs reached the
        end, but not the target; "failed": no run reached the end.
        """
        if self.ratio is not None:
            return self.ratio
        return "unknown" if self.reached else "far" if self.series.ok else "failed"


@dataclass(frozen=True)
class SceneAnswer:
    """The answer to one question on one scene.

    ``entries`` are the integrators that were tried, by label. ``tied`` cannot be told apart from
    the cheapest, itself included, the cheapest first. Of these ``later`` are so only where the
    motion starts later.
    """

    question: Question
    entries: Mapping[str, RankEntry]
    tied: Sequence[str]
    later: Collection[str] = ()

    @property
    def first(self) -> list[RankEntry]:
        """The integrators that tie for the cheapest."""
        return [self.entries[label] for label in self.tied]

    @property
    def second(self) -> RankEntry | None:
        """The cheapest of the others."""
        others = [e for e in self.entries.values() if e.run and e.label not in self.tied]
        return min(others, key=lambda e: e.value or 0.0, default=None)

    @property
    def reached(self) -> bool:
        """Whether any integrator reaches the accuracy."""
        return any(e.reached for e in self.entries.values())

    @property
    def votes(self) -> bool:
        """Whether there was something to win: several integrators were compared."""
        return sum(e.state != "unknown" for e in self.entries.values()) > 1

    def place(self, label: str) -> str:
        """State of an integrator there: "alone", "tied", "dearer", "single", or its state."""
        entry = self.entries[label]
        if entry.ratio is None:
            return str(entry.state)
        if not self.votes:
            return "single"
        return "dearer" if label not in self.tied else "tied" if len(self.tied) > 1 else "alone"


class Standing(NamedTuple):
    """On how many scenes an integrator is the cheapest alone or tied, reaches it, was tried.

    Wins and ties count on scenes on which several integrators are compared.
    """

    label: str
    alone: int
    tied: int
    reached: int
    tried: int


@dataclass(frozen=True)
class Answer:
    """The answer to one question on all scenes that have the group.

    ``unjudged`` are scenes with the reference's own error there: the target is below a hundred
    times that.
    """

    question: Question
    scenes: dict[str, SceneAnswer]
    unjudged: dict[str, float]

    @cached_property
    def standings(self) -> list[Standing]:
        """One row per integrator, the most successful first: first places, wins, scenes reached."""
        rows: dict[str, list[int]] = {}
        for scene in self.scenes.values():
            for label, entry in scene.entries.items():
                row = rows.setdefault(label, [0, 0, 0, 0])
                row[2] += entry.reached
                row[3] += 1
            for label in scene.tied if scene.votes else ():
                rows[label][len(scene.tied) > 1] += 1
        found = [Standing(label, *row) for label, row in rows.items()]
        return sorted(found, key=lambda s: (-s.alone - s.tied, -s.alone, -s.reached, s.tried))


def answers(
    scenes: Mapping[str, Sequence[Series]],
    groups: Sequence[str] = ASKED,
    targets: Sequence[float] = TARGETS,
    norms: Sequence[str] = (NORM,),
) -> dict[Question, Answer]:
    """The answers by each cost to all questions about groups that a scene has."""
    having = {k: {*groups_of(ok_runs(s), ASKED)} for k, s in scenes.items()}
    asked = [g for g in groups if any(g in own for own in having.values())]
    questions = (Question(*own) for own in product(asked, targets, COSTS, norms))
    found = {question: Answer(question, {}, {}) for question in questions}
    for name, series in scenes.items():
        field = _Field(series)
        for question, own in found.items():
            if question.group not in having[name]:
                continue
            floor = field.floor(question.group, question.norm)
            if question.target < TRUST * floor:
                own.unjudged[name] = floor
            else:
                own.scenes[name] = field.answer(question)
    return found


def by_cost(scenes: Mapping[str, Sequence[Series]], first: Question) -> dict[Question, Answer]:
    """The answers to one question by each cost, its own first; empty if no scene has the group."""
    found = answers(scenes, [first.group], [first.target], [first.norm])
    asked = (replace(first, cost=cost) for cost in dict.fromkeys((first.cost, *COSTS)))
    return {question: found.get(question, Answer(question, {}, {})) for question in asked}


# ---- one scene ---------------------------------------------------------------------------
class _Field:
    """The integrators of one scene, for any question.

    One that does not support the scene, or whose runs were all interrupted, was not tried there.
    """

    def __init__(self, series: Sequence[Series]) -> None:
        self.series = [s for s in series if any(r.status not in NOT_TRIED for r in s.records)]
        runs = ok_runs(series)
        known = {run.key: run for run in runs}
        self._starts = range(1 + max((len(r.later) for r in runs), default=0))
        self._ladders = cache(self._ladders_of)
        self._compared = cache(lambda one, two, cost: compared(known[one], known[two], cost))
        self.floor = cache(partial(reference_error, runs))

    def answer(self, question: Question) -> SceneAnswer:
        """The answer to a question that can be judged."""
        cost, target = question.cost, question.target
        ladders = self._ladders(question.group, cost, question.norm)
        cheapest, *later = [_cheapest(own, target) for own in ladders]
        now = self._tied(cheapest, cost)
        best, top = min(cheapest.values(), key=itemgetter(0), default=(0.0, None))
        # One that is first from a later start of the motion ties: luck decides between them.
        lucky = {k for own in later for k in self._tied(own, cost) if own[k][1].later}
        winners = now | {k for k in lucky & cheapest.keys() if cheapest[k][0] <= LUCK * best}
        entries = {}
        for s in self.series:
            reached = bisect_right(ladders[0][s.label][0], target) > 0
            value, run = cheapest.get(s.label, (None, None))
            ratio = max(1.0, self._compared(top.key, run.key, cost)[0]) if run and top else None
            entries[s.label] = RankEntry(s.label, s, reached, run, value, ratio)
        tied = sorted((k for k in entries if k in winners), key=lambda k: cheapest[k][0])
        return SceneAnswer(question, entries, tied, {*tied} - now)

    def _ladders_of(self, group: str, cost: str, norm: str) -> list[dict[str, _Ladder]]:
        """The ladders of the integrators from each start of the motion."""
        starts = self._starts if norm == NORM else (0,)
        return [{s.label: _ladder(s.ok, cost, group, norm, k) for s in self.series} for k in starts]

    def _tied(self, cheapest: Mapping[str, _Cheapest], cost: str) -> set[str]:
        """Those that cannot be told apart from the cheapest."""
        if not cheapest:
            return set()
        _, best = min(cheapest.values(), key=itemgetter(0))
        return {k for k, (_, r) in cheapest.items() if not self._compared(best.key, r.key, cost)[1]}


def _ladder(runs: Sequence[Record], cost: str, group: str, norm: str, start: int) -> _Ladder:
    judged = [(e, r) for r in runs if (e := r.error(group, norm, start)) is not None]
    judged.sort(key=itemgetter(0))
    cheapest: list[_Cheapest | None] = []
    best: _Cheapest | None = None
    for _, r in judged:
        # Of two runs at the same cost the more accurate one counts.
        value = r.cost(cost)
        if value is not None and (best is None or value < best[0]):
            best = value, r
        cheapest.append(best)
    return [error for error, _ in judged], cheapest


def _cheapest(ladders: Mapping[str, _Ladder], target: float) -> dict[str, _Cheapest]:
    """The cheapest run of each that reaches the target, if its cost is known."""
    able = {k: runs[n - 1] for k, (errors, runs) in ladders.items()
            if (n := bisect_right(errors, target))}  # fmt: skip
    return {label: best for label, best in able.items() if best}


def compared(one: Record, two: Record, cost: str) -> tuple[float, bool]:
    """How many times the cost of one run another has, and whether they surely differ.

    Times are compared within rounds (`bench.results.timings`), others differ beyond `Cost.tie`; a
    multiple of nothing is infinite.
    """
    if cost == "seconds" and (found := quotient(by_round(one), by_round(two))):
        return found.value, found.differs
    least, other, tie = one.cost(cost) or 0.0, two.cost(cost) or 0.0, COSTS[cost].tie
    times = 1.0 if other == least else other / least if least else math.inf
    return times, cost != "seconds" and not 1 / tie <= times <= tie
