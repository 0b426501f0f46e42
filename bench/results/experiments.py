"""Results of the experiments of the failure atlas: typed rows that are stored, and tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated

import msgspec
from msgspec import Meta

from bench.results.records import Name
from bench.results.table import Table, number

#: Bases of numbers that are expected, and the verdict on a number found that is so.
BASES = {
    "theory": "as predicted",
    "publication": "as predicted",
    "measurement": "as measured earlier",
}


class Expected(msgspec.Struct):
    """The interval in which a number is expected, its basis, a key of `BASES`, the ``formula`` of
    the number or of the bounds, empty if these are plain numbers, and the reason in words."""

    bounds: tuple[float, float]
    basis: Annotated[str, Meta(pattern=f"^({'|'.join(BASES)})$")]
    formula: str
    why: str


class CaseResult(msgspec.Struct, kw_only=True):
    """One case: its sweep (``x``, ``y``; None where there is no value), the number made of it, and
    whether that lies in the interval expected (None: nothing was expected, a method was added).

    ``healthy`` is None where there is no number; ``message`` says why, or how the first run failed.
    ``history`` holds t and the shown component. ``stopped`` says that a run was stopped by its
    budget or from outside: nothing was measured.
    """

    label: Name
    integrator: Name
    family: Name
    axis: Name
    x: list[float]
    y: list[float | None]
    number: float | None
    expected: Expected | None
    as_expected: bool | None
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
        """Whether every number was found as expected."""
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
        return any(case.as_expected is False for part in self.parts for case in part.cases)


def bounds(interval: tuple[float | None, float | None]) -> str:
    """An interval in words."""
    low, high = ("" if end is None else number(end) for end in interval)
    if not low or not high:
        return f"at least {low}" if low else f"at most {high}" if high else "any"
    return low if low == high else f"{low} to {high}"


def experiments_table(found: Sequence[ExperimentResult]) -> Table:
    """A row per experiment, with a column per method that was added."""
    added = list(
        dict.fromkeys(
            c.label for f in found for p in f.parts for c in p.cases if c.expected is None
        )
    )
    rows = []
    for f in found:
        differs = {"not as predicted": "DIFFERS: ", "not measured": "not measured: "}
        cases = [case for part in f.parts for case in part.cases]
        cells = [spared(c for c in cases if c.label == label) for label in added]
        said = differs.get(f.verdict, "") + expected_counts(f)
        rows.append([f"{f.number}. {f.title}", said, *cells])
    note = "Numbers found where theory, a publication or an earlier measurement says, of all."
    if added:
        note += " For a method that was added: the parts that spare it, of all that apply to it."
    head = ["failure", "verdict", *added]
    return Table("Where methods fail", head, rows, code=(), note=note)


def expected_counts(f: ExperimentResult) -> str:
    """The count of numbers found as expected: "5 of 6 as expected"."""
    held = [bool(c.as_expected) for part in f.parts for c in part.cases if c.expected]
    return f"{sum(held)} of {len(held)} as expected"


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
        expected, verdict = case.expected, "not measured" if case.stopped else "-"
        if expected and not case.stopped:
            verdict = BASES[expected.basis] if case.as_expected else "DIFFERS"
        found = "none" if case.number is None else number(case.number)
        where = [bounds(expected.bounds), expected.basis] if expected else ["-", "-"]
        rows.append([case.label, found, *where, verdict])
        if case.message:
            rows[-1][-1] += f" ({case.message.split(';')[0].rstrip('.')})"
        rows[-1].append(case.verdict)
        if case.healthy:
            best.add((len(rows) - 1, 5))
    note = f"Measured: {quantity_text}. Spared is what lies within {bounds(part.healthy)}."
    told = [(case.label, case.expected) for case in part.cases if case.expected]
    texts = [e.why for _, e in told] + [f"{label}: {e.formula}" for label, e in told if e.formula]
    if why := "; ".join(filter(None, dict.fromkeys(texts))):
        note += f" Expected: {why}."
    head = ["", "found", "expected", "basis", "verdict", "method"]
    named = all(case.label == case.integrator for case in part.cases)
    return Table(part.text, head, rows, best=best, code=(0,) if named else (), note=note)
