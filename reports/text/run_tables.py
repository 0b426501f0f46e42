"""Tables of runs: errors and orders, all runs, drift, failures, timing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from bench.results.quantities import ERROR_MEANING, LEVELS, NORM, TRUST
from bench.results.records import UNSUPPORTED, Record, median
from bench.results.table import Table
from reports.formatting import (
    NO_VALUE,
    component_text,
    milliseconds,
    number,
    text_range,
)
from reports.series import (
    Series,
    cost_of,
    error_of,
    groups_of,
    measured_at,
    ok_runs,
    seconds_of,
    timing_spread,
    trusted_error,
    with_values,
    worst_component,
)
from reports.text.measured_orders import orders_measured


def summary_table(series: Sequence[Series]) -> Table:
    """One row per integrator: best errors, orders, work of its most accurate run, endings."""
    groups = groups_of(ok_runs(series))
    rows, best_errors, doubtful = [], {}, False
    for i, s in enumerate(series):
        errors = {}
        for j, group in enumerate(groups):
            found = [e for r in s.ok if (e := error_of(r, group, NORM)) is not None]
            errors[name := f"error in {group}"] = number(min(found, default=None))
            if found:
                if min(found) <= trusted_error(s.ok, group, NORM):
                    errors[name] += " *"
                    doubtful = True
                else:
                    best_errors.setdefault(j, []).append((min(found), i))
        judged = with_values(s.ok, lambda r: error_of(r, "q", NORM))
        run = min(judged, key=lambda pair: pair[0])[1] if judged else None
        rows.append(
            {
                "integrator": s.label,
                **errors,
                "orders": _orders(s),
                "time in ms": milliseconds(seconds_of(run) if run else None),
                "residual evaluations": _count(run.work.get("residuals")) if run else NO_VALUE,
                "operations": number(cost_of(run, "operations")) if run else NO_VALUE,
                "runs": s.statuses,
                "most accurate run": run.resolution if run else NO_VALUE,
            }
        )
    best = {(min(found)[1], 1 + j) for j, found in best_errors.items()} if len(rows) > 1 else set()
    note = (
        f"Smallest error over the runs. {ERROR_MEANING} Time and counts: of the run that is most "
    )
    note += "accurate in q."
    if doubtful:
        note += f" * within {TRUST:g} times the reference's own error: says nothing more."
    return Table.from_dicts("All integrators", rows, best=best, note=note)


def _orders(s: Series) -> str:
    if s.controls != "step":
        return "by tolerance"
    return orders_measured([s]) or "not determined"


def runs_table(
    series: Sequence[Series],
    ids: Mapping[str, str] | None = None,
    components: Mapping[str, Sequence[str]] = MappingProxyType({}),
    names: Mapping[str, str] = MappingProxyType({}),
) -> Table | None:
    """Every run with its errors, work and ending.

    ``ids`` are the anchors of the rows by key, ``components`` the names of components by group,
    ``names`` short names by label.
    """
    records = [(s, r) for s in series for r in s.records]
    groups = groups_of(r for _, r in records)
    if not records:
        return None
    rows = [
        {
            "integrator": s.label,
            "run": r.resolution,
            "ending": r.status,
            **{f"error in {group}": _error(r, group, components) for group in groups},
            "steps": _count(r.work.get("steps")),
            "rejected": _count(r.work.get("rejected")),
            "residual evaluations": _count(r.work.get("residuals")),
            "operations": number(cost_of(r, "operations")),
            "time in ms": milliseconds(seconds_of(r)),
        }
        for s, r in records
    ]
    note = f"{ERROR_MEANING} The worst component is named. "
    sampled = [
        f"{r.resolution} of {names.get(s.label, s.label)} at {measured_at(r)}"
        for s, r in records
        if r.status == "ok" and r.rows < (r.work.get("steps") or 0)
    ]
    if sampled:
        note += f"Not all steps were measured: {'; '.join(sampled)}. "
    note += "The reasons of failed runs are below."
    return Table.from_dicts(
        "All runs", rows, note=note, ids=[ids[r.key] for _, r in records] if ids else []
    )


def _error(record: Record, group: str, components: Mapping[str, Sequence[str]]) -> str:
    """The error with its worst component: 0.7 roll."""
    worst = worst_component(record, group, NORM)
    name = "" if worst is None else component_text(group, worst, components).partition(" [")[0]
    return f"{number(error_of(record, group, NORM))} {name}".strip()


def drift_table(series: Sequence[Series]) -> Table | None:
    """Constraint residuals and energy drift of each integrator's finest run."""
    runs = [(s, s.finest) for s in series if s.ok]
    levels = [x for x in LEVELS if any(r.constraint.get(x) is not None for _, r in runs)]
    energy = any(r.energy_drift is not None for _, r in runs)
    if not levels and not energy:
        return None
    rows = []
    for s, run in runs:
        cells = [number(run.constraint.get(level)) for level in levels]
        rows.append([s.label, run.formulation, run.resolution, *cells])
        if energy:
            rows[-1].append(number(run.energy_drift))
    heads = [f"{level} level" for level in levels] + (["energy drift"] if energy else [])
    return Table(
        "Constraint residuals and energy drift",
        ["integrator", "formulation", "finest run", *heads],
        rows,
        note="Largest over time; the energy relative to the largest kinetic energy.",
    )


def failures_table(records: Sequence[Record]) -> Table | None:
    """Every run that its method supports and that did not reach the end, with its reason."""
    rows = [
        [r.integrator, r.problem, r.resolution, r.status, r.message or "no message"]
        for r in records
        if r.status not in ("ok", UNSUPPORTED)
    ]
    head = ["integrator", "scene", "resolution", "status", "message"]
    return Table("Runs that did not reach the end", head, rows, code=(0, 1)) if rows else None


def unsupported_table(records: Sequence[Record]) -> Table | None:
    """The scenes that a method does not take, with its reason; these runs are no failures."""
    refused = Counter(
        (r.integrator, r.problem, r.message) for r in records if r.status == UNSUPPORTED
    )
    rows = [[*names, str(runs), why or "no message"] for (*names, why), runs in refused.items()]
    head = ["integrator", "scene", "runs", "reason"]
    return Table("Scenes that a method does not support", head, rows, code=(0, 1)) if rows else None


def timing_table(series: Sequence[Series]) -> Table | None:
    """Number and spread of the timing samples, and the untimed seconds of preparation."""
    rows = []
    for s in series:
        timed = [r for r in s.ok if r.run_s]
        if not timed:
            continue
        spreads = [x for r in timed if (x := timing_spread(r)) is not None]
        compiled = [r.compile_s for r in s.ok if r.compile_s is not None]
        rows.append(
            {
                "integrator": s.label,
                "runs timed": str(len(timed)),
                "samples per run": text_range(map(str, sorted(len(r.run_s) for r in timed))),
                "spread in %, median": _percent(median(spreads)),
                "spread in %, worst": _percent(max(spreads, default=None)),
                "preparation in s, longest": number(max(compiled, default=None)),
                "preparation in s, median": number(median(compiled)),
            }
        )
    note = (
        "Spread: (slowest - fastest) / median of the samples of a run. Preparation is not timed as "
        "a part of the run; the longest one compiles."
    )
    return Table.from_dicts("Timing", rows, note=note) if rows else None


def _percent(part: float | None) -> str:
    return number(None if part is None else 100 * part)


def _count(value: int | None) -> str:
    """A whole number, or 'not counted'."""
    return "not counted" if value is None else str(value)
