"""The order table: orders claimed and measured, per method and group of variables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from bench.results.orders import Fit
from bench.results.records import Plan, Record
from bench.results.store import Store
from bench.results.table import Table
from reports.formatting import NO_VALUE, order_text
from reports.names import short_names
from reports.series import Series, groups_of, ok_runs, series_of

#: The figure of a study that asks for the table.
FIGURE = "orders"
#: Norms of the two measured rows, with their names in the table.
_MEASURED = {"settled": "settled", "max": "with start"}
#: A measured order that falls short of the claimed one by more than this is marked.
_SHORT = 0.2
_NOTE = (
    "Powers of the step by which errors fall. Claimed: those that the method states, for the time "
    "after the start transient. Settled: measured, of the largest error in the last quarter of the "
    "interval. With start: measured, of the largest error over time. "
    f"* less than claimed by more than {_SHORT:g}. {NO_VALUE}: no claim, or no order can be fitted."
)


def stored_order_tables(folder: Path) -> list[Table]:
    """Return the order tables of a run folder, one per study that asks for it.

    Raises
    ------
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    with Store(folder) as store:
        return order_tables(store.plan(), store.records())


def order_tables(plan: Plan | None, records: Mapping[str, Record]) -> list[Table]:
    """Return the order tables of all studies that ask for one."""
    studies = [s for s in (plan.studies if plan else ()) if FIGURE in s.figures]
    made = (
        order_table(series_of(records[k] for k in study.cells if k in records), study.title)
        for study in studies
    )
    return [table for table in made if table]


def order_table(series: Sequence[Series], title: str) -> Table | None:
    """Return three rows per method: orders claimed, settled, and from the first step."""
    shown = [s for s in series if s.controls == "step" and len(s.ok) > 2]
    groups = groups_of(ok_runs(shown))
    if not shown or not groups:
        return None
    names, rows = short_names(s.label for s in shown), []
    for s in shown:
        claims = s.finest.claims or {}
        rows.append([names[s.label], "claimed", *(str(claims.get(g, NO_VALUE)) for g in groups)])
        for norm, said in _MEASURED.items():
            cells = (_cell(s.fit(g, norm), claims.get(g), norm) for g in groups)
            rows.append([names[s.label], said, *cells])
    head = ["integrator", "order", *("λ" if g == "lam" else g for g in groups)]
    few = [s.label for s in series if s.controls == "step" and s not in shown]
    missing = f" Left out, with fewer than three runs to the end: {', '.join(few)}." if few else ""
    return Table(title, head, rows, code=(), note=_NOTE + missing)


def _cell(fit: Fit, claimed: int | None, norm: str) -> str:
    if fit.order is None and fit.verdict != "does not converge":
        return NO_VALUE
    order = fit.order if fit.verdict == "converges" and fit.order else 0.0
    short = claimed is not None and norm == "settled" and claimed - order > _SHORT
    return (order_text(order) if order else "0") + (" *" if short else "")
