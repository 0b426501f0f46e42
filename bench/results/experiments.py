"""Results of the experiments of the failure atlas: typed rows that are stored, and tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated

import msgspec
from msgspec import Meta

from bench.results.records import Name
from bench.results.table import Table, number


class CaseResult(msgspec.Struct, kw_only=True):
    """One case: its sweep (``x``, ``y``; None where there is no value), the number made of it, and
    whether that lies in the predicted interval (None: nothing was predicted, a method was added).

    ``healthy`` is None where there is no number; ``message`` says why, or how the first run failed.
    ``predicted`` bounds that are open are None. ``history`` holds t and the shown component.
    ``stopped`` says that a run was stopped by its budget or from outside: nothing was measured.
    """

    label: Name
    integrator: Name
    family: Name
    axis: Name
    x: list[float]
    y: list[float | None]
    number: float | None
    predicted: tuple[float | None, float | None] | None
    as_predicted: bool | None
    healthy: bool | None
    message: str = ""
    stopped: bool = False
    history: tuple[list[float], list[float]] | None = None

    @property
    def verdict(self) -> str:
        """Verdict on the method: the failure "spared" or "hit" it, or "does not apply"."""
        return {True: "spared", False: "hit", None: "does not apply"}[self.healthy]


class PartResult(msgspec.Struct, kw_only=True):
    """One number for several cases; ``quantity`` names the values of the sweeps."""

    text: Name
    quantity: Name
    take: Annotated[str, Meta(pattern="^(slope|growth|largest|last)$")]
    healthy: tuple[float | None, float | None]
    show: Name = ""
    cases: list[CaseResult] = []


class ExperimentResult(msgspec.Struct, kw_only=True):
    """An experiment with the results of its parts."""

    name: str
    number: int
    title: str
    claim: str
    remedy: str
    source: str
    parts: list[PartResult]
    digest: str = ""

    @property
    def as_predicted(self) -> bool:
        """Whether every predicted number was found."""
        return self.measured and not self._differs

    @property
    def measured(self) -> bool:
        """Whether no run was stopped by its budget or from outside."""
        return not any(case.stopped for part in self.parts for case in part.cases)

    @property
    def verdict(self) -> str:
        """Verdict on the prediction: "as predicted", "not as predicted" or "not measured"."""
        if self._differs:
            return "not as predicted"
        return "as predicted" if self.measured else "not measured"

    @property
    def _differs(self) -> bool:
        return any(case.as_predicted is False for part in self.parts for case in part.cases)


def bounds(interval: tuple[float | None, float | None]) -> str:
    """An interval in words."""
    low, high = interval
    if low is None or high is None:
        return (
            "any" if low is high else f"at least {low:g}" if high is None else f"at most {high:g}"
        )
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


def experiments_table(found: Sequence[ExperimentResult]) -> Table:
    """A row per experiment, with a column per method that was added."""
    added = list(
        dict.fromkeys(
            c.label for f in found for p in f.parts for c in p.cases if c.predicted is None
        )
    )
    rows = []
    for f in found:
        verdict = "DIFFERS" if f.verdict == "not as predicted" else f.verdict
        cases = [case for part in f.parts for case in part.cases]
        cells = [spared(c for c in cases if c.label == label) for label in added]
        rows.append([f"{f.number}. {f.title}", f"{verdict}, {predicted_counts(f)}", *cells])
    note = "Numbers that lie in the interval predicted for them, of all that were predicted."
    if added:
        note += " For a method that was added: the parts that spare it, of all that apply to it."
    head = ["failure", "verdict", *added]
    return Table("Where methods fail", head, rows, code=(), note=note)


def predicted_counts(f: ExperimentResult) -> str:
    """The count of numbers that came out as predicted: '3 of 4'."""
    cases = [case for part in f.parts for case in part.cases if case.predicted is not None]
    return f"{sum(bool(case.as_predicted) for case in cases)} of {len(cases)}"


def spared(cases: Iterable[CaseResult]) -> str:
    """The count of a method's cases that spare it, of those that apply to it: '2 of 3'."""
    judged = [c.healthy for c in cases if c.healthy is not None]
    return f"{sum(judged)} of {len(judged)}" if judged else "does not apply"


def part_table(part: PartResult) -> Table:
    """The number of each case beside its prediction."""
    how = {"slope": "power of the step, or of what is swept", "growth": "last over first",
           "largest": "largest of the sweep", "last": ""}[part.take]  # fmt: skip
    quantity_text = f"{part.quantity} ({how})" if how else part.quantity
    rows, best = [], set()
    for case in part.cases:
        verdict = {True: "as predicted", False: "DIFFERS", None: "-"}[case.as_predicted]
        verdict = "not measured" if case.stopped else verdict
        predicted = "-" if case.predicted is None else bounds(case.predicted)
        found = "none" if case.number is None else number(case.number)
        rows.append([case.label, found, predicted, verdict, case.verdict])
        if case.message:
            rows[-1][3] += f" ({case.message.split(';')[0].rstrip('.')})"
        if case.healthy:
            best.add((len(rows) - 1, 4))
    note = f"Measured: {quantity_text}. Spared is what lies within {bounds(part.healthy)}."
    head = ["", "found", "predicted", "verdict", "method"]
    named = all(case.label == case.integrator for case in part.cases)
    return Table(part.text, head, rows, best=best, code=(0,) if named else (), note=note)
