"""The cheapest integrators on one scene: who they are, and in words."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from bench.results.quantities import COSTS
from bench.results.records import Record
from bench.results.timings import LEVEL
from reports.formatting import milliseconds, named, number
from reports.ranking import (
    GROUP,
    TARGET,
    RankEntry,
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

    def worded(self, names: Mapping[str, str] = MappingProxyType({})) -> str:
        """The verdict with these names by label; integrators that do the same: 'a = b'."""

        def name_of(entry: RankEntry) -> str:
            return " = ".join(names.get(label, label) for label in self.names[entry.label])

        if not self.first:
            return "not measured" if self.unknown else "nobody reaches it"
        least = min((s.value for s in self.first if s.value is not None), default=None)
        shown = cost_text(least, self.cost)
        firsts = [name_of(s) for s in self.first]
        said = named(firsts)
        if len(firsts) > 1:
            said += f" tie ({shown})"
        else:
            run = self.first[0].run
            shown += f" at {run.resolution}" if run else ""
            if self.second:
                said += f" ({shown}; next: {name_of(self.second)}, {times(self.second.ratio)})"
            else:
                said += f" ({shown})" if self.unknown else f" alone reaches it ({shown})"
        if self.unknown:
            said += f"; not measured: {named(map(name_of, self.unknown))}"
        return said


def cost_text(value: float | None, cost: str) -> str:
    """A cost with its unit; counts as they are, operations with three digits."""
    if COSTS[cost].is_time:
        long = value is not None and value >= 1
        return f"{number(value)} s" if long else f"{milliseconds(value)} ms"
    if cost == "operations":
        for size, word in ((1e9, "billion"), (1e6, "million")):
            if value is not None and value >= size:
                return f"{number(value / size)} {word}"
        return number(value)
    return f"{value:g}"


def tie_text(cost: str) -> str:
    """The costs that cannot be told apart."""
    tie, is_time = COSTS[cost].tie, COSTS[cost].is_time
    if tie == 1.0:
        return "equal counts"
    said = f"{'times' if is_time else 'counts'} that differ by at most {100 * (tie - 1):.3g} %"
    if is_time:
        said += f", or by less than the {100 * LEVEL:.3g} % interval of their samples"
    return said


def times(ratio: float | None) -> str:
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
        found.setdefault(scene, {})[cost] = verdict(case)
    return found


def verdict(case: Sequence[RankEntry]) -> Verdict:
    """The verdict on one scene by one cost, from its entries; there is at least one."""
    scene, cost = case[0].scene, case[0].cost
    alike: dict[str, list[str]] = {}
    for s in case:
        alike.setdefault(s.contestant, []).append(s.label)
    own = [s for s in case if s.label == s.contestant]
    unknown = [s for s in own if s.reached and s.value is None]
    ranked = sorted((s for s in own if s.value is not None), key=lambda s: s.value or 0.0)
    # In the order of the plan: the medians of those who tie change places from run to run.
    best = ranked[0].run if ranked else None
    tied = {s.label for s in ranked if not (best and s.run and told_apart(best, s.run, cost))}
    first = [s for s in own if s.label in tied]
    second = next((s for s in ranked if s.label not in tied), None)
    return Verdict(scene, cost, first, second, unknown, len(own) - len(unknown), alike)
