"""Long runs in a table and in sentences: what drifts off, how far, and by what rule."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bench.results.drift import DRIFTS, RULE, Drift, LongRun, titled
from bench.results.table import Table
from reports.formatting import number, words
from reports.names import short_names

#: Verdicts in the order in which a sentence tells them, with its words.
_VERDICTS = {
    "none": "does not drift with",
    "bounded": "stays bounded with",
    "linear": "drifts linearly with",
    "neither": "drifts otherwise with",
}
_NOTE = (
    "Largest: absolute value, over the rows. Per s: slope of a straight line through all rows. "
    "Line: part of the variance that it explains. Halves: distance between the bands of both "
    f"halves, as a part of the whole band. Φ: the unit of the constraints. {RULE}"
)


def drift_table(runs: Sequence[LongRun]) -> Table:
    """A row for each integrator and quantity: largest value, trend, and what decides."""
    rows = []
    for run in runs:
        steps = "-" if run.steps is None else str(run.steps)
        steps = steps if run.status == "ok" else f"{steps} ({run.status})"
        for quantity, drift in run.measured:
            found = (drift.largest, drift.per_s, drift.straight, drift.apart)
            cells = [titled(quantity), steps, *map(number, found), drift.verdict]
            rows.append([run.integrator, *cells])
        if not run.measured:
            rows.append([run.integrator, "-", steps, *map(number, [None] * 4), "-"])
    head = ["integrator", "quantity", "steps", "largest", "per s", "line", "halves", "drift"]
    return Table("Largest drift, and its trend", head, rows, note=_NOTE)


def drift_sentences(runs: Sequence[LongRun]) -> Iterator[str]:
    """A sentence for each quantity: which methods hold it, and how others drift."""
    names = short_names(run.integrator for run in runs)
    for quantity, (name, unit) in DRIFTS.items():
        found = [(names[r.integrator], r.drifts[quantity]) for r in runs if quantity in r.drifts]
        parts = [
            f"{said} {words(f'{one} ({_size(drift, unit)})' for one, drift in own)}"
            for verdict, said in _VERDICTS.items()
            if (own := [(one, drift) for one, drift in found if drift.verdict == verdict])
        ]
        if parts:
            yield f"The {name} {'; it '.join(parts)}."
    for run in runs:
        if run.status != "ok":
            yield f"{names[run.integrator]} ended as {run.status}: {run.message}"


def _size(drift: Drift, unit: str) -> str:
    unit = "" if unit == "1" else f" {unit}"
    if drift.verdict == "linear":
        return f"{number(drift.per_s)}{unit} per s"
    return f"at most {number(drift.largest)}{unit}"
