"""The ranking: on each scene the cheapest runs that reach an accuracy, who ties, and who does not.

A target that lies within a hundred times the reference's own error is not judged.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from operator import itemgetter
from typing import NamedTuple

from bench.results.quantities import ASKED, COSTS, NORM, TRUST, parts
from bench.results.records import NOT_TRIED, Record
from bench.results.timings import quotient
from reports.formatting import times
from reports.questions import TARGETS, Question, questions
from reports.series import Series, groups_of, ok_runs, reference_error

#: The cheapest run of an integrator with its cost.
_Cheapest = tuple[float, Record]


class RankEntry(NamedTuple):
    """One integrator that was tried on one scene, for one question.

    ``reached`` says whether a run reaches the target, ``run`` is the cheapest of those whose cost
    is known, ``value`` its cost, ``ratio`` that cost relative to the least of all: infinite where
    only that one is 0.
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
        if self.reached:
            return "unknown"
        return "far" if self.series.ok else "failed"

    @property
    def multiple(self) -> str:
        """The multiple in words; the count itself where the cheapest one is 0."""
        return f"{self.value:g}" if self.ratio == math.inf else times(self.ratio)


@dataclass(frozen=True)
class SceneAnswer:
    """The answer to one question on one scene.

    ``series`` are the integrators that were tried, by label, ``reached`` those that reach the
    accuracy; ``cheapest`` has the run and its cost where this is known. ``tied`` cannot be told
    apart from the cheapest, itself included, in the order of the plan: medians of those who tie
    change places from run to run. Of these ``later`` are so only where the motion starts later.
    """

    question: Question
    series: Mapping[str, Series]
    reached: Collection[str]
    cheapest: Mapping[str, _Cheapest]
    tied: Sequence[str]
    later: Collection[str] = ()

    @cached_property
    def entries(self) -> dict[str, RankEntry]:
        """The integrators by label."""
        best = min((value for value, _ in self.cheapest.values()), default=0.0)
        found = {}
        for label, s in self.series.items():
            value, run = self.cheapest.get(label, (None, None))
            ratio = None if value is None else _ratio(value, best)
            found[label] = RankEntry(label, s, label in self.reached, run, value, ratio)
        return found

    @property
    def first(self) -> list[RankEntry]:
        """The integrators that tie for the cheapest."""
        return [self.entries[label] for label in self.tied]

    @property
    def second(self) -> RankEntry | None:
        """The cheapest of the others."""
        others = [k for k in self.cheapest if k not in self.tied]
        return self.entries[min(others, key=lambda k: self.cheapest[k][0])] if others else None

    @property
    def unknown(self) -> list[str]:
        """The integrators that reach the accuracy at a cost that is not measured."""
        return [k for k in self.series if k in self.reached and k not in self.cheapest]

    @property
    def votes(self) -> bool:
        """Whether there was something to win: several integrators were compared."""
        return len(self.series) - len(self.reached) + len(self.cheapest) > 1

    @property
    def nearest(self) -> tuple[float, Record] | None:
        """The smallest error of any run, with the run."""
        group, norm = self.question.group, self.question.norm
        known = filter(None, (s.nearest(group, norm) for s in self.series.values()))
        return min(known, key=itemgetter(0), default=None)


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
            for label in scene.series:
                row = rows.setdefault(label, [0, 0, 0, 0])
                row[2] += label in scene.reached
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
    """The answers to all questions about groups that a scene has, scenes in their order."""
    having = {k: {*groups_of(ok_runs(s), ASKED)} for k, s in scenes.items()}
    asked = [g for g in groups if any(own.issuperset(parts(g)) for own in having.values())]
    found = {q: Answer(q, {}, {}) for q in questions(asked, targets, norms)}
    for name, series in scenes.items():
        field = _Field(series)
        for question, own in found.items():
            if not having[name].issuperset(parts(question.group)):
                continue
            floor = field.floor(question.group, question.norm)
            if question.target < TRUST * floor:
                own.unjudged[name] = floor
            else:
                own.scenes[name] = field.answer(question)
    return found


def answer(scenes: Mapping[str, Sequence[Series]], question: Question) -> Answer:
    """The answer to one question; it is empty if no scene has the group."""
    found = answers(scenes, [question.group], [question.target], [question.norm])
    return found.get(question, Answer(question, {}, {}))


# ---- one scene ---------------------------------------------------------------------------
class _Field:
    """The integrators of one scene, for any question.

    One that does not support the scene, or whose runs were all interrupted, was not tried there.
    """

    def __init__(self, series: Sequence[Series]) -> None:
        tried = [s for s in series if any(r.status not in NOT_TRIED for r in s.records)]
        self.series, self.runs = {s.label: s for s in tried}, ok_runs(series)
        self._starts = range(1 + max((len(r.later) for r in self.runs), default=0))
        self._ladders: dict[tuple[str, str, str], list[dict[str, _Ladder]]] = {}
        self._apart: dict[tuple[str, str, str], bool] = {}
        self.floor = cache(partial(reference_error, self.runs))

    def answer(self, question: Question) -> SceneAnswer:
        """The answer to a question that can be judged."""
        ladders, *later = self._climbed(question)
        reached = frozenset(k for k, own in ladders.items() if own.reaching(question.target))
        cheapest = _cheapest(ladders, question.target)
        now = self._tied(cheapest, question.cost)
        # One that is first from a later start of the motion ties: luck decides between them.
        starts = (self._tied(_cheapest(own, question.target), question.cost) for own in later)
        winners = now.union(*starts)
        tied = [k for k in ladders if k in winners and k in cheapest]
        return SceneAnswer(question, self.series, reached, cheapest, tied, {*tied} - now)

    def _climbed(self, question: Question) -> list[dict[str, _Ladder]]:
        """The ladders of the integrators from each start of the motion."""
        group, cost, norm = question.group, question.cost, question.norm
        if (group, cost, norm) not in self._ladders:
            self._ladders[group, cost, norm] = [
                {
                    s.label: _Ladder(s.ok, cost, lambda r, k=k: r.error(group, norm, k))
                    for s in self.series.values()
                }
                for k in (self._starts if norm == NORM else (0,))
            ]
        return self._ladders[group, cost, norm]

    def _tied(self, cheapest: Mapping[str, _Cheapest], cost: str) -> set[str]:
        """Those that cannot be told apart from the cheapest."""
        if not cheapest:
            return set()
        _, best = min(cheapest.values(), key=itemgetter(0))
        return {k for k, (_, run) in cheapest.items() if self._tie(best, run, cost)}

    def _tie(self, one: Record, two: Record, cost: str) -> bool:
        key = one.key, two.key, cost
        if key not in self._apart:
            self._apart[key] = told_apart(one, two, cost)
        return not self._apart[key]


class _Ladder:
    """The runs of an integrator from accurate to coarse, and the cheapest up to each of them."""

    def __init__(
        self, runs: Sequence[Record], cost: str, error_of: Callable[[Record], float | None]
    ) -> None:
        judged = [(e, r) for r in runs if (e := error_of(r)) is not None]
        judged.sort(key=itemgetter(0))
        self.errors = [error for error, _ in judged]
        self.cheapest: list[_Cheapest | None] = []
        best: _Cheapest | None = None
        for _, r in judged:
            # Of two runs at the same cost the coarser one counts.
            value = r.cost(cost)
            if value is not None and (best is None or value <= best[0]):
                best = value, r
            self.cheapest.append(best)

    def reaching(self, target: float) -> int:
        """How many runs reach the target."""
        return bisect_right(self.errors, target)


def _cheapest(ladders: Mapping[str, _Ladder], target: float) -> dict[str, _Cheapest]:
    """The cheapest run of each that reaches the target, if its cost is known."""
    able = {k: own.cheapest[n - 1] for k, own in ladders.items() if (n := own.reaching(target))}
    return {label: best for label, best in able.items() if best}


def _ratio(value: float, best: float) -> float:
    if value == best:
        return 1.0
    return value / best if best else math.inf


def told_apart(one: Record, two: Record, cost: str) -> bool:
    """Whether the costs of two runs differ beyond what is known of them.

    Times by their quotient within rounds (`bench.results.timings`), others by `Cost.tie`.
    """
    if COSTS[cost].is_time:
        found = quotient(one, two)
        return found is not None and found.differs
    values = [v for r in (one, two) if (v := r.cost(cost)) is not None]
    return len(values) == 2 and max(values) > COSTS[cost].tie * min(values)
