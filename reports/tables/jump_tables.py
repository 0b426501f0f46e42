"""Tables of scenes whose values jump: events that were found, and policies at samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bench.results.quantities import NORM, NORMS, quantity
from bench.results.records import Record
from bench.results.table import Table
from reports.formatting import number
from reports.series import Series

#: The group by which policies are judged.
JUDGED = "q"


def miscounted(record: Record) -> bool:
    """Whether a run found another number of events than the reference."""
    return bool(record.events) and record.events["events"] != record.events["expected"]


def events_table(series: Sequence[Series]) -> Table | None:
    """The events of the finest run of each integrator; None if the runs have no events."""
    eventful = [s for s in series if any(r.events for r in s.ok)]
    rows = [
        [
            s.label,
            s.finest.resolution,
            f"{s.finest.events['events']:g} of {s.finest.events['expected']:g}",
            number(s.finest.events["time"]),
            f"{sum(map(miscounted, s.ok))} of {len(s.ok)}",
        ]
        for s in eventful
    ]
    note = "Times off: the largest difference from the time of the same event in the reference."
    head = ["integrator", "finest run", "events found", "times off in s"]
    head.append("runs with another number")
    return Table("Events", head, rows, note=note) if rows else None


def policies_table(by_policy: Mapping[str, Sequence[Series]]) -> Table:
    """The smallest error of each integrator by what its runs do at samples; there is one at least.

    Parameters
    ----------
    by_policy
        The series of the scene with each of `POLICIES` that was run.
    """
    runs = {name: {s.label: s for s in own} for name, own in by_policy.items()}
    labels = dict.fromkeys(label for own in runs.values() for label in own)
    rows = [[label, *(_nearest(own.get(label)) for own in runs.values())] for label in labels]
    note = (
        f"Smallest error in {quantity(JUDGED)} ({NORMS[NORM]}) and its run. ``hit``: a step ends "
        "at each sample; ``interpolate``: constant steps go over samples; ``ignore``: the "
        "controller is called wherever the method evaluates the equations."
    )
    head = ["integrator", *(f"sampling={name}" for name in runs)]
    return Table("Errors by what runs do at samples", head, rows, note=note)


def _nearest(s: Series | None) -> str:
    """The smallest error with its run, and whether every run is wrong; else how runs ended."""
    if s is None:
        return "not tried"
    if not (near := s.nearest(JUDGED)):
        return s.statuses
    wrong = " (wrong)" if s.never_right(JUDGED) else ""
    return f"{number(near[0])}{wrong} at {near[1].resolution.partition(',')[0]}"
