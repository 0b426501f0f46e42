"""Tables made from records; every number is one that a query of the store gives, too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from bench.results.orders import Fit
from bench.results.quantities import LEVELS, NORMS
from bench.results.records import IntegratorFacts, Record, median
from reports.series import (
    NORM_NAMES,
    TRUST,
    Series,
    error_of,
    floor_of,
    groups_of,
    label_of,
    milliseconds,
    number,
    order_text,
    run_name,
    seconds_of,
)
from reports.text.ranking import JUDGED, LEAST, TARGETS, Standing, Verdict, reaches


@dataclass
class Table:
    """Cells as plain text; ``best`` are (row, column) to stress, ``code`` columns hold names.

    ``ids`` are the anchors of the rows; ``links`` are the anchors of the records behind the cell
    (row, column).
    """

    caption: str
    head: list[str]
    rows: list[list[str]]
    best: set[tuple[int, int]] = field(default_factory=set)
    code: tuple[int, ...] = (0,)
    note: str = ""
    ids: list[str] = field(default_factory=list)
    links: dict[tuple[int, int], list[str]] = field(default_factory=dict)


def targets(series: Sequence[Series]) -> Table | None:
    """For an accuracy in q, a and lam: who reaches it for the least time and the least work.

    None if there is nobody to compare.
    """
    groups = [g for g in groups_of(r for s in series for r in s.ok) if g in JUDGED]
    rows = []
    for group in groups if len(series) > 1 else ():
        for target in TARGETS:
            row = _target_row(series, group, target)
            rows.append([f"{group} to {target:.0e}", *row])
    if not rows:
        return None
    return Table(
        "Cheapest way to an accuracy",
        ["relative error", "reached by", "least time", "fewest residual evaluations"],
        rows,
        code=(),
        note="Relative error: the largest over all times. The cheapest of the runs that reached "
        "it; seconds also compare languages, counts do not.",
    )


def verdict(found: Sequence[Verdict], ids: Mapping[str, str]) -> Table | None:
    """Who wins on which scene; ``ids`` are the anchors of records by key."""
    if not found:
        return None
    rows = [[v.scene, *(v.by.get(cost, "not known") for cost in LEAST)] for v in found]
    return Table(
        "Cheapest way to an acceleration within 1e-4",
        ["scene", *LEAST.values()],
        rows,
        note="Largest relative error over all times. Who cannot be told apart from the winner by "
        "timing samples, or has the same count, ties. Other accuracies and costs: below. The "
        "numbers in brackets lead to the runs.",
        links={
            (i, j): [ids[key] for key in v.keys.get(cost, ()) if key in ids]
            for i, v in enumerate(found)
            for j, cost in enumerate(LEAST, 1)
        },
    )


def _target_row(series: Sequence[Series], group: str, target: float) -> list[str]:
    floor = floor_of((r for s in series for r in s.ok), group, "max")
    if TRUST * floor > target:
        return [f"cannot be judged: the reference's own error is {number(floor)}", "", ""]
    tried = [s for s in series if s.ok]
    reached = {s.label: [r for r in s.ok if reaches(r, group, target)] for s in tried}
    runs = [r for rs in reached.values() for r in rs]
    count = f"{sum(map(bool, reached.values()))} of {len(series)}"
    if not runs:
        errors = [(e, r) for s in tried for r in s.ok if (e := error_of(r, group, "max"))]
        if not errors:
            return [count, "", ""]
        error, record = min(errors, key=lambda pair: pair[0])
        nearest = f"nearest: {number(error)} by {run_name(record)}"
        return [count, nearest, number(None)]
    return [count, _fastest(runs), _fewest(runs)]


def _fastest(runs: Sequence[Record]) -> str:
    timed = [r for r in runs if r.run_s]
    if not timed:
        return "no timing samples"
    best = min(timed, key=seconds_of)
    text = f"{run_name(best)}: {milliseconds(seconds_of(best))} ms"
    # Another method whose samples overlap the winner's has not lost.
    close = [r for r in timed if label_of(r) != label_of(best) and min(r.run_s) <= max(best.run_s)]
    rivals = list(dict.fromkeys(label_of(r) for r in sorted(close, key=seconds_of)))
    if rivals:
        more = f" and {len(rivals) - 1} more" if len(rivals) > 1 else ""
        text += f" (not told apart by its samples: {rivals[0]}{more})"
    return text


def _fewest(runs: Sequence[Record]) -> str:
    counted = [r for r in runs if r.work.get("residuals") is not None]
    if not counted:
        return "not counted"
    best = min(counted, key=lambda r: r.work["residuals"])
    return f"{run_name(best)}: {best.work['residuals']}"


def summary(series: Sequence[Series]) -> Table:
    """One row per integrator: best errors, orders, work of its most accurate run, statuses."""
    groups = groups_of(r for s in series for r in s.ok)
    rows, best_errors, doubtful = [], {}, False
    for i, s in enumerate(series):
        cells = []
        for j, group in enumerate(groups):
            found = [e for r in s.ok if (e := error_of(r, group, "end")) is not None]
            cells.append(number(min(found, default=None)))
            if found:
                floor = floor_of(s.ok, group, "end")
                if min(found) <= TRUST * floor:
                    cells[-1] += " *"
                    doubtful = True
                else:
                    best_errors.setdefault(j, []).append((min(found), i))
        run = _most_accurate(s)
        rows.append(
            [
                s.label,
                *cells,
                _orders(s, groups),
                milliseconds(seconds_of(run)) if run else number(None),
                count(run.work.get("residuals")) if run else number(None),
                s.statuses,
                run.resolution if run else number(None),
                s.range,
                s.formulations,
            ]
        )
    note = (
        "Smallest relative error at the end over the runs. Orders: fitted in the largest error "
        "after the start transient. Time and counts are those of the run that is most accurate "
        "in q."
    )
    if doubtful:
        note += f" * within {TRUST:g} times the reference's own error: says nothing more."
    return Table(
        "All integrators",
        [
            "integrator",
            *(f"error in {g}" for g in groups),
            "orders",
            "time in ms",
            "residual evaluations",
            "runs",
            "most accurate run",
            "resolutions",
            "formulation",
        ],
        rows,
        best={(min(found)[1], 1 + j) for j, found in best_errors.items()}
        if len(rows) > 1
        else set(),
        note=note,
    )


def _most_accurate(s: Series) -> Record | None:
    runs = [r for r in s.ok if error_of(r, "q", "end") is not None]
    return min(runs, key=lambda r: error_of(r, "q", "end")) if runs else None


def _orders(s: Series, groups: Sequence[str]) -> str:
    if s.controls != "step":
        return "by tolerance"
    fits = [(group, s.fit(group, "settled")) for group in groups]
    if all(fit.verdict == "not determined" for _, fit in fits):
        return "not determined"
    short = {"does not converge": "none", "not determined": "?"}
    return ", ".join(
        f"{g} {order_text(fit.order)}"
        if fit.verdict == "converges"
        else f"{g} {short[fit.verdict]}"
        for g, fit in fits
    )


def orders(series: Sequence[Series], norms: Sequence[str] = NORMS) -> Table | None:
    """Fitted orders with window and number of points, a row per integrator and norm."""
    stepped = [s for s in series if s.controls == "step" and s.ok]
    groups = groups_of(r for s in stepped for r in s.ok)
    if not stepped or not groups:
        return None
    rows = [
        [s.label, NORM_NAMES[norm], *(_fit(s.fit(group, norm)) for group in groups)]
        for s in stepped
        for norm in norms
    ]
    caption, head = "Fitted orders", ["integrator", "error", *groups]
    if len(norms) == 1:
        caption += f" of the error {NORM_NAMES[norms[0]]}"
        head.pop(1)
        rows = [[label, *cells] for label, _, *cells in rows]
    note = "Order (window of step sizes in s, number of points)."
    return Table(caption, head, rows, note=note)


def _fit(fit: Fit) -> str:
    if fit.order is None or fit.window is None:
        return fit.verdict
    largest, smallest = fit.window
    window = f"{number(largest)} to {number(smallest)}, {fit.points}"
    prefix = "" if fit.verdict == "converges" else f"{fit.verdict}: "
    return f"{prefix}{order_text(fit.order)} ({window})"


def runs(series: Sequence[Series], ids: Mapping[str, str] | None = None) -> Table | None:
    """Every run with its errors, work and ending; ``ids`` are the anchors of the rows by key."""
    records = [(s, r) for s in series for r in s.records]
    groups = groups_of(r for _, r in records)
    if not records:
        return None
    rows = [
        [
            s.label,
            r.resolution,
            r.status,
            *(number(error_of(r, group, "max")) for group in groups),
            *(count(r.work.get(name)) for name in ("steps", "rejected", "residuals")),
            milliseconds(seconds_of(r)),
        ]
        for s, r in records
    ]
    errors = [f"error in {g}" for g in groups]
    head = ["integrator", "run", "ending", *errors, "steps", "rejected", "residual evaluations"]
    note = "Relative errors, the largest over all times. Reasons of failed runs stand below."
    anchors = [ids[r.key] for _, r in records] if ids else []
    return Table("All runs", [*head, "time in ms"], rows, note=note, ids=anchors)


def integrators(
    scenes: Mapping[str, Sequence[Series]],
    found: Sequence[Standing],
    known: Mapping[str, IntegratorFacts],
) -> Table | None:
    """What each integrator is, its orders claimed and measured, its best and worst scenes."""
    rows = []
    for label in dict.fromkeys(s.label for series in scenes.values() for s in series):
        mine = [s for series in scenes.values() for s in series if s.label == label]
        facts = known.get(mine[0].records[0].integrator)
        claimed = ", ".join(f"{g} {p}" for g, p in facts.orders.items()) if facts else ""
        ratios = [
            (s.ratio, s.scene)
            for s in found
            if (s.label, s.group, s.target, s.cost) == (label, "a", 1e-4, "residuals") and s.ratio
        ]
        best, worst = (f"{name} ({number(r)})" for r, name in _ends(ratios))
        rows.append(
            [
                label,
                facts.title.rstrip(".") if facts else "",
                claimed,
                _measured(mine),
                best,
                worst,
                facts.source if facts else "",
            ]
        )
    if not rows:
        return None
    head = ["integrator", "what it is", "orders claimed", "orders measured", "best scene"]
    return Table(
        "Integrators",
        [*head, "worst scene", "source"],
        rows,
        note="Orders measured: of the largest error after the start transient, from the smallest "
        "to the largest over the scenes; at constant steps only. Best and worst scene: residual "
        "evaluations to an acceleration within 1e-4, as a multiple of the best integrator's.",
    )


def _ends(ratios: Sequence[tuple[float, str]]) -> Sequence[tuple[float | None, str]]:
    return (min(ratios), max(ratios)) if ratios else ((None, "none"), (None, "none"))


def _measured(series: Sequence[Series]) -> str:
    said = []
    for group in groups_of(r for s in series for r in s.ok):
        fits = [s.fit(group, "settled") for s in series if s.controls == "step"]
        orders = sorted(f.order for f in fits if f.verdict == "converges" and f.order is not None)
        if orders:
            ends = dict.fromkeys(order_text(o) for o in (orders[0], orders[-1]))
            said.append(f"{group} {' to '.join(ends)}")
    return ", ".join(said)


def drift(series: Sequence[Series]) -> Table | None:
    """Constraint residuals and energy drift of each integrator's finest run."""
    runs = [(s, s.ok[-1]) for s in series if s.ok]
    levels = [
        level for level in LEVELS if any(r.constraint.get(level) is not None for _, r in runs)
    ]
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
        note="Largest over all times; energy relative to its scale.",
    )


def failures(records: Sequence[Record]) -> Table | None:
    """Every run that did not reach the end, with its reason."""
    rows = [
        [r.integrator, r.problem, r.resolution, r.status, r.message or "no message"]
        for r in records
        if r.status != "ok"
    ]
    head = ["integrator", "scene", "resolution", "status", "message"]
    return Table("Runs that did not reach the end", head, rows, code=(0, 1)) if rows else None


def timing(series: Sequence[Series]) -> Table | None:
    """Samples, their spread, and what was prepared before and not timed."""
    rows = []
    for s in series:
        timed = [r for r in s.ok if r.run_s]
        if not timed:
            continue
        sizes = sorted({len(r.run_s) for r in timed})
        spreads = [x for r in timed if (x := spread(r)) is not None]
        compiled = [r.compile_s for r in s.ok if r.compile_s is not None]
        rows.append(
            [
                s.label,
                str(len(timed)),
                " to ".join(str(n) for n in dict.fromkeys((sizes[0], sizes[-1]))),
                number(median(spreads)),
                number(max(spreads, default=None)),
                number(max(compiled, default=None)),
                number(median(compiled)),
            ]
        )
    head = ["integrator", "runs timed", "samples per run", "spread, median", "spread, worst"]
    return (
        Table("Timing", [*head, "prepared in s, longest (compiles)", "median"], rows)
        if rows
        else None
    )


def spread(record: Record) -> float | None:
    """(max - min) / median of the timing samples; None for fewer than two."""
    middle = seconds_of(record)
    if len(record.run_s) < 2 or not middle:
        return None
    return (max(record.run_s) - min(record.run_s)) / middle


def count(value: int | None) -> str:
    """A whole number, or that it cannot be counted."""
    return "not counted" if value is None else str(value)
