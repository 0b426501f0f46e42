"""Tables of the failure atlas: verdicts of all experiments, numbers of each."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from bench.results.experiments import CaseResult, ExperimentResult, PartResult, bounds
from bench.results.table import Table
from reports.formatting import number


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
