"""Charts of errors: against step size, against cost, acceleration against position."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bench.results.quantities import COSTS, GROUP_NAMES, NORM, NORMS
from reports.charts import vega_lite as vl
from reports.charts.error_panels import (
    error_data,
    error_lines,
    error_panel,
    floor_rule,
    full_norm,
    slope_guides,
)
from reports.charts.line_styles import LineStyle, styles_of
from reports.formatting import order_text
from reports.series import Series, error_of, step_or_tolerance


def convergence(
    series: Sequence[Series],
    groups: Sequence[str],
    styles: Mapping[str, LineStyle],
    norm: str = NORM,
    interactive: bool = False,
) -> vl.Spec | None:
    """Error against step size, one panel per group; None if there is nothing to draw.

    An interactive chart holds all norms and starts with one that has errors in every group. The
    legend names the fitted orders of the norm that is shown.
    """
    constant_steps = [s for s in series if s.controls == "step" and s.ok]
    if interactive:
        norm = full_norm(constant_steps, groups, norm)
    norms = tuple(NORMS) if interactive else (norm,)
    notes = {n: {s.label: _orders(s, groups, n) for s in constant_steps} for n in norms}
    options = vl.ChartOptions(styles_of(constant_steps, styles), norm, interactive, notes)
    data, panels = [error_data(constant_steps, group, options) for group in groups], []
    for table in data:
        behind = [
            *floor_rule(constant_steps, table, options),
            *slope_guides(constant_steps, table, options),
        ]
        panel = error_panel(table, ("h", "step size h in s"), options, not panels, behind)
        panels += [panel] if panel else []
    columns = {1: 1, 2: 2, 4: 2}.get(len(panels), 3)
    return vl.arrange(panels, data, columns, params=options.norm_buttons)


def _orders(series: Series, groups: Sequence[str], norm: str) -> str:
    """Text of the legend: the fitted orders of the groups in which they are determined."""
    fits = {group: series.fit(group, norm) for group in groups}
    known = [f"{g} {order_text(f.order)}" for g, f in fits.items() if f.order is not None]
    return f": order {', '.join(known)}" if known else ": order not determined"


def work_precision(
    series: Sequence[Series],
    groups: Sequence[str],
    styles: Mapping[str, LineStyle],
) -> vl.Spec | None:
    """Errors in the groups against seconds and residual evaluations, a panel each.

    None if there is nothing to draw.
    """
    series = [s for s in series if s.ok]
    options = vl.ChartOptions(styles_of(series, styles))
    data, panels, columns = [error_data(series, group, options) for group in groups], [], 1
    for across in [(cost, COSTS[cost].title) for cost in ("seconds", "residuals")]:
        before = len(panels)
        for table in data:
            panel = error_panel(
                table, across, options, not panels, floor_rule(series, table, options)
            )
            panels += [panel] if panel else []
        columns = max(columns, len(panels) - before)
    return vl.arrange(panels, data, columns)


def acceleration_accuracy(
    series: Sequence[Series],
    styles: Mapping[str, LineStyle],
    norm: str = NORM,
    interactive: bool = False,
) -> vl.Spec | None:
    """Error in the acceleration over the error in the position, a line per integrator.

    Below the grey diagonal accelerations are relatively better than positions, above it worse.
    """
    series = [s for s in series if s.ok]
    options = vl.ChartOptions(styles_of(series, styles), norm, interactive)
    rows = [
        {
            "series": s.label,
            "run": r.resolution,
            "norm": n,
            "q": q,
            "a": a,
            "h": vl.short(step_or_tolerance(r)),
        }
        for s in series
        for r in s.ok
        for n in options.norms
        if (q := vl.short(error_of(r, "q", n))) and (a := vl.short(error_of(r, "a", n)))
    ]
    if not rows:
        return None
    data = vl.Dataset("accuracy", rows)
    ends = [f([row[g] for row in rows for g in "qa"]) for f in (min, max)]
    line: vl.Spec = {
        "data": {"values": [{"q": e, "a": e} for e in ends]},
        "mark": {"type": "line", "color": vl.GREY, "strokeWidth": 1, "strokeDash": [5, 5]},
        "encoding": {g: vl.log_quantity(f) for g, f in (("x", "q"), ("y", "a"))},
    }
    tooltip = vl.run_tooltip(
        *(vl.quantity(group, title=f"error in {group}", format=".3g") for group in "qa")
    )
    place = {
        channel: vl.log_quantity(
            group,
            title=f"relative error in {GROUP_NAMES[group]}",
            axis=vl.log_axis([row[group] for row in rows], ".0e"),
        )
        for channel, group in (("x", "q"), ("y", "a"))
    }
    layers = error_lines(options, place, "h", tooltip)
    panel: vl.Spec = {"data": data.source, "layer": [line, *layers]}
    if interactive:
        layers[0]["params"] = [vl.zoom("zoom_a"), vl.pick()]
        panel["transform"] = [{"filter": "datum.norm == norm"}]
    return vl.arrange([panel], [data], 1, height=340, params=options.norm_buttons)
