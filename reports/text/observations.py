"""Sentences about a study, made from its records by rules: orders, tolerances, failures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

from bench.results.orders import Fit
from bench.results.records import UNSUPPORTED, Record
from reports.formatting import number, number_range, order_text, text_range, words
from reports.series import (
    Series,
    error_of,
    groups_of,
    ok_runs,
    reference_error,
    step_or_tolerance,
    trusted_error,
    whole_order,
)

#: Pairs (group, verdict on its order).
_Verdicts = tuple[tuple[str, str], ...]

_ORDINALS = ("zeroth", "first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth")
#: A sentence tells when the maximum over time loses this much of the order.
_LOSS = 0.5


@dataclass(frozen=True)
class Observation:
    """One sentence about the integrators named."""

    integrators: tuple[str, ...]
    text: str


def observations(series: Sequence[Series]) -> list[Observation]:
    """Observations of the fitted orders, the tolerances and the failures of one study.

    Integrators with the same orders share a sentence; their numbers become ranges.
    """
    alike: dict[Hashable, list[Series]] = {}
    for s in series:
        if s.controls == "step" and len(s.ok) >= 3 and groups_of(s.ok):
            alike.setdefault(_signature(s), []).append(s)
    found = [
        Observation(tuple(s.label for s in members), _order_sentence(members))
        for members in alike.values()
    ]
    for s in series:
        if s.controls == "tolerance" and len(s.ok) >= 2 and groups_of(s.ok):
            found.append(Observation((s.label,), _tolerance_sentence(s)))
    for s in series:
        if len(s.ok) < len(s.records):
            found.append(Observation((s.label,), _failure_sentence(s)))
    return found


# ---- orders ------------------------------------------------------------------------------
def _signature(s: Series) -> tuple[str, str, _Verdicts, _Verdicts]:
    """Formulation, norm, verdicts by group, verdicts of the groups that lose order in "max"."""
    norm, groups = _main_norm(s), groups_of(s.ok)
    orders = tuple((group, _verdict(s.fit(group, norm))) for group in groups)
    lost = tuple((g, _verdict(s.fit(g, "max"))) for g in groups if _loses(s, g, norm))
    return s.formulations, norm, orders, lost


def _main_norm(s: Series) -> str:
    """The norm "settled"; "max" where the runs are too short to settle."""
    settled = (any(error_of(r, g, "settled") is not None for r in s.ok) for g in groups_of(s.ok))
    return "settled" if all(settled) else "max"


def _verdict(fit: Fit) -> str:
    if fit.verdict != "converges" or fit.order is None:
        return fit.verdict
    whole = whole_order(fit)
    if whole and whole < len(_ORDINALS):
        return f"{_ORDINALS[whole]} order"
    return f"order {fit.order:.1f}"


def _loses(s: Series, group: str, norm: str) -> bool:
    """Whether the start transient lowers the order: "settled" converges faster than "max"."""
    settled, largest = s.fit(group, norm), s.fit(group, "max")
    if norm == "max" or settled.order is None or settled.verdict != "converges":
        return False
    if largest.verdict == "does not converge":
        return True
    return largest.order is not None and settled.order - largest.order >= _LOSS


def _order_sentence(members: Sequence[Series]) -> str:
    formulation, norm, orders, lost = _signature(members[0])
    by_verdict: dict[str, list[str]] = {}
    for group, verdict in orders:
        by_verdict.setdefault(verdict, []).append(group)
    verdicts = sorted(by_verdict, key=lambda v: (v == "not determined", v == "does not converge"))
    parts = []
    for verdict in verdicts:
        show = _fitted if "order" in verdict else _stuck
        parts.append(
            f"{verdict} in " + words(f"{g} ({show(members, g, norm)})" for g in by_verdict[verdict])
        )
    when = "in the last quarter" if norm == "settled" else "in the maximum over time"
    text = f"{when}, {'; '.join(parts)}."
    if lost:
        text += " The maximum over time "
        text += words(
            f"of the error in {g} "
            + (
                f"does not converge ({_stuck(members, g, 'max')})"
                if verdict == "does not converge"
                else f"is only {verdict} ({_fitted(members, g, 'max')})"
            )
            for g, verdict in lost
        )
        text += ": the start transient."
    points = (s.fit(g, norm).points for s in members for g, _ in orders)
    used = text_range(map(str, sorted(n for n in points if n)))
    used = f", orders fitted to the finest {used}" if used else ""
    return f"{text} ({formulation}; {_window(members)}{used})"


def _fitted(members: Sequence[Series], group: str, norm: str) -> str:
    orders = (s.fit(group, norm).order for s in members)
    return text_range(sorted(order_text(order) for order in orders if order is not None))


def _stuck(members: Sequence[Series], group: str, norm: str) -> str:
    """The errors at the coarsest and the finest step, for a group without an order."""
    ends = [number_range(error_of(s.ok[i], group, norm) for s in members) for i in (0, -1)]
    text = f"error {ends[0]} at the coarsest step, {ends[1]} at the finest"
    runs = ok_runs(members)
    finest = [e for s in members if (e := error_of(s.ok[-1], group, norm)) is not None]
    if finest and min(finest) <= trusted_error(runs, group, norm):
        text += f"; the reference's own error is {number(reference_error(runs, group, norm))}"
    return text


def _window(members: Sequence[Series]) -> str:
    steps = [step_or_tolerance(r) for r in ok_runs(members)]
    runs = text_range(map(str, sorted(len(s.ok) for s in members)))
    return f"{runs} steps h={number(max(steps))} to {number(min(steps))}"


# ---- tolerances and failures -------------------------------------------------------------
def _tolerance_sentence(s: Series) -> str:
    loose, tight = s.ok[0], s.ok[-1]
    parts = [
        f"{number(error_of(loose, g, 'max'))} to {number(error_of(tight, g, 'max'))} in {g}"
        for g in groups_of(s.ok)
        if g in ("q", "a", "lam", "x")
    ]
    return (
        f"from rtol={number(loose.rtol)} to {number(tight.rtol)} the largest error over time "
        f"goes from {words(parts)}. ({s.formulations}; {len(s.ok)} runs)"
    )


def _failure_sentence(s: Series) -> str:
    if all(record.status == UNSUPPORTED for record in s.records):
        return f"the method does not take the scene: {s.records[0].message}"
    failed: dict[str, list[Record]] = {}
    for record in s.records:
        if record.status != "ok":
            failed.setdefault(record.status, []).append(record)
    kinds = Counter(r.status for r in s.records if r.status != "ok")
    parts = [f"{n} {status} ({_where(failed[status])})" for status, n in kinds.items()]
    lost = len(s.records) - len(s.ok)
    return f"{lost} of {len(s.records)} runs did not reach the end: {words(parts)}."


def _where(records: Sequence[Record]) -> str:
    shown = [record.resolution for record in records[:3]]
    return "; ".join(shown) + (f"; and {len(records) - 3} more" if len(records) > 3 else "")
