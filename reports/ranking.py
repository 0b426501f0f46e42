"""Integrators ranked on each scene by the cost of the cheapest run that reaches an accuracy.

A target that lies within a hundred times the reference's own error is left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bench.results.quantities import COST_NAMES
from bench.results.records import Record
from reports.series import Series, cost_of, error_of, ok_runs, trusted_error

#: Groups, relative errors (largest over all times) and costs by which integrators are ranked.
RANKED_GROUPS = ("q", "a", "lam")
TARGETS = (1e-2, 1e-4, 1e-6)
RANKED_COSTS = {cost: COST_NAMES[cost] for cost in ("seconds", "residuals")}
LEAST_COST = {"seconds": "least time", "residuals": "fewest residual evaluations"}
#: Group, target and cost of a page before a reader chooses others.
GROUP, TARGET, COST = "a", 1e-4, "residuals"


@dataclass(frozen=True)
class RankEntry:
    """One integrator on one scene for one target.

    ``reached`` says whether a run reaches the target, ``run`` is the cheapest of those whose cost
    is known, ``value`` its cost, ``ratio`` that cost relative to the cheapest integrator's.
    """

    scene: str
    label: str
    group: str
    target: float
    cost: str
    reached: bool = False
    run: Record | None = None
    value: float | None = None
    ratio: float | None = None


def reaches(record: Record, group: str, target: float) -> bool:
    """Whether the largest error of a group is no larger than the target."""
    error = error_of(record, group, "max")
    return error is not None and error <= target


def rank(scenes: Mapping[str, Sequence[Series]]) -> list[RankEntry]:
    """Rank the integrators of every scene for every target and cost that can be judged."""
    entries = []
    for scene, series in scenes.items():
        runs = ok_runs(series)
        for group in RANKED_GROUPS:
            if not any(group in r.errors for r in runs):
                continue
            for target in TARGETS:
                if trusted_error(runs, group, "max") > target:
                    continue
                for cost in RANKED_COSTS:
                    entries += _entries(scene, series, group, target, cost)
    return entries


def _entries(
    scene: str, series: Sequence[Series], group: str, target: float, cost: str
) -> list[RankEntry]:
    cheapest: dict[str, tuple[float, Record]] = {}
    for s in series:
        able = [(v, r) for r in s.ok if reaches(r, group, target) and (v := cost_of(r, cost))]
        if able:
            cheapest[s.label] = min(able, key=lambda pair: pair[0])
    best = min((value for value, _ in cheapest.values()), default=None)
    entries = []
    for s in series:
        value, run = cheapest.get(s.label, (None, None))
        reached = any(reaches(r, group, target) for r in s.ok)
        ratio = value / best if value is not None and best is not None else None
        entries.append(RankEntry(scene, s.label, group, target, cost, reached, run, value, ratio))
    return entries
