"""Tables of runs: errors and costs, all runs, drift, events, failures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from statistics import median_low

from bench.results.quantities import ERROR_MEANING, LEVELS, NORM, TRUST, VIOLATIONS
from bench.results.records import UNSUPPORTED, Record
from bench.results.table import Table
from reports.formatting import NO_VALUE, component_text, cost_text, milliseconds, number
from reports.names import form_name
from reports.questions import named
from reports.series import Series, groups_of, ok_runs, reference_error


def summary_table(series: Sequence[Series]) -> Table:
    """One row per integrator: best errors, costs of its most accurate run, endings."""
    groups = groups_of(ok_runs(series))
    rows = []
    sure: dict[str, list[tuple[float, int]]] = {g: [] for g in groups}
    for i, s in enumerate(series):
        run = near[1] if (near := s.nearest("q")) else None
        row = {"integrator": s.label}
        for g in groups:
            row[f"error in {g}"], error = least_error(s, g)
            if error is not None:
                sure[g].append((error, i))
        row |= {**_costs(run), "runs": s.statuses}
        rows.append(row | {"run most accurate in q": run.resolution if run else NO_VALUE})
    several = len(rows) > 1
    best = {(min(own)[1], j) for j, own in enumerate(sure.values(), 1) if own and several}
    note = f"Smallest error over the runs. {ERROR_MEANING} Time and counts: of the run that is "
    note += "most accurate in q." + doubt(rows)
    return Table.from_dicts("All integrators", rows, best=best, note=note)


def least_error(series: Series, group: str) -> tuple[str, float | None]:
    """The smallest error of its runs with a mark of doubt, or as a number if it can be judged."""
    if not (near := series.nearest(group)):
        return NO_VALUE, None
    judged = near[0] > TRUST * reference_error(series.ok, group, NORM)
    return number(near[0]) + " *" * (not judged), near[0] if judged else None


def doubt(rows: Sequence[Mapping[str, str]]) -> str:
    """The sentence on the marks of doubt in a table, if it has any."""
    marked = any(cell.endswith(" *") for row in rows for cell in row.values())
    return f" * within {TRUST:g} times the reference's own error: says nothing more." * marked


def _costs(run: Record | None) -> dict[str, str]:
    """The costs of a run by column; signs for no value where there is no run."""
    return {
        "time in ms": milliseconds(run.seconds if run else None),
        "residual evaluations": _count(run.work.get("residuals")) if run else NO_VALUE,
        "operations": cost_text(run.cost("operations") if run else None, "operations"),
    }


def runs_table(
    series: Sequence[Series], ids: Mapping[str, str], components: Mapping[str, Sequence[str]]
) -> Table | None:
    """Every run with its errors, each with its worst component, work and ending.

    ``ids`` are the anchors of the rows by key, ``components`` the names of components by group.
    """
    records = [(s, r) for s in series for r in s.records]
    groups, rows = groups_of(r for _, r in records), []
    for s, r in records:
        row = {"integrator": s.label, "run": r.resolution, "ending": r.status.replace("_", " ")}
        for g in groups:
            sizes = [math.inf if e is None else e for e in r.components.get(g, {}).get(NORM, [])]
            worst = component_text(g, sizes.index(max(sizes)), components) if sizes[1:] else ""
            error = f"{number(r.error(g, NORM))} {worst.partition(' [')[0]}"
            row[f"error in {g}"] = error.strip()
        # Of a run that reached the end also the steps at which errors were measured.
        steps = r.work.get("steps")
        partly = r.status == "ok" and r.rows < (steps or 0)
        row["steps"] = f"{steps}, {r.rows} of them measured" if partly else _count(steps)
        rows.append(row | {"rejected": _count(r.work.get("rejected")), **_costs(r)})
    anchors = [ids[r.key] for _, r in records]
    note = f"{ERROR_MEANING} The worst component is named. The page of failures has reasons."
    return Table.from_dicts("All runs", rows, note=note, ids=anchors) if rows else None


def invariants_table(series: Sequence[Series]) -> Table | None:
    """Constraint residuals and energy drift of each integrator's finest run.

    Of constraints stand the residual in its unit, and the one relative to the scene's size.
    """
    runs = [(s, s.finest) for s in series if s.ok]
    unit = next((f" in {r.constraint_unit}" for _, r in runs if r.constraint_unit), "")
    columns = {
        f"Φ of {level}{unit and unit + after}": [r.constraint.get(level) for _, r in runs]
        for level, after in zip(LEVELS, ("", "/s", "/s²"), strict=True)
    }
    for group, name in VIOLATIONS.items():
        columns[f"{name}, relative"] = [r.error(group, NORM) for _, r in runs]
    columns["energy drift"] = [r.energy_drift for _, r in runs]
    known = {name: own for name, own in columns.items() if any(x is not None for x in own)}
    rows = [
        [s.label, form_name([run]) or run.formulation, run.resolution, *map(number, cells)]
        for (s, run), *cells in zip(runs, *known.values(), strict=True)
    ]
    note = "Largest over time; relative: divided by the change of Φ that positions or velocities "
    note += "of their size make; the energy relative to the motion's largest kinetic energy."
    head = ["integrator", "formulation", "finest run", *known]
    return Table("Constraint residuals and energy drift", head, rows, note=note) if known else None


def held_table(series: Sequence[Series], names: Mapping[str, str]) -> Table | None:
    """Violations by formulation; a method ten thousand times above most of its own is apart."""
    forms: dict[str, list[tuple[float, float, str]]] = {}
    for s in series:
        if sizes := [e for r in s.ok if (e := r.error("constraint", NORM)) is not None]:
            forms.setdefault(form_name(s.ok), []).append((max(sizes), min(sizes), names[s.label]))
    rows = []
    for form, own in forms.items():
        most = 1e4 * median_low(own)[0]
        usual, odd = ([m for m in own if (m[0] > most) == far] for far in (False, True))
        but = f" but {named(name for *_, name in odd)}" * bool(odd)
        rows.append((max(usual)[0], min(best for _, best, _ in usual), form + but))
        rows += odd
    cells = [[name, number(worst), number(best)] for worst, best, name in sorted(rows)]
    note = "1e-15 stands for less, too. Largest over time, of runs that reached the end."
    head = ["formulation", "worst", "best"]
    return Table("Violation of Φ, relative", head, cells, code=(), note=note) if cells else None


def events_table(series: Sequence[Series]) -> Table | None:
    """The events of the finest run of each integrator; None if the runs have no events."""
    eventful = [s for s in series if any(r.events for r in s.ok)]
    rows = []
    for s in eventful:
        events = s.finest.events
        other = sum(r.events["events"] != r.events["expected"] for r in s.ok if r.events)
        found = f"{events['events']:g} of {events['expected']:g}"
        row = [s.label, s.finest.resolution, found, number(events["time"])]
        rows.append([*row, f"{other} of {len(s.ok)}"])
    note = "Times off: the largest difference from the time of the same event in the reference."
    head = ["integrator", "finest run", "events found", "times off in s"]
    head.append("runs with another number")
    return Table("Events", head, rows, note=note) if rows else None


def failures_table(records: Sequence[Record]) -> Table | None:
    """Every run that its method supports and that did not reach the end, with its reason."""
    failed = [r for r in records if r.status not in ("ok", UNSUPPORTED)]
    ends = ((r.status.replace("_", " "), r.message or "no message") for r in failed)
    rows = [[r.integrator, r.problem, r.resolution, *e] for r, e in zip(failed, ends, strict=True)]
    head = ["integrator", "scene", "resolution", "status", "message"]
    return Table("Runs that did not reach the end", head, rows, code=(0, 1)) if rows else None


def unsupported_table(records: Sequence[Record]) -> Table | None:
    """The scenes that a method does not take, with its reason; these runs are no failures."""
    refused = [r for r in records if r.status == UNSUPPORTED]
    return _by_reason("Scenes that a method does not support", "reason", refused)


def notes_table(records: Sequence[Record]) -> Table | None:
    """The runs that reached the end and have a warning: they may be wrong."""
    noted = [r for r in records if r.status == "ok" and r.message]
    return _by_reason("Runs that reached the end with a warning", "first warning", noted)


def _by_reason(title: str, column: str, records: Sequence[Record]) -> Table | None:
    """A row for each integrator and scene, with the number of runs and the first message."""
    runs: dict[tuple[str, str], list[Record]] = {}
    for r in records:
        runs.setdefault((r.integrator, r.problem), []).append(r)
    rows = [[*names, str(len(own)), own[0].message or "no message"] for names, own in runs.items()]
    head = ["integrator", "scene", "runs", column]
    return Table(title, head, rows, code=(0, 1)) if rows else None


def _count(value: int | None) -> str:
    """A whole number, or 'not counted'."""
    return "not counted" if value is None else str(value)
