"""The page of `stepbench stability`: curves over omega h, and maps of spectral radii."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.stability.tables import stability_tables, step_name
from reports.charts import vega_lite as vl
from reports.charts.line_styles import line_styles
from reports.charts.maps import radius_map
from reports.pages.page import Figure, Page, Section, write_page

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


def write_stability_page(found: Sequence[dict[str, Any]], folder: Path) -> Path:
    """Write stability.html into a folder, from the plain values of each integrator's analysis."""
    name, pattern = step_name(found), found[0]["pattern"]
    about = (
        "The amplification matrix of each method was found by taking its step, with all that the "
        "method hands on from step to step. Time is measured in the test system's own unit: a step "
        f"is omega h. Test system: {found[0]['system']}."
    )
    if len(pattern) > 1:
        said = "/".join(f"{f:.4g}" for f in pattern)
        about += f" Pattern of steps: {said} of the macro step H; radii are over the whole of it."
    charts = (_curve(found, *curve, name) for curve in _CURVES)
    curves = {f"curve-{k}": chart for k, chart in enumerate(filter(None, charts))}
    caption = (
        "Damping ratio and period error are those beyond the exact solution's. Overshoot: the "
        f"largest value of the first {found[0]['first_steps']} steps from a start of amplitude 1; "
        "the exact one stays below 1."
    )
    maps = []
    for f in found:
        for k, m in enumerate(f["maps"]):
            turns = m["over"] == "step ratio"
            said = f"{f['integrator']}: spectral radius over {'omega H' if turns else name} and "
            said += f"{m['over']}{'; two steps take turns, omega H is that of both' * turns}"
            chart = {f"map-{len(maps)}-{k}": radius_map(m, "omega H" if turns else name)}
            maps.append(Figure(said, chart))
    facts, numbers, *theory = stability_tables(found)
    sections = [
        Section("What was found", [facts], "found"),
        Section("Over frequency", [Figure(caption, curves), numbers], "frequency"),
        Section("Maps", maps, "maps"),
        Section("Ratios and theory", theory, "theory"),
    ]
    return write_page(Page("stability.html", "Stability of integrators", about, sections), folder)


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
    data, lines = vl.Dataset(field, rows), vl.Lines(line_styles(f["integrator"] for f in found))
    x = vl.log_quantity("omega_h", [row["omega_h"] for row in rows], "~g", title=name)
    y = vl.quantity("value", title=title, scale={"zero": True})
    if logarithmic:
        y = vl.log_quantity("value", [row["value"] for row in rows], ".0e", title=title)
    line = vl.line_panel(data, x, y, lines)
    one: vl.Spec = {
        "data": {"values": [{"one": 1}]},
        "mark": {"type": "rule", "strokeDash": [3, 3], "opacity": 0.6},
        "encoding": {"y": vl.quantity("one")},
    }
    behind = [one] if field == "radius" else []
    return vl.arrange([{"data": data.source, "layer": [*behind, line]}], [data], 2)
