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
from bench.results.records import NOT_TRIED, counted
from bench.results.table import Table
from bench.results.timings import LEVEL, Quotient, Samples, by_round, median_interval, quotient
from problems.base.spec import SpecError, one_of
from reports.formatting import number
from reports.names import named_labels, scene_name
from reports.questions import FIRST, TABLE_TARGETS, Question, named
from reports.scenes import stored_runs
from reports.series import Series, ok_runs, reference_error

_MEANING = (
    "Costs at equal error are interpolated between runs. In brackets: the smallest and largest "
    "ratio from the start and later starts, with the intervals of times. For medians: the 95 % "
    "interval of the sign test, or the extremes of fewer than six scenes. 'At least', 'at most': "
    "the coarsest run of one has a smaller error, or only one reaches it from some starts. "
    "'Coarsest runs': both have. Not judged: below 100 times the reference's own error."
)
#: An error of zero has no logarithm; smaller ones are rounding.
_LEAST_ERROR = 1e-16
#: The errors of a line's runs and samples of their costs, from coarse to fine.
_Line = list[tuple[float, Samples]]


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
        ends = dict.fromkeys(map(number, (self.low, self.high)))
        return f"{number(self.ratio)}{unit}" + f" ({' to '.join(ends)})" * (len(ends) > 1)


@dataclass(frozen=True)
class Versus:
    """The duels of two integrators by scene, for one question; ``names`` are their short names."""

    question: Question
    names: tuple[str, str]
    duels: Mapping[str, Duel]

    def shown(self, scene: str) -> str:
        """The duel on a scene, as a table has it."""
        duel = self.duels[scene]
        only = duel.why if duel.ratio is None else f"only {self.names[duel.ratio == 0]}"
        return only if duel.known is None else duel.text()

    @property
    def wins(self) -> tuple[int, int]:
        """On how many scenes the first one is significantly cheaper, and the second."""
        apart = [d.ratio for d in self.duels.values() if d.told_apart and d.ratio is not None]
        return sum(r > 1 for r in apart), sum(r < 1 for r in apart)

    @property
    def p_value(self) -> float:
        """Two-sided sign test over the scenes on which the two are told apart."""
        less, more = sorted(self.wins)
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
        question, found, (one, two) = self.question, self.median, self.names
        goal = f"at {question.accuracy} in {question.quantity} ({NORMS[question.norm]})"
        judged = [k for k, d in self.duels.items() if d.ratio is not None]
        if not judged:
            why = named(f"{scene_name(k)} ({d.why})" for k, d in self.duels.items())
            return f"Nothing can be compared {goal}: {why}."
        said = f"By {COSTS[question.cost].words} {goal}: "
        if found and found.ratio:
            both = [k for k in judged if self.duels[k].known is not None]
            where = f"the median of {len(both)} scenes" if len(both) > 1 else scene_name(both[0])
            apart = ", not significant" * (found.low <= 1 <= found.high)
            said += f"{two} costs {found.text(' times')} as much as {one}, {where}{apart}; "
        said += f"{one} is significantly cheaper on {self.wins[0]} and {two} on {self.wins[1]} of "
        said += counted(len(judged), "scene")
        if len(judged) > 1:
            no, p = "not " * (self.p_value > 1 - LEVEL), f"p = {self.p_value:.2g}"
            said += f"; over all scenes {no}significant (sign test: {p})"
        return f"{said}."


def versus(
    scenes: Mapping[str, Sequence[Series]],
    labels: tuple[str, str],
    names: Mapping[str, str],
    question: Question,
) -> Versus:
    """Compare two integrators on all scenes on which both were tried and have the error."""
    duels = {}
    for scene, series in scenes.items():
        tried = [s for s in series if any(r.status not in NOT_TRIED for r in s.records)]
        own = {s.label: s for s in tried if s.label in labels}
        known = (r.error(question.group, question.norm) for r in ok_runs(own.values()))
        if len(own) == 2 and any(error is not None for error in known):
            duels[scene] = _duel([own[label] for label in labels], question)
    return Versus(question, (names[labels[0]], names[labels[1]]), duels)


def _duel(pair: Sequence[Series], question: Question) -> Duel:
    group, norm, target = question.group, question.norm, question.target
    runs, cost = ok_runs(pair), COSTS[question.cost]
    trusted = TRUST * reference_error(runs, group, norm)
    if target < trusted:
        return Duel(None, why="not judged")
    found, why = [], "neither reaches it"
    for start in range(1 + max(len(r.later) for r in runs)):
        lines: list[_Line] = []
        for s in pair:
            known = [(e, r) for r in s.ok if (e := r.error(group, norm, start)) is not None]
            samples: list[Samples] = [
                by_round(r) if cost.is_time else {0: value} if (value := r.cost(cost.name)) else {}
                for _, r in known
            ]
            errors = [max(e, trusted, _LEAST_ERROR) for e, _ in known]
            lines.append([*zip(errors, samples, strict=True)])
        reached = [any(e <= target for e, _ in line) for line in lines]
        if all(reached):
            whole, why = _quotient(lines, question)
            found += [whole] if whole else []
        elif any(reached):
            ratio = math.inf if reached[0] else 0.0
            found.append(Quotient(ratio, ratio, ratio, 1.0))
    if not found:
        return Duel(None, why=why)
    ends = min(q.low for q in found), max(q.high for q in found)
    whole = Quotient(statistics.median(q.value for q in found), *ends, max(q.least for q in found))
    return Duel(whole.value, whole.low, whole.high, whole.differs)


def _quotient(lines: Sequence[_Line], question: Question) -> tuple[Quotient | None, str]:
    """Cost of the second over that of the first where both reach it, or why there is none."""
    cost, priced = COSTS[question.cost], [[(e, s) for e, s in line if s] for line in lines]
    a, b = (_cost_at(line, question.target) for line in priced)
    if not a or not b:
        return None, "cost unknown"
    if cost.is_time:
        found = quotient(a, b)
    else:
        found = Quotient(b[0] / a[0], b[0] / a[0], b[0] / a[0], cost.tie)
    # The coarsest run is better already: a coarser one would cost less.
    at_most = [line[0][0] < question.target for line in priced]
    if not found or all(at_most):
        return None, "coarsest runs" if found else "single times"
    low, high = 0.0 if at_most[1] else found.low, math.inf if at_most[0] else found.high
    return found._replace(low=low, high=high), ""


def _cost_at(line: _Line, target: float) -> Samples | None:
    """Samples of the least cost with which a line reaches the target.

    Between two runs they are of common rounds; in rising order if there are none.
    """
    found = [s for e, s in line if e <= target]
    for (e, one), (f, two) in pairwise(line):
        if min(e, f) < target < max(e, f):
            part = math.log(target / e) / math.log(f / e)
            pairs = {place: (one[place], two[place]) for place in one if place in two}
            if not pairs:
                ordered = zip(sorted(one.values()), sorted(two.values()), strict=False)
                pairs = {(id(one), k): pair for k, pair in enumerate(ordered)}
            found.append({k: a ** (1 - part) * b**part for k, (a, b) in pairs.items()})
    return min(found, key=lambda s: statistics.median(s.values()), default=None)


# ---- the table ---------------------------------------------------------------------------
class SideBySide(NamedTuple):
    """Sentences and plain data of two integrators, one per accuracy, and their table.

    The table has a row per scene and a column per accuracy; bold is a significant ratio.
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
    asked = [Question(group, target, cost, norm) for target in targets or TABLE_TARGETS]
    columns = [versus(stored.series, labels, names, question) for question in asked]
    quantity, scenes = asked[0].quantity, list(columns[0].duels)
    if not scenes:
        both = f"{names[first]} and {names[second]}"
        raise SpecError(f"{both} have no scene in common with an error in {quantity}.")
    rows = [[scene, *(c.shown(scene) for c in columns)] for scene in scenes]
    if len(scenes) > 1:
        rows.append(["median", *(c.median.text() if c.median else "" for c in columns)])
    table = Table(
        f"Cost of {names[second]} as a multiple of that of {names[first]} "
        f"({quantity}, {NORMS[norm]}; {COSTS[cost].words})",
        ["scene", *(question.accuracy for question in asked)],
        rows,
        best={(i, j) for j, c in enumerate(columns, 1) for i, scene in enumerate(scenes)
              if c.duels[scene].told_apart},
        note=f"Above 1 {names[first]} is cheaper; bold: significant. {_MEANING}",
    )  # fmt: skip
    plain = [
        {"first": first, "second": second, **asdict(c.question)}
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
