"""Convergence charts: error against step size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bench.results.records import NORMS
from reports.charts.error_panels import error_data, error_panel, floor_rule, full_norm, slope_guides
from reports.charts.line_styles import LineStyle, styles_of
from reports.charts.vega_lite import ChartOptions, Spec, arrange
from reports.formatting import order_text
from reports.series import Series


def convergence(
    series: Sequence[Series],
    groups: Sequence[str],
    styles: Mapping[str, LineStyle],
    norm: str = "end",
    interactive: bool = False,
) -> Spec | None:
    """Error against step size, one panel per group; None if there is nothing to draw.

    An interactive chart holds all norms and starts with one that has errors in every group. The
    legend names the fitted orders of the norm that is shown.
    """
    constant_steps = [s for s in series if s.controls == "step" and s.ok]
    if interactive:
        norm = full_norm(constant_steps, groups, norm)
    norms = NORMS if interactive else (norm,)
    notes = {n: {s.label: _orders(s, groups, n) for s in constant_steps} for n in norms}
    options = ChartOptions(styles_of(constant_steps, styles), norm, interactive, notes)
    data, panels = [error_data(constant_steps, group, options) for group in groups], []
    for table in data:
        behind = [
            *floor_rule(constant_steps, table, options),
            *slope_guides(constant_steps, table, options),
        ]
        panel = error_panel(table, ("h", "step size h in s"), options, not panels, behind)
        panels += [panel] if panel else []
    columns = {1: 1, 2: 2, 4: 2}.get(len(panels), 3)
    return arrange(panels, data, columns, params=options.norm_buttons)


def _orders(series: Series, groups: Sequence[str], norm: str) -> str:
    """Text of the legend: the fitted orders of the groups in which they are determined."""
    fits = {group: series.fit(group, norm) for group in groups}
    known = [f"{g} {order_text(f.order)}" for g, f in fits.items() if f.order is not None]
    return f": order {', '.join(known)}" if known else ": order not determined"
