"""Two integrators side by side: costs at equal error, scene by scene, and what luck may explain.

The cost at an error is interpolated between neighbouring runs of an integrator, on straight lines
in the logarithms of error and cost. If its coarsest run is better already, it costs at most as much
as that run.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from bench.results.quantities import COSTS, NORM, NORMS, TRUST, checked_group
from bench.results.records import NOT_TRIED, Record, counted
from bench.results.table import Table
from bench.results.timings import (
    LEVEL,
    Quotient,
    Samples,
    by_round,
    median_interval,
    quotient_by_round,
)
from problems.base.spec import SpecError, one_of
from reports.formatting import number
from reports.names import named_labels, scene_name
from reports.questions import FIRST, TABLE_TARGETS, Question, named
from reports.scenes import stored_runs
from reports.series import Series, ok_runs, reference_error

_MEANING = (
    "Costs at equal error are interpolated between runs. In brackets: the ends over the run and "
    "its later starts, of times with the interval of their samples; of a median over scenes the 95 "
    "% interval of the sign test, of fewer than six scenes the ends. 'At least' and 'at most': the "
    "coarsest run of one is better than asked, or only one gets there from some starts; 'coarsest "
    "runs': those of both are better. Not judged: below a hundred times the reference's own error."
)
#: An error of zero has no logarithm; smaller ones are rounding.
_LEAST_ERROR = 1e-16
#: The errors of a line's runs and samples of their costs, from coarse to fine.
_Line = Sequence[tuple[float, Samples]]


@dataclass(frozen=True)
class Duel:
    """Cost of the second integrator over that of the first one at equal error.

    ``ratio`` is the median over the starts of the motion: infinite where only the first one reaches
    the accuracy, 0 where only the second one does, None for the reason ``why``. ``low`` and
    ``high`` are its ends over the starts, with the intervals of times; 0 and infinite if there is
    no bound. ``told_apart`` says whether the costs differ beyond all that.
    """

    ratio: float | None
    low: float = 0.0
    high: float = math.inf
    told_apart: bool = False
    why: str = ""

    @property
    def known(self) -> float | None:
        """The ratio if both have a cost."""
        return self.ratio if self.ratio and self.ratio < math.inf else None

    def text(self, unit: str = "") -> str:
        """The known ratio with its interval or its bound: '1.7 (1.4 to 2.1)', 'at least 3'."""
        if self.high == math.inf:
            return f"at least {number(self.low)}{unit}"
        if self.low == 0:
            return f"at most {number(self.high)}{unit}"
        ends = [number(self.low), number(self.high)]
        interval = f" ({' to '.join(ends)})" if ends[0] != ends[1] else ""
        return f"{number(self.ratio)}{unit}{interval}"


@dataclass(frozen=True)
class Versus:
    """The duels of two integrators by scene, for one question; ``names`` are their short names."""

    question: Question
    norm: str
    names: tuple[str, str]
    duels: Mapping[str, Duel]

    def shown(self, scene: str) -> str:
        """The duel on a scene, as a table has it."""
        duel = self.duels[scene]
        if duel.known is not None:
            return duel.text()
        return duel.why if duel.ratio is None else f"only {self.names[duel.ratio == 0]}"

    @property
    def cheaper(self) -> tuple[list[str], list[str]]:
        """The scenes on which the first one is cheaper beyond doubt, and those of the second."""
        apart = {k: d.ratio for k, d in self.duels.items() if d.told_apart and d.ratio is not None}
        return [k for k, r in apart.items() if r > 1], [k for k, r in apart.items() if r < 1]

    @property
    def p_value(self) -> float:
        """Two-sided sign test over the scenes on which the two are told apart."""
        less, more = sorted(map(len, self.cheaper))
        tails = 2 * sum(math.comb(less + more, k) for k in range(less + 1))
        return min(1.0, tails / 2 ** (less + more))

    @property
    def median(self) -> Duel | None:
        """The median of the ratios over the scenes, with its interval; that of a single scene."""
        found = [d for d in self.duels.values() if d.known is not None]
        if len(found) < 2:
            return found[0] if found else None
        ratios = [d.known for d in found if d.known is not None]
        return Duel(statistics.median(ratios), *median_interval(ratios))

    @property
    def sentence(self) -> str:
        """How much the second one costs, on how many scenes, and whether this is significant."""
        question, found = self.question, self.median
        goal = f"at {question.accuracy} in {question.quantity} ({NORMS[self.norm]})"
        judged = [k for k, d in self.duels.items() if d.ratio is not None]
        if not judged:
            why = named(f"{scene_name(k)} ({d.why})" for k, d in self.duels.items())
            return f"Nothing can be compared {goal}: {why}."
        (one, two), said = self.names, f"By {COSTS[question.cost].words} {goal}: "
        if found and found.ratio:
            both = [k for k in judged if self.duels[k].known is not None]
            where = f"the median of {len(both)} scenes" if len(both) > 1 else scene_name(both[0])
            apart = ", not told apart" if found.low <= 1 <= found.high else ""
            said += f"{two} costs {found.text(' times')} as much as {one}, {where}{apart}; "
        wins, losses = self.cheaper
        said += f"{one} wins beyond doubt on {len(wins)} and {two} on {len(losses)} of "
        said += counted(len(judged), "scene")
        if len(judged) > 1:
            no = "" if self.p_value <= 1 - LEVEL else "not "
            said += f"; {no}significant over the scenes (sign test: p = {self.p_value:.2g})"
        return f"{said}."


def versus(
    scenes: Mapping[str, Sequence[Series]],
    labels: tuple[str, str],
    names: Mapping[str, str],
    question: Question,
    norm: str,
) -> Versus:
    """Compare two integrators on all scenes on which both were tried and have the error."""
    duels = {}
    for scene, series in scenes.items():
        own = {
            s.label: s
            for s in series
            if s.label in labels and any(r.status not in NOT_TRIED for r in s.records)
        }
        runs = ok_runs(own.values())
        if len(own) == 2 and any(r.error(question.group, norm) is not None for r in runs):
            duels[scene] = _duel(own[labels[0]], own[labels[1]], runs, question, norm)
    return Versus(question, norm, (names[labels[0]], names[labels[1]]), duels)


def _duel(one: Series, two: Series, runs: Sequence[Record], question: Question, norm: str) -> Duel:
    trusted = TRUST * reference_error(runs, question.group, norm)
    if question.target < trusted:
        return Duel(None, why="not judged")
    found, why = [], "neither reaches it"
    for start in range(1 + max(len(r.later) for r in runs)):
        lines = [
            [
                (max(e, trusted, _LEAST_ERROR), _samples(r, question.cost))
                for r in s.ok
                if (e := r.error(question.group, norm, start)) is not None
            ]
            for s in (one, two)
        ]
        reached = [any(e <= question.target for e, _ in line) for line in lines]
        if all(reached):
            quotient, why = _quotient(lines[0], lines[1], question)
            found += [quotient] if quotient else []
        elif any(reached):
            ratio = math.inf if reached[0] else 0.0
            found.append(Quotient(ratio, ratio, ratio, 1.0))
    if not found:
        return Duel(None, why=why)
    least = max(q.least for q in found)
    ends = min(q.low for q in found), max(q.high for q in found)
    whole = Quotient(statistics.median(q.value for q in found), *ends, least)
    return Duel(whole.value, whole.low, whole.high, whole.differs)


def _samples(record: Record, cost: str) -> Samples:
    """Samples of a cost by round; a count is one."""
    if COSTS[cost].is_time:
        return by_round(record)
    return {0: value} if (value := record.cost(cost)) else {}


def _quotient(one: _Line, two: _Line, question: Question) -> tuple[Quotient | None, str]:
    """Cost of two over that of one where both reach the accuracy; the reason if there is none."""
    priced = [[(e, s) for e, s in line if s] for line in (one, two)]
    a, b = (_cost_at(line, question.target) for line in priced)
    if not a or not b:
        return None, "cost unknown"
    if COSTS[question.cost].is_time:
        found = quotient_by_round(a, b)
        if not found:
            return None, "single times"
    else:
        value = b[0] / a[0]
        found = Quotient(value, value, value, COSTS[question.cost].tie)
    # The coarsest run is better already: a coarser one would cost less.
    at_most = [line[0][0] < question.target for line in priced]
    if all(at_most):
        return None, "coarsest runs"
    low, high = 0.0 if at_most[1] else found.low, math.inf if at_most[0] else found.high
    return Quotient(found.value, low, high, found.least), ""


def _cost_at(line: _Line, target: float) -> Samples | None:
    """Samples of the least cost with which a line reaches the target."""
    found = [s for e, s in line if e <= target]
    for (e, s), (f, t) in pairwise(line):
        if min(e, f) < target < max(e, f):
            found.append(_between(s, t, math.log(target / e) / math.log(f / e)))
    return min(found, key=lambda s: statistics.median(s.values()), default=None)


def _between(one: Samples, two: Samples, part: float) -> Samples:
    """Samples between those of two runs, of common rounds; in rising order if there are none."""
    if common := [place for place in one if place in two]:
        return {k: one[k] ** (1 - part) * two[k] ** part for k in common}
    pairs = zip(sorted(one.values()), sorted(two.values()), strict=False)
    return {(id(one), k): a ** (1 - part) * b**part for k, (a, b) in enumerate(pairs)}


# ---- the table ---------------------------------------------------------------------------
class SideBySide(NamedTuple):
    """Sentences and plain data of two integrators, one per accuracy, and their table.

    The table has a row per scene and a column per accuracy; bold is a ratio beyond doubt.
    """

    sentences: list[str]
    table: Table
    plain: list[dict[str, Any]]


def side_by_side(
    one: str,
    two: str,
    folder: Path,
    *,
    group: str = FIRST.group,
    targets: Sequence[float] = (),
    cost: str | None = None,
    norm: str = NORM,
) -> SideBySide:
    """Compare two integrators of a run folder at several accuracies.

    They are named in short, as printed, or without options where that is unique. The question is a
    group, or several as "a,lam" for both at once, errors between 0 and 1, a norm, and a cost: that
    by which the results are ranked first if not given.

    Raises
    ------
    SpecError
        If a part of the question is another, or no scene has runs of both.
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    stored = stored_runs(folder)
    names = stored.names
    first, second = labels = _one_label(one, names), _one_label(two, names)
    group, norm = checked_group(group), one_of(norm, NORMS, "norm")
    cost = one_of(stored.first.cost if cost is None else cost, COSTS, "cost")
    if wrong := [t for t in targets if not 0 < t < 1]:
        raise SpecError(f"{wrong[0]:g} is no accuracy; give one between 0 and 1.")
    asked = [Question(group, target, cost) for target in targets or TABLE_TARGETS]
    columns = [versus(stored.series, labels, names, question, norm) for question in asked]
    quantity, scenes = asked[0].quantity, list(columns[0].duels)
    if not scenes:
        both = f"{names[first]} and {names[second]}"
        raise SpecError(f"{both} have no scene in common with an error in {quantity}.")
    rows = [[scene, *(c.shown(scene) for c in columns)] for scene in scenes]
    if len(scenes) > 1:
        rows.append(["median", *(c.median.text() if c.median else "" for c in columns)])
    cells = [(i, j) for i in range(len(scenes)) for j in range(len(columns))]
    table = Table(
        f"Cost of {names[second]} as a multiple of that of {names[first]} "
        f"({quantity}, {NORMS[norm]}; {COSTS[cost].words})",
        ["scene", *(question.accuracy for question in asked)],
        rows,
        best={(i, j + 1) for i, j in cells if columns[j].duels[scenes[i]].told_apart},
        note=f"Above 1 {names[first]} is cheaper; bold: beyond doubt. {_MEANING}",
    )
    plain = [
        {"first": first, "second": second, **asdict(c.question), "norm": norm}
        | {"sentence": c.sentence, "median": c.median, "p_value": c.p_value, "scenes": c.duels}
        for c in columns
    ]
    return SideBySide([c.sentence for c in columns], table, plain)


def _one_label(text: str, names: Mapping[str, str]) -> str:
    found = [text] if text in names else named_labels(text, names)
    # A name alone is that of the variant that is called so in short: ida is IDA, not IDA · index 1.
    found = [label for label in found if names[label].lower() == text.lower()] or found
    if len(found) > 1:
        raise SpecError(f"{text!r} are several; name one of {', '.join(found)}.")
    return found[0]
