"""Integrators ranked on each scene by the cost of the cheapest run that reaches an accuracy.

A target that lies within a hundred times the reference's own error is left out. Integrators that
do the same on a scene are one contestant there, and share its numbers.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter

from bench.results.quantities import ASKED, COSTS, NORM, RANKED_COSTS, parts
from bench.results.records import NOT_TRIED, Record
from bench.results.timings import LEAST_OF_FEW, quotient
from reports.formatting import times
from reports.questions.question import Question, questions
from reports.series import (
    Series,
    groups_of,
    ok_runs,
    step_or_tolerance,
    trusted_error,
)

#: An integrator that was tried on a scene and has no cost there.
STATES = {
    "far": "reached the end, but not this accuracy",
    "failed": "no run reached the end",
    "unknown": "reached, at a cost that is not measured",
}
#: Errors of the same method in two programs differ by rounding, relative to them.
_ROUNDING = 1e-3


@dataclass(frozen=True)
class RankEntry:
    """One integrator that was tried on one scene, for one question.

    ``contestant`` is the first integrator that does the same on the scene (itself, as a rule).
    ``reached`` says whether a run reaches the target, ``run`` is the cheapest of those whose cost
    is known, ``value`` its cost, ``ratio`` that cost relative to the cheapest contestant's:
    infinite where only that one is 0.
    ``ended`` says whether any run reached the end. ``wins_later`` says whether it is the cheapest,
    or ties, among the same runs from a later start of the motion.
    """

    label: str
    contestant: str
    family: str
    reached: bool = False
    run: Record | None = None
    value: float | None = None
    ratio: float | None = None
    ended: bool = True
    wins_later: bool = False

    @property
    def state(self) -> float | str:
        """The multiple of the cheapest contestant's cost, or one of `STATES` if there is none."""
        if self.ratio is not None:
            return self.ratio
        if self.reached:
            return "unknown"
        return "far" if self.ended else "failed"

    @property
    def multiple(self) -> str:
        """The multiple in words; the count itself where the cheapest one is 0."""
        return f"{self.value:g}" if self.ratio == math.inf else times(self.ratio)


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


def same_times(records: Sequence[Record]) -> list[list[int]]:
    """The places of those behind each run whose times cannot be told from its own."""
    timed = [(k, r) for k, r in enumerate(records) if r.status == "ok" and r.run_s]
    found: list[list[int]] = [[] for _ in records]
    for n, (k, one) in enumerate(timed):
        for j, two in timed[n + 1 :]:
            # Quotients of samples that lie clearly apart need not be computed.
            (low, high), (least, most) = ((min(r.run_s), max(r.run_s)) for r in (one, two))
            far = least > LEAST_OF_FEW * high or low > LEAST_OF_FEW * most
            few = min(len(one.run_s), len(two.run_s)) < 2
            if (few or not far) and not told_apart(one, two, "seconds"):
                found[k].append(j)
    return found


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


def rank(
    all_series: Sequence[Series],
    groups: Sequence[str],
    targets: Sequence[float],
    norm: str = NORM,
) -> dict[Question, dict[str, RankEntry]]:
    """Rank the integrators of one scene, by label, for every question that can be judged there.

    One that does not support the scene, or whose runs were all interrupted, was not tried there.
    """
    series = [s for s in all_series if any(r.status not in NOT_TRIED for r in s.records)]
    runs, firsts = ok_runs(series), contestants(series)
    present = {*groups_of(runs, ASKED)}
    costs = {
        s.label: [(r, {cost: r.cost(cost) for cost in RANKED_COSTS}) for r in s.ok]
        for s in series
        if s.label == firsts[s.label]
    }
    found = {}
    for group in (g for g in groups if present.issuperset(parts(g))):
        trusted = trusted_error(runs, group, norm)
        ladders, *later = [
            {label: _Ladder(own, group, start, norm) for label, own in costs.items()}
            for start in range(1 + max((len(r.later) for r in runs), default=0))
        ]
        for question in questions([group], [t for t in targets if t >= trusted]):
            found[question] = _entries(series, firsts, ladders, later, question)
    return found


class _Ladder:
    """The runs of an integrator from accurate to coarse, and the cheapest up to each of them.

    ``start`` is the number of the later start of which the errors count, 0 for none.
    """

    def __init__(
        self,
        runs: Sequence[tuple[Record, Mapping[str, float | None]]],
        group: str,
        start: int,
        norm: str,
    ) -> None:
        judged = [
            (e, r, costs) for r, costs in runs if (e := r.error(group, norm, start)) is not None
        ]
        judged.sort(key=itemgetter(0))
        self.errors = [error for error, *_ in judged]
        self.cheapest: dict[str, list[tuple[float, Record] | None]] = {}
        for cost in RANKED_COSTS:
            best: tuple[float, Record] | None = None
            steps = self.cheapest[cost] = []
            for _, r, costs in judged:
                # Of two runs at the same cost the coarser one counts.
                value = costs[cost]
                if value is not None and (best is None or value <= best[0]):
                    best = value, r
                steps.append(best)

    def reaching(self, target: float) -> int:
        """How many runs reach the target."""
        return bisect_right(self.errors, target)

    def cheapest_reaching(self, question: Question) -> tuple[float, Record] | None:
        """The cost and the run of the cheapest that reaches the target, if its cost is known."""
        able = self.reaching(question.target)
        return self.cheapest[question.cost][able - 1] if able else None


def _cheapest(
    ladders: Mapping[str, _Ladder], question: Question
) -> dict[str, tuple[float, Record]]:
    found = {label: ladder.cheapest_reaching(question) for label, ladder in ladders.items()}
    return {label: cost for label, cost in found.items() if cost}


def _entries(
    series: Sequence[Series],
    firsts: Mapping[str, str],
    ladders: Mapping[str, _Ladder],
    later: Sequence[Mapping[str, _Ladder]],
    question: Question,
) -> dict[str, RankEntry]:
    cheapest = _cheapest(ladders, question)
    best = min((value for value, _ in cheapest.values()), default=0.0)
    winners: set[str] = set()
    for start in later:
        there = _cheapest(start, question)
        if there:
            _, least = min(there.values(), key=itemgetter(0))
            winners |= {k for k, (_, r) in there.items() if not told_apart(least, r, question.cost)}
    entries = {}
    for s in series:
        first = firsts[s.label]
        value, run = cheapest.get(first, (None, None))
        ratio = None if value is None else _ratio(value, best)
        reached = bool(ladders[first].reaching(question.target))
        entries[s.label] = RankEntry(
            s.label, first, s.family, reached, run, value, ratio, bool(s.ok), first in winners
        )
    return entries


def _ratio(value: float, best: float) -> float:
    if value == best:
        return 1.0
    return value / best if best else math.inf
