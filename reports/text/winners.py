"""Sentences about the cheapest integrators, on each scene and over all scenes."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from bench.results.records import Record
from reports.formatting import milliseconds, named, number
from reports.ranking import (
    GROUP,
    LEAST_COST,
    TARGET,
    RankEntry,
    accuracy_text,
    several_contestants,
    told_apart,
)


@dataclass(frozen=True)
class Verdict:
    """The cheapest contestants of one scene by one cost.

    ``first`` are those that cannot be told apart from the cheapest, itself included; ``second``
    is the cheapest of the others; ``unknown`` reach the target at a cost that is not measured;
    ``compared`` counts the contestants with a cost, and those that do not reach the target.
    ``names`` are the labels of the integrators that are one contestant, by the first of them.
    """

    scene: str
    cost: str
    first: list[RankEntry]
    second: RankEntry | None
    unknown: list[RankEntry]
    compared: int
    names: dict[str, list[str]]

    @property
    def votes(self) -> bool:
        """Whether there was something to win: several contestants were compared."""
        return self.compared > 1

    @property
    def runs(self) -> list[Record]:
        """The runs behind the verdict."""
        shown = [*self.first, self.second] if len(self.first) == 1 else self.first
        return [s.run for s in shown if s and s.run]

    def name_of(self, entry: RankEntry) -> str:
        """The contestant with the integrators that do the same on the scene: 'a = b'."""
        return " = ".join(self.names[entry.label])

    @property
    def text(self) -> str:
        """The verdict in words."""
        if not self.first:
            return "not measured" if self.unknown else "nobody reaches it"
        least = min((s.value for s in self.first if s.value is not None), default=None)
        shown = cost_text(least, self.cost)
        labels = [self.name_of(s) for s in self.first]
        if len(labels) > 1:
            said = f"{named(labels)} tie ({shown})"
        elif self.second:
            second = self.name_of(self.second)
            said = f"{labels[0]} ({shown}; next: {second}, {_times(self.second.ratio)})"
        elif self.unknown:
            said = f"{labels[0]} ({shown})"
        else:
            said = f"{labels[0]} alone reaches it ({shown})"
        if self.unknown:
            said += f"; not measured: {named(map(self.name_of, self.unknown))}"
        return said


def cost_text(value: float | None, cost: str) -> str:
    """A cost with its unit; counts as they are."""
    if cost == "seconds":
        return f"{milliseconds(value)} ms"
    return number(value) if cost == "operations" else f"{value:g}"


def _times(ratio: float | None) -> str:
    """A ratio with as many digits as tell it from 1."""
    ratio = math.nan if ratio is None else ratio
    return f"{ratio:.3g} times" if ratio >= 1.01 else f"{ratio:.6g} times"


def verdicts(
    entries: Iterable[RankEntry], group: str = GROUP, target: float = TARGET
) -> dict[str, dict[str, Verdict]]:
    """The verdicts on each scene with several contestants, by scene and cost."""
    entries = [s for s in entries if (s.group, s.target) == (group, target)]
    several = several_contestants(entries)
    found: dict[str, dict[str, Verdict]] = {}
    cases: dict[tuple[str, str], list[RankEntry]] = {}
    for s in entries:
        if s.scene in several:
            cases.setdefault((s.scene, s.cost), []).append(s)
    for (scene, cost), case in cases.items():
        found.setdefault(scene, {})[cost] = _verdict(scene, cost, case)
    return found


def _verdict(scene: str, cost: str, case: Sequence[RankEntry]) -> Verdict:
    alike: dict[str, list[str]] = {}
    for s in case:
        alike.setdefault(s.contestant, []).append(s.label)
    own = [s for s in case if s.label == s.contestant]
    unknown = [s for s in own if s.reached and s.value is None]
    ranked = sorted((s for s in own if s.value is not None), key=lambda s: s.value or 0.0)
    # In the order of the plan: the medians of those who tie change places from run to run.
    first = [s for s in own if s in ranked and not _apart(ranked[0], s, cost)]
    second = next((s for s in ranked if s not in first), None)
    return Verdict(scene, cost, first, second, unknown, len(own) - len(unknown), alike)


def _apart(one: RankEntry, two: RankEntry, cost: str) -> bool:
    return bool(one.run and two.run and told_apart(one.run, two.run, cost))


def overall(entries: Sequence[RankEntry], group: str = GROUP, target: float = TARGET) -> list[str]:
    """Sentences over all scenes: who is the cheapest on how many, and who reaches the target.

    A scene votes if several contestants can be compared on it. Wins and ties are counted per
    contestant, then per family, so that a family does not win by the number of its variants.
    """
    found = verdicts(entries, group, target)
    sentences = []
    for cost, least in LEAST_COST.items():
        case = [v for by_cost in found.values() if (v := by_cost[cost]).votes]
        head = f"{least.capitalize()} to {accuracy_text(group, target)}"
        if len(case) < 2:
            if len(found) > 1:
                unknown = sum(bool(by_cost[cost].unknown) for by_cost in found.values())
                where = f"{unknown} of {len(found)} scenes with several contestants"
                sentences.append(f"{head}: no verdict; on {where} it is reached at unknown cost.")
            continue
        standings = _standings(case) or "nobody reaches it"
        parts = [f"{head}, on {len(case)} scenes with several contestants: {standings}"]
        labels, families = {s.label for s in entries}, {s.family for s in entries}
        if 1 < len(families) < len(labels) and any(v.first for v in case):
            won = [dict.fromkeys(s.family for s in v.first) for v in case]
            parts.append(f"By family: {_counted(won)}")
        sentences.append(". ".join(parts + _without(case)) + ".")
    return sentences + _reached([s for s in entries if s.scene in found], group, target)


def _standings(case: Sequence[Verdict]) -> str:
    """Wins and ties per contestant, with the integrators that do the same on scenes it wins."""
    names: dict[str, dict[str, None]] = {}
    for v in case:
        for s in v.first:
            names.setdefault(s.label, {}).update(dict.fromkeys(v.names[s.label]))
    shown = {
        label: f"{label} (or {named(twins)}, where they do the same)" if twins else label
        for label, (_, *twins) in names.items()
    }
    return _counted([[shown[s.label] for s in v.first] for v in case])


def _counted(first: Sequence[Iterable[str]]) -> str:
    """'a alone cheapest on 2, tied on 1; b and c each tied on 1' from the first on each scene."""
    alone: Counter[str] = Counter()
    tied: Counter[str] = Counter()
    for names in map(list, first):
        (alone if len(names) == 1 else tied).update(names)
    alike: dict[tuple[int, int], list[str]] = {}
    for name in alone | tied:
        alike.setdefault((alone[name], tied[name]), []).append(name)
    parts = []
    for (wins, ties), names in sorted(alike.items(), reverse=True):
        counts = {"alone cheapest": wins, "tied": ties}
        how = ", ".join(f"{how} on {n}" for how, n in counts.items() if n)
        parts.append(f"{named(names)} {'each ' if len(names) > 1 else ''}{how}")
    return "; ".join(parts)


def _without(case: Sequence[Verdict]) -> list[str]:
    """Sentences about scenes without a winner, and about costs that are not measured."""
    said = []
    nobody = sum(not v.first and not v.unknown for v in case)
    if 0 < nobody < len(case):
        said.append(f"Nobody reaches it on {nobody}")
    if unknown := dict.fromkeys(v.names[s.label][0] for v in case for s in v.unknown):
        said.append(f"Left out, as their cost is not measured: {named(unknown)}")
    return said


def _reached(entries: Sequence[RankEntry], group: str, target: float) -> list[str]:
    """Who reaches the target on every scene on which it was tried; none for one scene."""
    tried: dict[str, dict[str, bool]] = {}
    for s in entries:
        if (s.group, s.target) == (group, target):
            tried.setdefault(s.label, {})[s.scene] = s.reached
    if len({scene for scenes in tried.values() for scene in scenes}) < 2:
        return []
    always = sorted(
        ((len(scenes), label) for label, scenes in tried.items() if all(scenes.values())),
        key=lambda found: -found[0],
    )
    aim = accuracy_text(group, target)
    if not always:
        return [f"No integrator reaches {aim} on every scene on which it was tried."]
    by_count: dict[int, list[str]] = {}
    for count, label in always:
        by_count.setdefault(count, []).append(label)
    who = "; ".join(
        f"on {f'all {count} scenes' if count > 1 else 'the one scene'} tried by {named(labels)}"
        for count, labels in by_count.items()
    )
    return [f"{aim[0].upper()}{aim[1:]} is reached {who}."]
