"""Sentences about a study, made from its records by rules: failed runs, and dear or cheap times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bench.results.records import UNSUPPORTED, Record, median
from reports.formatting import named, number, number_range, words
from reports.series import Series

#: Seconds per operation further from the scene's median than this factor are explained.
FAR = 3.0


@dataclass(frozen=True)
class Observation:
    """One sentence about the integrators named."""

    integrators: tuple[str, ...]
    text: str


def observations(series: Sequence[Series]) -> list[Observation]:
    """Observations of the failures of one study, and of seconds that operations do not explain."""
    failed = [s for s in series if len(s.ok) < len(s.records)]
    found = [Observation((s.label,), _failure_sentence(s)) for s in failed]
    return found + _disagreements(series)


def _failure_sentence(s: Series) -> str:
    if all(record.status == UNSUPPORTED for record in s.records):
        return f"the method does not take the scene: {s.records[0].message}"
    lost: dict[str, list[str]] = {}
    for record in s.records:
        if record.status != "ok":
            lost.setdefault(record.status, []).append(record.resolution)
    parts = words(f"{len(own)} {status} ({named(own)})" for status, own in lost.items())
    count = sum(map(len, lost.values()))
    return f"{count} of {len(s.records)} runs did not reach the end: {parts}."


def seconds_per_operation(record: Record) -> float | None:
    """Median seconds of a run over its operations; None if one of them is not known."""
    seconds, operations = record.seconds, record.cost("operations")
    return seconds / operations if seconds and operations else None


def _disagreements(series: Sequence[Series]) -> list[Observation]:
    """Observations of integrators far from the median, and of runs that are mostly fixed costs.

    An integrator is judged by its finest run, in which fixed costs weigh least.
    """
    known = [(s, each) for s in series if s.ok and (each := seconds_per_operation(s.finest))]
    middle = median([each for _, each in known])
    if middle is None:
        return []
    stated: dict[str, list[float]] = {}
    for s, each in known:
        stated.setdefault(s.finest.calls, []).append(each)
    far: dict[tuple[bool, str], list[tuple[str, float]]] = {}
    for s, each in known:
        if not 1 / FAR <= each / middle <= FAR:
            slow, calls = each > middle, s.finest.calls
            # What others on the other side of the median state, too, is no cause.
            other = min(stated[calls]) < middle if slow else max(stated[calls]) > middle
            why = calls or "it does not state how it calls the equations"
            if calls and other:
                beside = "faster" if slow else "slower"
                why = f"no cause is known; {beside} ones state the same ({calls})"
            far.setdefault((slow, why), []).append((s.label, each / middle))
    found = [
        Observation(
            tuple(label for label, _ in members),
            f"in its finest run an operation takes {number_range(ratio for _, ratio in members)} "
            f"times the median of the integrators' finest runs ({number(middle * 1e9)} ns): {why}.",
        )
        for (_, why), members in far.items()
    ]
    short = tuple(s.label for s, _ in known if _mostly_fixed(s))
    if short:
        text = (
            f"an operation of the coarsest run takes more than {FAR:g} times as long as one of the "
            "finest, each in its fastest sample: the fixed costs of a run, such as its start."
        )
        found.append(Observation(short, text))
    return found


def _mostly_fixed(s: Series) -> bool:
    """Whether the coarsest run is dear for its operations, though it takes no longer than others.

    The fastest samples are compared: what slows down a single short run is no fixed cost.
    """
    timed = [r for r in s.ok if r.run_s and r.cost("operations")]
    if len(timed) < 2 or min(timed[0].run_s) > min(min(r.run_s) for r in timed[1:]):
        return False
    coarse, fine = (min(r.run_s) / (r.cost("operations") or 1) for r in (timed[0], timed[-1]))
    return coarse > FAR * fine
