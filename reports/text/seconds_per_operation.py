"""Observations of integrators whose seconds and operations disagree, with the reason."""

from __future__ import annotations

from collections.abc import Sequence

from bench.results.records import Record, median
from reports.formatting import number, number_range
from reports.series import Series, cost_of, seconds_of
from reports.text.observations import Observation

#: Seconds per operation further from the scene's median than this factor are explained.
FAR = 3.0


def seconds_per_operation(record: Record) -> float | None:
    """Median seconds of a run over its operations; None if one of them is not known."""
    seconds, operations = seconds_of(record), cost_of(record, "operations")
    return seconds / operations if seconds and operations else None


def disagreements(series: Sequence[Series]) -> list[Observation]:
    """Observations of integrators far from the median, and of runs that are mostly fixed costs.

    An integrator is judged by its finest run, in which fixed costs weigh least.
    """
    known = [(s, each) for s in series if s.ok and (each := seconds_per_operation(s.finest))]
    middle = median([each for _, each in known])
    if middle is None:
        return []
    far: dict[tuple[bool, str], list[tuple[str, float]]] = {}
    for s, each in known:
        if not 1 / FAR <= each / middle <= FAR:
            key = each > middle, s.finest.calls or "it does not state how it calls the equations"
            far.setdefault(key, []).append((s.label, each / middle))
    found = []
    for (slow, calls), members in far.items():
        factors = number_range(factor if slow else 1 / factor for _, factor in members)
        times = f"{factors} times the" if slow else f"the {factors}th part of the"
        text = (
            f"in its finest run an operation takes {times} median of the integrators' finest runs "
            f"({number(middle * 1e9)} ns): {calls}."
        )
        found.append(Observation(tuple(label for label, _ in members), text))
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
    timed = [r for r in s.ok if r.run_s and cost_of(r, "operations")]
    if len(timed) < 2 or min(timed[0].run_s) > min(min(r.run_s) for r in timed[1:]):
        return False
    coarse, fine = (min(r.run_s) / (cost_of(r, "operations") or 1) for r in (timed[0], timed[-1]))
    return coarse > FAR * fine
