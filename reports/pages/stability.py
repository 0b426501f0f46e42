"""stability.html: the stability analysis of integrators as charts, maps and tables."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.stability.tables import stability_tables, step_name
from reports.charts import vega_lite as vl
from reports.charts.line_styles import line_styles
from reports.charts.rendering import Picture, pictures
from reports.pages.page import Link, Page, write_page

#: Quantities over omega h: field, title of the axis, whether the axis is logarithmic.
_CURVES = (
    ("radius", "spectral radius", False),
    ("damping", "numerical damping ratio", True),
    ("period_error", "relative period error (absolute)", True),
    ("overshoot_q", "largest |q| of the first steps", True),
    ("overshoot_v", "largest |v| of the first steps", True),
)
#: Radii above this are drawn at it.
_TOP = 1.6
#: Limits of the colours of maps: green radii are stable, red ones grow.
_BORDERS = (0.25, 0.5, 0.75, 0.9, 0.99, 1 + 1e-9, 1.001, 1.1, 2.0)
_COLORS = ("#0b3d2e", "#14603f", "#2b8a57", "#62b37d", "#a5d6ae", "#dcefe0", "#fde0d2",
           "#f9a582", "#e5553f", "#8f1020")  # fmt: skip


def write_stability_page(found: Sequence[dict[str, Any]], folder: Path) -> Path:
    """Write stability.html into a folder, from the plain values of each integrator's analysis."""
    name, macro = step_name(found), len(found[0]["pattern"]) > 1
    pattern = "/".join(f"{f:.4g}" for f in found[0]["pattern"])
    maps = {
        f"{f['integrator']}: spectral radius over {across} and {m['over']}": chart
        for f in found
        for m in f["maps"]
        for across in ["omega H" if m["over"] == "step ratio" else name]
        if (chart := radius_map(m, across))
    }
    curves = {str(k): chart for k, chart in enumerate(stability_curves(found, name))}
    values = {
        "system": found[0]["system"],
        "pattern": pattern if macro else "",
        "tables": stability_tables(found),
        "charts": [drawn.svg for drawn in pictures(curves).values()],
        # Thousands of tiles make a small PNG and a large SVG.
        "maps": [(n, png_url(drawn)) for n, drawn in pictures(maps, "png", scale=1.5).items()],
        "steps": found[0]["first_steps"],
    }
    parts = {"found": "What was found", "frequency": "Over frequency"}
    parts |= {"maps": "Maps"} if maps else {}
    parts |= {"theory": "Ratios and theory"} if len(values["tables"]) > 2 else {}
    links = [Link(f"#{anchor}", title) for anchor, title in parts.items()]
    page = Page("stability.html", "stability", "Stability of integrators", values=values)
    return write_page(page, folder, links)


def png_url(drawn: Picture) -> str:
    """A picture as a data URL; empty if there is none."""
    return f"data:image/png;base64,{base64.b64encode(drawn.content).decode()}" * bool(drawn.content)


# ---- charts ------------------------------------------------------------------------------
def stability_curves(found: Sequence[dict[str, Any]], omega_h: str) -> list[vl.Spec]:
    """A chart per quantity over omega h (the title of the axis), a line per integrator."""
    charts = (_curve(found, *curve, omega_h) for curve in _CURVES)
    return [chart for chart in charts if chart]


def _curve(
    found: Sequence[dict[str, Any]], field: str, title: str, logarithmic: bool, name: str
) -> vl.Spec | None:
    """One quantity over omega h, a line per integrator; None if it has no values."""
    rows = []
    for f in found:
        for omega_h, value in zip(f["omega_h"], f[field], strict=True):
            if value is None and field == "radius":
                value = math.inf
            if value is None or (logarithmic and not abs(value) > 1e-12):
                continue
            shown = abs(value) if logarithmic else min(value, _TOP)
            if math.isfinite(shown):
                row = {"omega_h": vl.short(omega_h), "value": vl.short(shown)}
                rows.append({"series": f["integrator"], **row})
    if not rows:
        return None
    data = vl.Dataset(field, rows)
    options = vl.Lines(line_styles(f["integrator"] for f in found))
    values = [row["value"] for row in rows]
    x_axis = vl.log_axis([row["omega_h"] for row in rows], "~g")
    y = vl.quantity("value", title=title, scale={"zero": True})
    if logarithmic:
        y |= {"scale": vl.log_scale(), "axis": vl.log_axis(values, ".0e")}
    line: vl.Spec = {
        "mark": {"type": "line", "strokeWidth": 1.8, "clip": True},
        "encoding": {
            "x": vl.log_quantity("omega_h", title=name, axis=x_axis),
            "y": y,
            "color": options.colors(),
            "strokeDash": options.dashes(),
        },
    }
    one: vl.Spec = {
        "data": {"values": [{"one": 1}]},
        "mark": {"type": "rule", "strokeDash": [3, 3], "opacity": 0.6},
        "encoding": {"y": vl.quantity("one")},
    }
    behind = [one] if field == "radius" else []
    return vl.arrange([{"data": data.source, "layer": [*behind, line]}], [data], 2)


def radius_map(m: dict[str, Any], name: str) -> vl.Spec | None:
    """Spectral radii over omega h and another number, as tiles."""
    rows, values, across = [], [row["value"] for row in m["rows"]], m["omega_h"]
    if len(values) < 2:
        return None
    # Ratios are spaced evenly in their logarithm, options in themselves.
    logarithmic, wide = m["over"] == "step ratio", math.sqrt(across[1] / across[0])
    step = math.sqrt(values[1] / values[0]) if logarithmic else (values[1] - values[0]) / 2
    for row in m["rows"]:
        v = row["value"]
        low, high = (v / step, v * step) if logarithmic else (v - step, v + step)
        for omega_h, radius in zip(across, row["radii"], strict=True):
            rows.append(
                {
                    "left": vl.short(omega_h / wide),
                    "right": vl.short(omega_h * wide),
                    "low": low,
                    "high": high,
                    "radius": 1e9 if radius is None else radius,
                }
            )
    data = vl.Dataset("map", rows)
    scale = {"type": "log" if logarithmic else "linear", "nice": False, "zero": False}
    colors = {"type": "threshold", "domain": list(_BORDERS), "range": list(_COLORS)}
    x_axis = vl.log_axis(across, "~g")
    legend = {"title": "spectral radius", "orient": "right", "format": ".4~g"}
    tile: vl.Spec = {
        "data": data.source,
        "mark": {"type": "rect", "clip": True},
        "encoding": {
            "x": vl.quantity(
                "left", title=name, scale=vl.log_scale() | {"padding": 0}, axis=x_axis
            ),
            "x2": {"field": "right"},
            "y": vl.quantity("low", title=m["over"], scale=scale),
            "y2": {"field": "high"},
            "color": vl.quantity("radius", scale=colors, legend=legend),
        },
    }
    return vl.arrange([tile], [data], 2)
