"""Differences of two run folders, as typed records with sentences."""

from __future__ import annotations

import math
from collections import defaultdict

import msgspec

from bench.results.quantities import NORM, NORMS
from bench.results.timings import LEAST_QUOTIENT

#: Ratios up to these are no change: rounding, exact counts, and the precision of clocks.
LEAST_CHANGE = {"error": 1.001, "work": 1.0, "time": LEAST_QUOTIENT}


class ComparedCell(msgspec.Struct, kw_only=True, frozen=True):
    """A cell and how it ended; ``scene`` tells its interval where there are several."""

    key: str
    scene: str
    integrator: str
    resolution: str
    status: str
    message: str = ""

    def __str__(self) -> str:
        return f"{self.integrator} on {self.scene}, {self.resolution}"


class ChangedStatus(msgspec.Struct, kw_only=True, frozen=True):
    """A cell whose status changed; ``before`` is the old one."""

    run: ComparedCell
    before: str

    def __str__(self) -> str:
        why = f": {self.run.message}" if self.run.message else ""
        return f"{self.run}: {self.before} -> {self.run.status}{why}"


class Change(msgspec.Struct, kw_only=True, frozen=True):
    """One number of a cell that changed.

    ``name`` is the group, the count or "seconds". ``ratio`` is new over old: infinite if an error
    is no number any more, None if it cannot be said (a count that one of the two lacks).
    """

    run: ComparedCell
    kind: str
    name: str
    norm: str = ""
    old: float | None
    new: float | None
    ratio: float | None
    comparable: bool = True

    @property
    def worse(self) -> bool:
        """Whether the number rose, or is none any more."""
        return self.ratio is not None and self.ratio > 1.0

    def __str__(self) -> str:
        what = " ".join(filter(None, (self.kind, self.name, self.norm)))
        return f"{self.run}: {what} {shown(self.old)} -> {shown(self.new)} ({factor(self.ratio)})"


class Comparison(msgspec.Struct, kw_only=True, frozen=True):
    """All differences of two run folders.

    ``differences`` name machines and versions, ``edited`` counts the shared cells whose source
    differs, ``untold`` those whose times cannot be compared for want of two samples each. Ratios
    of times up to ``noise`` are no change: so far apart are samples of one run, or the times of
    runs whose source is the same. ``judged`` counts the shared cells that reached the
    end in both, by scene and integrator.
    """

    old: str
    new: str
    shared: int
    edited: int
    untold: int
    noise: float
    judged: dict[str, int]
    differences: list[str]
    endings: list[ChangedStatus]
    changes: list[Change]
    vanished: list[ComparedCell]
    appeared: list[ComparedCell]

    @property
    def same(self) -> bool:
        """Whether all measured values are the same."""
        return not (self.endings or self.changes or self.vanished or self.appeared)

    def state(self) -> list[str]:
        """Say in sentences how much was compared, and under which conditions."""
        said = [
            f"{self.shared} runs are in both; {len(self.vanished)} only in {self.old}, "
            f"{len(self.appeared)} only in {self.new}."
        ]
        if self.edited:
            said.append(f"Of {self.edited} of them the source was edited in between.")
        if self.differences:
            said.append(
                f"Machine or versions differ ({'; '.join(self.differences)}): times are not "
                "comparable, and no time is a regression."
            )
        if self.untold:
            said.append(f"Times of {self.untold} runs are not compared: they need two samples.")
        if self.noise > LEAST_CHANGE["time"]:
            said.append(
                f"The machine was noisy: times that differ by less than {factor(self.noise)} are "
                "not told apart."
            )
        if self.same:
            said.append("Nothing changed.")
        elif self.shared and not (self.endings or self.changes):
            said.append("Nothing changed in the runs that are in both.")
        return said + self.judgement()

    def judgement(self) -> list[str]:
        """Say per kind of number which groups are worse and better, and name the worst one.

        Errors are judged in the default norm.
        """
        said = []
        for kind in LEAST_CHANGE:
            by_name: defaultdict[str, list[Change]] = defaultdict(list)
            for c in self.changes:
                if c.kind == kind and c.norm in ("", NORM) and c.ratio is not None:
                    by_name[c.name].append(c)
            if not by_name:
                continue
            parts = []
            for name, changes in by_name.items():
                worse = sum(c.worse for c in changes)
                counts = {"worse": worse, "better": len(changes) - worse}
                parts.append(f"{name} {', '.join(f'{n} {how}' for how, n in counts.items() if n)}")
            norm = f" ({NORMS[NORM]})" if kind == "error" else ""
            worst = max((c for own in by_name.values() for c in own), key=lambda c: c.ratio or 0.0)
            named = f"Worst: {worst}." if worst.worse else "Nothing is worse."
            count = sum(self.judged.values())
            said.append(f"{kind.capitalize()}{norm}, of {count} runs: {'; '.join(parts)}. {named}")
        return said

    def summary(self) -> list[str]:
        """List the changes, a line per integrator, scene and quantity, the worst first.

        What is worse and what is better have a line each.
        """
        groups: defaultdict[tuple[str, str, str, bool], list[Change]] = defaultdict(list)
        for c in self.changes:
            groups[f"{c.run.integrator} on {c.run.scene}", c.kind, c.name, c.worse].append(c)
        lines = []
        for (who, kind, name, _), changes in groups.items():
            ratios = [c.ratio for c in changes if c.ratio is not None]
            ends = dict.fromkeys(map(factor, (min(ratios), max(ratios)) if ratios else (None,)))
            count = len({c.run.key for c in changes})
            what = kind if kind == "time" else f"{kind} ({name})"
            said = f"{who}: {what} {' to '.join(ends)} in {count} of {self.judged[who]} runs"
            if not all(c.comparable for c in changes):
                said += ", not comparable"
            lines.append((list(LEAST_CHANGE).index(kind), -max(ratios, default=1.0), said))
        return [*map(str, self.endings), *(said for *_, said in sorted(lines))]


def factor(ratio: float | None) -> str:
    """Return a ratio in words."""
    if ratio is None:
        return "counted in one of the two"
    return f"x{ratio:.4g}" if math.isfinite(ratio) else "without bound"


def shown(value: float | None) -> str:
    """Return a count as it is, another number with four digits."""
    if value is None:
        return "no number"
    return str(value) if isinstance(value, int) else f"{value:.4g}"
