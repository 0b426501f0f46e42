"""Tables of scenes whose values jump: events that were found, and policies at samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bench.results.quantities import IMPACTS, NORM, NORMS, quantity
from bench.results.records import Record, SceneRecord
from bench.results.table import Table
from reports.formatting import NO_VALUE, number
from reports.series import Series

#: The group by which policies are judged.
JUDGED = "q"
#: Policies at samples (`problems.sampled.POLICIES`) in the order of the columns.
POLICIES = ("hit", "interpolate", "ignore")


def policy(scene: SceneRecord | None) -> str:
    """The policy of a scene's runs at samples; nothing if no controller is sampled."""
    own = scene.parameters if scene else ()
    found = next((p["value"] for p in own if p["name"] == "sampling"), "")
    return found if found in POLICIES else ""


def miscounted(record: Record) -> bool:
    """Whether a run found another number of events than the reference."""
    return bool(record.events) and record.events["events"] != record.events["expected"]


def events_table(series: Sequence[Series]) -> Table | None:
    """The events of the finest run of each integrator; None if the runs have no events."""
    rows = []
    for s in series:
        if not any(r.events for r in s.ok):
            continue
        run, odd = s.finest, [r for r in s.ok if miscounted(r)]
        events = run.events
        rows.append(
            {
                "integrator": s.label,
                "finest run": run.resolution,
                "events found": f"{events['events']:g} of {events['expected']:g}",
                "times off in s": number(events["time"]),
                **{
                    f"error of {name}": number(events.get(name))
                    for name in IMPACTS
                    if any(name in r.events for own in series for r in own.ok)
                },
                "steps": _count(run, "steps"),
                "steps to locate": _count(run, "rejected"),
                "runs": s.statuses,
                "runs with another number of events": f"{len(odd)} of {len(s.ok)}",
            }
        )
    note = (
        "Times off: the largest difference from the time of the same event in the reference. Error "
        "of impulse and energy, which an impact gives and takes: relative to the largest. Steps to "
        "locate: those that only look for the time of an event, and rejected ones."
    )
    return Table.from_dicts("Events", rows, note=note) if rows else None


def policies_table(by_policy: Mapping[str, Sequence[Series]]) -> Table:
    """The smallest error of each integrator by what its runs do at samples; there is one at least.

    Parameters
    ----------
    by_policy
        The series of the scene with each of `POLICIES` that was run.
    """
    labels = dict.fromkeys(s.label for own in by_policy.values() for s in own)
    rows = []
    for label in labels:
        cells = {"integrator": label}
        for name, own in by_policy.items():
            found = next((s for s in own if s.label == label), None)
            cells[f"sampling={name}"] = _nearest(found) if found else "not tried"
        rows.append(cells)
    note = (
        f"Smallest error in {quantity(JUDGED)} ({NORMS[NORM]}) and its run. hit: a step ends at "
        "each sample; interpolate: constant steps go over samples; ignore: the controller is "
        "called wherever the method evaluates the equations."
    )
    return Table.from_dicts("Errors by what runs do at samples", rows, note=note)


def _nearest(s: Series) -> str:
    """The smallest error with its run, and whether every run is wrong; else how runs ended."""
    near = s.nearest(JUDGED)
    if near is None:
        return s.statuses
    error, run = near
    wrong = " (wrong)" if s.never_right(JUDGED) else ""
    return f"{number(error)}{wrong} at {run.resolution.partition(',')[0]}"


def _count(record: Record, name: str) -> str:
    found = record.work.get(name)
    return NO_VALUE if found is None else str(found)
