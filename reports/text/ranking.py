"""Who reaches which accuracy at what cost: the figures behind the verdict on top of the page.

A standing is the cheapest run of one integrator on one scene that reaches a target, in one
measure of cost. A target that lies within a hundred times the reference's own error is not judged.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from bench.results import quantities
from bench.results.records import Record
from reports.series import TRUST, Series, error_of, floor_of, milliseconds, seconds_of, words

#: Groups, relative errors (largest over all times) and costs that are judged.
JUDGED = ("q", "a", "lam")
TARGETS = (1e-2, 1e-4, 1e-6)
COSTS = {cost: quantities.COSTS[cost] for cost in ("seconds", "residuals")}
LEAST = {"seconds": "least time", "residuals": "fewest residual evaluations"}


@dataclass(frozen=True)
class Standing:
    """One integrator on one scene against one target.

    ``reached`` says whether it gets there, ``run`` is the cheapest run that does and whose cost is
    known, ``ratio`` that cost relative to the cheapest of all.
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


def cost_of(record: Record, cost: str) -> float | None:
    """What a run cost, in seconds or in counts."""
    return seconds_of(record) if cost == "seconds" else record.work.get(cost)


def reaches(record: Record, group: str, target: float) -> bool:
    """Whether the largest error of a group is no larger than the target."""
    error = error_of(record, group, "max")
    return error is not None and error <= target


def standings(scenes: Mapping[str, Sequence[Series]]) -> list[Standing]:
    """Every integrator of every scene against every target and cost that can be judged."""
    found = []
    for scene, series in scenes.items():
        runs = [r for s in series for r in s.ok]
        for group in JUDGED:
            if not any(group in r.errors for r in runs):
                continue
            floor = floor_of(runs, group, "max")
            for target in TARGETS:
                if TRUST * floor > target:
                    continue
                for cost in COSTS:
                    found += _ranked(scene, series, group, target, cost)
    return found


def _ranked(
    scene: str, series: Sequence[Series], group: str, target: float, cost: str
) -> list[Standing]:
    cheapest: dict[str, tuple[float, Record]] = {}
    for s in series:
        able = [(v, r) for r in s.ok if reaches(r, group, target) and (v := cost_of(r, cost))]
        if able:
            cheapest[s.label] = min(able, key=lambda pair: pair[0])
    best = min((value for value, _ in cheapest.values()), default=None)
    ranked = []
    for s in series:
        value, run = cheapest.get(s.label, (None, None))
        reached = any(reaches(r, group, target) for r in s.ok)
        ratio = value / best if value is not None else None
        ranked.append(Standing(scene, s.label, group, target, cost, reached, run, value, ratio))
    return ranked


@dataclass(frozen=True)
class Verdict:
    """Who wins on one scene by each cost, in words, and the keys of the records behind them."""

    scene: str
    by: dict[str, str]
    keys: dict[str, list[str]]


def verdicts(found: Iterable[Standing], group: str = "a", target: float = 1e-4) -> list[Verdict]:
    """For each scene: who reaches the target for the least time and the fewest evaluations.

    A rival whose timing samples overlap the winner's is a tie. A scene with one integrator has
    nobody to win against.
    """
    by_scene: dict[str, dict[str, list[Standing]]] = {}
    for s in found:
        if (s.group, s.target) == (group, target):
            by_scene.setdefault(s.scene, {}).setdefault(s.cost, []).append(s)
    said = []
    for scene, costs in by_scene.items():
        if max(len(all_of) for all_of in costs.values()) < 2:
            continue
        by, keys = {}, {}
        for cost, all_of in costs.items():
            ranked = sorted((s for s in all_of if s.run), key=lambda s: s.value)
            by[cost], used = _winner(ranked, cost)
            if not ranked and any(s.reached for s in all_of):
                by[cost] = "not measured"
            keys[cost] = [s.run.key for s in used]
        said.append(Verdict(scene, by, keys))
    return said


def _winner(ranked: Sequence[Standing], cost: str) -> tuple[str, list[Standing]]:
    if not ranked:
        return "nobody", []
    best, *others = ranked
    if cost == "seconds":
        tied = [s for s in others if min(s.run.run_s) <= max(best.run.run_s)]
        shown = f"{milliseconds(best.value)} ms"
    else:
        tied = [s for s in others if s.value == best.value]
        shown = f"{best.value:g}"
    if tied:
        return f"{words(s.label for s in [best, *tied[:2]])} tie ({shown})", [best, *tied[:2]]
    if not others:
        return f"{best.label} alone ({shown})", [best]
    return f"{best.label} ({shown}; next: {others[0].label}, {others[0].ratio:.3g} times)", [
        best,
        others[0],
    ]


def overall(found: Iterable[Standing], group: str = "a", target: float = 1e-4) -> list[str]:
    """How often each integrator is the cheapest, and who reaches the target on most scenes."""
    mine = [s for s in found if (s.group, s.target) == (group, target)]
    scenes = {s.scene for s in mine}
    if len(scenes) < 2:
        return []
    said = []
    for cost, name in LEAST.items():
        wins = Counter(s.label for s in mine if s.cost == cost and s.ratio == 1.0)
        if wins:
            (_, most), *_ = wins.most_common(1)
            first = [label for label, n in wins.items() if n == most]
            said.append(
                f"{name.capitalize()} on most scenes ({most} of {len(scenes)}): {words(first)}."
            )
    able = Counter(s.label for s in mine if s.cost == "residuals" and s.reached)
    if able:
        most = max(able.values())
        said.append(
            f"Reached on {most} of {len(scenes)} scenes by "
            f"{words(label for label, n in able.items() if n == most)}."
        )
    return said
