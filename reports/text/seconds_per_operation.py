"""Sentences on integrators whose seconds and operations disagree, with the reason."""

from __future__ import annotations

from collections.abc import Sequence

from bench.results.records import Record, median
from reports.formatting import number, number_range, words
from reports.series import Series, cost_of, seconds_of

#: Seconds per operation further from the scene's median than this factor are explained.
FAR = 3.0


def seconds_per_operation(record: Record) -> float | None:
    """Median seconds of a run over its operations; None if one of them is not known."""
    seconds, operations = seconds_of(record), cost_of(record, "operations")
    return seconds / operations if seconds and operations else None


def disagreements(series: Sequence[Series]) -> list[str]:
    """Sentences on integrators far from the median, and on runs that are mostly fixed costs.

    An integrator is judged by its finest run, in which fixed costs weigh least.
    """
    known = [(s, each) for s in series if s.ok and (each := seconds_per_operation(s.finest))]
    middle = median([each for _, each in known])
    if middle is None or len(known) < 2:
        return []
    found = [f"Median time per operation: {number(middle * 1e9)} ns."]
    far: dict[tuple[bool, str], list[tuple[str, float]]] = {}
    for s, each in known:
        if not 1 / FAR <= each / middle <= FAR:
            key = each > middle, s.finest.calls or "how it calls the equations is not stated"
            far.setdefault(key, []).append((s.label, each / middle))
    for (slow, calls), members in far.items():
        factors = number_range(factor if slow else 1 / factor for _, factor in members)
        relation = "more" if slow else "less"
        names = words(label for label, _ in members)
        found.append(f"{names}: {factors} times {relation}; {calls}.")
    short = [s.label for s, each in known if _fixed(s) > FAR * each]
    if short:
        found.append(
            f"Fixed costs of short runs: an operation of the coarsest run takes more than {FAR:g} "
            f"times as long as one of the finest with {words(short)}."
        )
    return found if len(found) > 1 else []


def _fixed(s: Series) -> float:
    """Seconds per operation of the coarsest run."""
    return seconds_per_operation(s.ok[0]) or 0.0
