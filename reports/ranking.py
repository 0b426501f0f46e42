"""The ranking: on each scene the cheapest runs that reach an accuracy, who ties, and who does not.

A target that lies within a hundred times the reference's own error is not judged. Integrators that
do the same on a scene are one contestant there, and share its numbers.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from operator import itemgetter
from typing import NamedTuple

from bench.results.quantities import ASKED, COSTS, NORM, TRUST, parts
from bench.results.records import NOT_TRIED, Record
from bench.results.timings import quotient
from reports.formatting import times
from reports.questions.question import TARGETS, Question, questions
from reports.series import (
    Series,
    groups_of,
    ok_runs,
    reference_error,
    step_or_tolerance,
    trusted_error,
)

#: Errors of the same method in two programs differ by rounding, relative to them.
_ROUNDING = 1e-3
#: The cheapest run of a contestant with its cost.
_Cheapest = tuple[float, Record]


class RankEntry(NamedTuple):
    """One integrator that was tried on one scene, for one question.

    ``contestant`` is the first integrator that does the same on the scene (itself, as a rule).
    ``reached`` says whether a run reaches the target, ``run`` is the cheapest of those whose cost
    is known, ``value`` its cost, ``ratio`` that cost relative to the cheapest contestant's:
    infinite where only that one is 0.
    """

    label: str
    contestant: str
    series: Series
    reached: bool = False
    run: Record | None = None
    value: float | None = None
    ratio: float | None = None

    @property
    def state(self) -> float | str:
        """The multiple of the cheapest contestant's cost, or why there is none.

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

    ``series`` are the integrators that were tried, by label, and ``contestants`` has for each the
    first that does the same. Of contestants, ``reached`` has those that reach the accuracy,
    ``cheapest`` the run and its cost where this is known, and ``tied`` those that cannot be told
    apart from the cheapest, itself included, in the order of the plan: medians of those who tie
    change places from run to run.
    """

    question: Question
    series: Mapping[str, Series]
    contestants: Mapping[str, str]
    reached: frozenset[str]
    cheapest: Mapping[str, _Cheapest]
    tied: Sequence[str]

    @cached_property
    def entries(self) -> dict[str, RankEntry]:
        """The integrators by label."""
        best = min((value for value, _ in self.cheapest.values()), default=0.0)
        found = {}
        for label, s in self.series.items():
            first = self.contestants[label]
            value, run = self.cheapest.get(first, (None, None))
            ratio = None if value is None else _ratio(value, best)
            found[label] = RankEntry(label, first, s, first in self.reached, run, value, ratio)
        return found

    @cached_property
    def names(self) -> dict[str, list[str]]:
        """The labels of the integrators that are one contestant, by the first of them."""
        alike: dict[str, list[str]] = {}
        for label, first in self.contestants.items():
            alike.setdefault(first, []).append(label)
        return alike

    @property
    def several(self) -> bool:
        """Whether several contestants were tried."""
        return len(self.names) > 1

    @property
    def first(self) -> list[RankEntry]:
        """The contestants that tie for the cheapest."""
        return [self.entries[label] for label in self.tied]

    @property
    def second(self) -> RankEntry | None:
        """The cheapest of the others."""
        others = [k for k in self.cheapest if k not in self.tied]
        return self.entries[min(others, key=lambda k: self.cheapest[k][0])] if others else None

    @property
    def winners(self) -> list[str]:
        """Labels of the first ones, and of those that do the same."""
        return [twin for label in self.tied for twin in self.names[label]]

    @property
    def unknown(self) -> list[RankEntry]:
        """The contestants that reach the accuracy at a cost that is not measured."""
        return [self.entries[k] for k in self.names if k in self.reached and k not in self.cheapest]

    @property
    def votes(self) -> bool:
        """Whether there was something to win: several contestants were compared."""
        return len(self.names) - len(self.reached) + len(self.cheapest) > 1

    @property
    def runs(self) -> list[Record]:
        """The runs behind the answer."""
        shown = [*self.first, *([self.second] if len(self.tied) == 1 else [])]
        return [s.run for s in shown if s and s.run]

    @property
    def nearest(self) -> tuple[float, Record] | None:
        """The smallest error of any run, with the run."""
        group, norm = self.question.group, self.question.norm
        known = filter(None, (s.nearest(group, norm) for s in self.series.values()))
        return min(known, key=itemgetter(0), default=None)


class Standing(NamedTuple):
    """On how many scenes an integrator is the cheapest alone or tied, reaches it, was tried.

    Wins and ties count on scenes on which several contestants are compared.
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
            for label, first in scene.contestants.items():
                row = rows.setdefault(label, [0, 0, 0, 0])
                row[2] += first in scene.reached
                row[3] += 1
            for label in scene.winners if scene.votes else ():
                rows[label][len(scene.tied) > 1] += 1
        found = [Standing(label, *row) for label, row in rows.items()]
        return sorted(found, key=lambda s: (-s.alone - s.tied, -s.alone, -s.reached, s.tried))

    def on(self, scenes: Iterable[str]) -> Answer:
        """The answer on some of the scenes."""
        chosen = set(scenes)
        return Answer(
            self.question,
            {k: v for k, v in self.scenes.items() if k in chosen},
            {k: v for k, v in self.unjudged.items() if k in chosen},
        )


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
        self.contestants = contestants(tried)
        self._starts = range(1 + max((len(r.later) for r in self.runs), default=0))
        self._ladders: dict[tuple[str, str, str], list[dict[str, _Ladder]]] = {}
        self._apart: dict[tuple[str, str, str], bool] = {}
        self.floor = cache(partial(reference_error, self.runs))

    def answer(self, question: Question) -> SceneAnswer:
        """The answer to a question that can be judged."""
        ladders, *later = self._climbed(question)
        reached = frozenset(k for k, own in ladders.items() if own.reaching(question.target))
        cheapest = _cheapest(ladders, question.target)
        winners: set[str] = set()
        # One that is first from a later start of the motion ties: luck decides between them.
        for own in (cheapest, *(_cheapest(start, question.target) for start in later)):
            if own:
                _, best = min(own.values(), key=itemgetter(0))
                winners |= {k for k, (_, r) in own.items() if self._tie(best, r, question.cost)}
        tied = [k for k in ladders if k in winners and k in cheapest]
        return SceneAnswer(question, self.series, self.contestants, reached, cheapest, tied)

    def _climbed(self, question: Question) -> list[dict[str, _Ladder]]:
        """The ladders of the contestants from each start of the motion."""
        group, cost, norm = question.group, question.cost, question.norm
        if (group, cost, norm) not in self._ladders:
            firsts = [s for k, s in self.series.items() if self.contestants[k] == k]
            self._ladders[group, cost, norm] = [
                {
                    s.label: _Ladder(s.ok, cost, lambda r, k=k: r.error(group, norm, k))
                    for s in firsts
                }
                for k in (self._starts if norm == NORM else (0,))
            ]
        return self._ladders[group, cost, norm]

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


def reaches(record: Record, group: str, target: float) -> bool:
    """Whether the error of a group is no larger than the target."""
    error = record.error(group, NORM)
    return error is not None and error <= target


def told_apart(one: Record, two: Record, cost: str) -> bool:
    """Whether the costs of two runs differ beyond what is known of them.

    Times by their quotient within rounds (`bench.results.timings`), others by `Cost.tie`.
    """
    if COSTS[cost].is_time:
        found = quotient(one, two)
        return found is not None and found.differs
    values = [v for r in (one, two) if (v := r.cost(cost)) is not None]
    return len(values) == 2 and max(values) > COSTS[cost].tie * min(values)


def contestants(series: Sequence[Series]) -> dict[str, str]:
    """The integrators of one scene, each with the first one that does the same there.

    The same are two with the same endings, work and operations at the same resolutions, and
    errors in all groups and norms that differ by rounding only.
    """
    firsts: list[Series] = []
    found = {}
    for s in series:
        twin = next((f for f in firsts if _same(f, s)), s)
        if twin is s:
            firsts.append(s)
        found[s.label] = twin.label
    return found


def _same(one: Series, two: Series) -> bool:
    alike = one.ok and len(one.records) == len(two.records)
    return bool(alike) and all(map(_same_run, one.records, two.records))


def _same_run(one: Record, two: Record) -> bool:
    if (one.status, one.work, one.pattern, step_or_tolerance(one)) != (
        two.status, two.work, two.pattern, step_or_tolerance(two)
    ):  # fmt: skip
        return False
    if one.errors.keys() != two.errors.keys() or told_apart(one, two, "operations"):
        return False
    if one.status == "ok" and not one.errors:
        return False  # nothing is known of what they compute
    return all(
        _same_error(error, two.error(group, norm), trusted_error([one, two], group, norm))
        for group, norms in one.errors.items()
        for norm, error in norms.items()
    )


def _same_error(one: float | None, two: float | None, trusted: float) -> bool:
    if one is None or two is None:
        return one is two
    return max(one, two) <= trusted or math.isclose(one, two, rel_tol=_ROUNDING)
