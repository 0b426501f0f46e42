"""Orders: those claimed beside those measured, and orders that were lost."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from bench.results.orders import Fit
from bench.results.quantities import NORM, NORMS
from bench.results.records import SceneRecord
from bench.results.table import Table
from reports.formatting import NO_VALUE, number, order_text, symbols
from reports.names import short_names
from reports.scenes import NO_SCENE, StoredRuns
from reports.series import Series, groups_of, ok_runs, series_of, with_starts
from reports.wrong import STUCK, Atlas, explained

#: The figure of a study that asks for the table.
FIGURE = "orders"
#: Norms of the two measured rows, with their names in the table.
_MEASURED = {"settled": "settled", "max": "with transient"}
#: A measured order that falls short of the claimed one by more than this is marked; one that does
#: by so much more is lost.
_SHORT, _LOSS = 0.2, 0.5
_NOTE = (
    "Powers of the step by which errors fall. Claimed: those that the method states for the scene, "
    "for the time after the start transient. Settled: measured, of the largest error in the last "
    "quarter of the interval. With transient: measured, of the largest error over time; 0: errors "
    f"do not fall. * settled order less than claimed by more than {_SHORT:g}. † without the "
    f"finest steps, at which errors hardly fall. {NO_VALUE}: no claim, no order can be fitted, "
    "or smaller steps help no group of variables."
)


def order_tables(stored: StoredRuns) -> list[Table]:
    """Return the order tables of all studies that ask for one."""
    records = stored.records
    made = (
        order_table(series_of(records[k] for k in study.cells if k in records), study.title)
        for study in stored.plan.studies
        if FIGURE in study.figures
    )
    return [table for table in made if table]


def order_table(series: Sequence[Series], title: str, scenes: Sequence[str] = ()) -> Table | None:
    """Return three rows per method: orders claimed, settled, and over all times.

    ``scenes`` names the rows of one method instead, a scene for each of the series.
    """
    named = with_starts(series, short_names(s.label for s in series))
    names = scenes or [named[s.label] for s in series]
    stepped = [(name, s) for name, s in zip(names, series, strict=True) if s.controls == "step"]
    shown = [(name, s) for name, s in stepped if len(s.ok) > 2]
    groups = groups_of(ok_runs(s for _, s in shown))
    if not groups:
        return None
    rows = []
    for name, s in shown:
        claims = {g: n for g, n in (s.finest.claims or {}).items() if g in groups_of(s.ok)}
        rows.append([name, "claimed", *(str(claims.get(g, NO_VALUE)) for g in groups)])
        for norm, said in _MEASURED.items():
            rows.append([name, said])
            for g in groups:
                fit = s.fit(g, norm)
                order = fit.order if fit.verdict == "converges" and fit.order else 0.0
                unknown = fit.order is None and fit.verdict != STUCK
                short = norm == "settled" and g in claims and claims[g] - order > _SHORT
                # Errors at the finest steps may be rounding.
                cut = fit.window is not None and fit.window[1] > 1.001 * (s.ok[-1].h or 0.0)
                cell = (order_text(order) if order else "0") + " *" * short + " †" * cut
                rows[-1].append(NO_VALUE if unknown else cell)
    head = ["scene" if scenes else "integrator", "order", *map(symbols, groups)]
    few = [name for name, s in stepped if len(s.ok) < 3]
    missing = f" Left out, with fewer than three runs to the end: {', '.join(few)}." if few else ""
    return Table(title, head, rows, code=(), note=_NOTE + missing)


def lost_orders_table(
    scenes: Mapping[str, Sequence[Series]], atlas: Atlas, described: Mapping[str, SceneRecord]
) -> Table | None:
    """Groups that do not converge, or at less than the claimed order; None if there are none.

    ``atlas`` has the experiments that the report shows, ``described`` its scenes.
    """
    rows, links = [], {}
    for scene, s in ((scene, s) for scene, series in scenes.items() for s in series):
        alike: dict[tuple[str, str, str], list[str]] = {}
        for group in groups_of(s.ok):
            claimed = (s.finest.claims or {}).get(group) if s.controls == "step" else None
            fit, settled = s.fit(group, NORM), s.fit(group, "settled")
            if not _is_lost(fit, claimed):
                continue
            transient = settled.order is not None and not _is_lost(settled, claimed)
            found = order_text(fit.order or 0.0)
            if fit.verdict == STUCK:
                name = "h" if s.controls == "step" else "rtol"
                ends = [
                    f"{number(r.error(group, NORM))} at {name}={number(r.size)}"
                    for r in (s.ok[0], s.ok[-1])
                ]
                found = f"none: error {', '.join(ends)}"
            if transient:
                found += f"; after the start transient {order_text(settled.order or 0.0)}"
            why = explained(s, group, described.get(scene, NO_SCENE), atlas, transient)
            alike.setdefault((str(claimed or "none"), found, why), []).append(group)
        for (claim, found, why), groups in alike.items():
            cause = atlas[why].short_title if why else "not explained"
            links |= {(len(rows), 5): [f"atlas-{why}"]} if why else {}
            rows.append([s.label, scene, ", ".join(groups), claim, found, cause])
    if not rows:
        return None
    return Table(
        "Orders that were lost, and errors that never converge",
        ["integrator", "scene", "group", "order claimed", "measured", "explained by"],
        rows,
        code=(0, 1),
        note=f"Relative error, {NORMS[NORM]}: it does not converge, or its order at "
        f"constant steps is lower than the integrator claims by {_LOSS:g} or more. An experiment "
        "of the failure atlas explains it where the same method fails on such a scene.",
        links=links,
    )


def _is_lost(fit: Fit, claimed: int | None) -> bool:
    """Whether errors do not converge, or with less than the claimed order."""
    order = math.inf if fit.order is None or claimed is None else fit.order
    return fit.verdict == STUCK or (claimed or 0) - order >= _LOSS
