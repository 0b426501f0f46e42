"""Accuracy of the acceleration against accuracy of the position."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from reports.charts import vega_lite as vl
from reports.charts.error_panels import error_lines
from reports.charts.line_styles import LineStyle, styles_of
from reports.series import GROUP_NAMES, Series, error_of, step_or_tolerance


def acceleration_accuracy(
    series: Sequence[Series],
    styles: Mapping[str, LineStyle],
    norm: str = "max",
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
            "look": list(options.styles).index(s.label),
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
        "encoding": {g: vl.quantity(f, scale=vl.log_scale()) for g, f in (("x", "q"), ("y", "a"))},
    }
    tooltip = vl.run_tooltip(
        *(vl.quantity(group, title=f"error in {group}", format=".3g") for group in "qa")
    )
    layers = error_lines(options, "q", "a", "h", tooltip)
    for channel, group in (("x", "q"), ("y", "a")):
        axis = vl.log_axis([row[group] for row in rows], ".0e")
        layers[0]["encoding"][channel] |= {
            "title": f"relative error in {GROUP_NAMES[group]}",
            "axis": axis,
        }
    panel: vl.Spec = {"data": data.source, "layer": [line, *layers]}
    if interactive:
        panel["transform"] = [{"filter": "datum.norm == norm"}]
    return vl.arrange([panel], [data], 1, height=340, params=options.norm_buttons)
