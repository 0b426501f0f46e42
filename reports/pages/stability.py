"""stability.html: what the laboratory found out about integrators, as charts, maps and tables."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import vl_convert

from reports.charts.vega import (
    Data,
    Spec,
    View,
    arrange,
    by_series,
    log_axis,
    log_scale,
    quantity,
    short,
)
from reports.pages.templating import template
from reports.series import looks_of, number
from reports.text.tables import Table

FILE = "stability.html"

#: Quantities over omega h: field, title of the axis, logarithmic?
_CURVES = (
    ("radius", "spectral radius", False),
    ("damping", "numerical damping ratio", True),
    ("period_error", "relative period error (absolute)", True),
    ("overshoot_q", "largest |q| of the first steps", True),
    ("overshoot_v", "largest |v| of the first steps", True),
)
#: Radii above this are drawn at it.
_TOP = 1.6
#: Borders of the colours of maps: greens are stable, reds grow.
_BORDERS = (0.25, 0.5, 0.75, 0.9, 0.99, 1 + 1e-9, 1.001, 1.1, 2.0)
_COLORS = ("#0b3d2e", "#14603f", "#2b8a57", "#62b37d", "#a5d6ae", "#dcefe0", "#fde0d2",
           "#f9a582", "#e5553f", "#8f1020")  # fmt: skip


def write(found: Sequence[dict[str, Any]], folder: Path) -> Path:
    """Write stability.html into a folder, from plain values that the laboratory hands over."""
    macro = len(found[0]["pattern"]) > 1
    name = "omega H" if macro else "omega h"
    charts = [chart for field, *look in _CURVES if (chart := _curve(found, field, name, *look))]
    pattern = "/".join(f"{f:.4g}" for f in found[0]["pattern"])
    maps = [
        (f"{f['integrator']}: spectral radius over {across} and {m['over']}", _png(chart))
        for f in found
        for m in f["maps"]
        for across in ["omega H" if macro or m["over"] == "step ratio" else "omega h"]
        if (chart := _map(m, across))
    ]
    text = template("stability.html.j2").render(
        system=found[0]["system"],
        pattern=pattern if macro else "",
        tables=[_facts(found, name), _numbers(found, name), *_safe(found), *_theory(found)],
        charts=[_svg(chart) for chart in charts],
        maps=maps,
        steps=found[0]["first_steps"],
    )
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / FILE
    path.write_text(text, encoding="utf-8")
    return path


def _svg(chart: Spec) -> str:
    return vl_convert.vegalite_to_svg(chart)


def _png(chart: Spec) -> str:
    """A picture in a page: thousands of tiles are a small image and a large drawing."""
    image = base64.b64encode(vl_convert.vegalite_to_png(chart, scale=1.5)).decode()
    return f"data:image/png;base64,{image}"


# ---- charts ------------------------------------------------------------------------------
def _curve(
    found: Sequence[dict[str, Any]], field: str, name: str, title: str, logarithmic: bool
) -> Spec | None:
    """One quantity over omega h, a line per integrator; None if nobody has it."""
    rows = []
    for f in found:
        for omega_h, value in zip(f["omega_h"], f[field], strict=True):
            if value is None and field == "radius":
                value = math.inf
            if value is None or (logarithmic and not abs(value) > 1e-12):
                continue
            shown = abs(value) if logarithmic else min(value, _TOP)
            if math.isfinite(shown):
                row = {"omega_h": short(omega_h), "value": short(shown)}
                rows.append({"series": f["integrator"], **row})
    if not rows:
        return None
    data = Data(field, rows)
    view = View(looks_of((f["integrator"], f["family"]) for f in found))
    values = [row["value"] for row in rows]
    x_axis = log_axis([row["omega_h"] for row in rows], "~g")
    y = quantity("value", title=title, scale={"zero": True})
    if logarithmic:
        y |= {"scale": log_scale(), "axis": log_axis(values, ".0e")}
    line: Spec = {
        "mark": {"type": "line", "strokeWidth": 1.8, "clip": True},
        "encoding": {
            "x": quantity("omega_h", title=name, scale=log_scale(), axis=x_axis),
            "y": y,
            "color": by_series(view.colors, view),
            "strokeDash": by_series(view.dashes, view),
        },
    }
    one: Spec = {
        "data": {"values": [{"one": 1}]},
        "mark": {"type": "rule", "strokeDash": [3, 3], "opacity": 0.6},
        "encoding": {"y": quantity("one")},
    }
    behind = [one] if field == "radius" else []
    return arrange([{"data": data.source, "layer": [*behind, line]}], [data], 2)


def _map(m: dict[str, Any], name: str) -> Spec | None:
    """Spectral radii over omega h and another number, as tiles."""
    rows = []
    values, across = [row["value"] for row in m["rows"]], m["omega_h"]
    if len(values) < 2:
        return None
    tall = values[1] - values[0]
    wide = math.sqrt(across[1] / across[0])
    # Ratios are spaced evenly in their logarithm, options in themselves.
    logarithmic = abs(values[2] / values[1] - values[1] / values[0]) < 1e-9 if values[0] else False
    step = math.sqrt(values[1] / values[0]) if logarithmic else tall / 2
    for row in m["rows"]:
        v = row["value"]
        low, high = (v / step, v * step) if logarithmic else (v - step, v + step)
        for omega_h, radius in zip(across, row["radii"], strict=True):
            rows.append(
                {
                    "left": short(omega_h / wide),
                    "right": short(omega_h * wide),
                    "low": low,
                    "high": high,
                    "radius": 1e9 if radius is None else radius,
                }
            )
    data = Data("map", rows)
    scale = {"type": "log" if logarithmic else "linear", "nice": False, "zero": False}
    colors = {"type": "threshold", "domain": list(_BORDERS), "range": list(_COLORS)}
    x_axis = log_axis(across, "~g")
    legend = {"title": "spectral radius", "orient": "right", "format": ".4~g"}
    tile: Spec = {
        "data": data.source,
        "mark": {"type": "rect", "clip": True},
        "encoding": {
            "x": quantity("left", title=name, scale=log_scale() | {"padding": 0}, axis=x_axis),
            "x2": {"field": "right"},
            "y": quantity("low", title=m["over"], scale=scale),
            "y2": {"field": "high"},
            "color": quantity("radius", scale=colors, legend=legend),
        },
    }
    return arrange([tile], [data], 2)


# ---- tables ------------------------------------------------------------------------------
def _facts(found: Sequence[dict[str, Any]], name: str) -> Table:
    rows = []
    for f in found:
        powers = f["overshoot_orders"]
        rows.append(
            [
                f["integrator"],
                number(f["radius_at_infinity"]),
                _roots(f["roots_at_infinity"]),
                "–" if f["order"] is None else str(f["order"]),  # noqa: RUF001
                _ranges(f["growing"]),
                number(f["bifurcation"]),
                "–" if powers is None else f"{powers[0]}, {powers[1]}",  # noqa: RUF001
            ]
        )
    head = ["integrator", "radius at infinity", "roots there", "order", f"grows for {name} in",
            "bifurcation", "overshoot grows by the power (q, v)"]  # fmt: skip
    return Table(
        "What was found",
        head,
        rows,
        note="Order: that of the principal root. Growth: a radius above 1 by more than 1e-9. "
        "Bifurcation: where the principal pair turns real. A root with a times sign is multiple; "
        "on the unit circle it has to be simple.",
    )


def _numbers(found: Sequence[dict[str, Any]], name: str) -> Table:
    rows = [
        [f["integrator"], f"{row[0]:.6g}", "inf" if row[1] is None else f"{row[1]:.12f}"]
        + [number(value) for value in row[2:]]
        for f in found
        for row in zip(*f["at"].values(), strict=True)
    ]
    head = ["integrator", name, "radius", "damping ratio", "period error", "overshoot q",
            "overshoot v"]  # fmt: skip
    return Table(f"Numbers over {name}", head, rows)


def _safe(found: Sequence[dict[str, Any]]) -> list[Table]:
    rows = []
    for f in found:
        for kind, safe in f["safe"].items():
            word = safe["word"]
            steps = "".join("+" if k > 0 else "-" if k < 0 else "0" for k in word or ())
            ratio = "above 10" if safe["ratio"] is None else number(safe["ratio"])
            kinds = {"alternating": "two in turns", "any": "any of up to six steps"}
            cells = [kinds[kind], ratio, steps, number(safe["omega_h"])]
            growth = "" if safe["radius"] is None else f"{safe['radius'] - 1:.1e}"
            rows.append([f["integrator"], *cells, growth])
    if not rows:
        return []
    head = ["integrator", "steps", "largest safe ratio", "first to grow", "at omega H", "growth"]
    return [
        Table(
            "Ratios of neighbouring steps",
            head,
            rows,
            code=(0, 3),
            note="The largest ratio, of growth and of cut alike, below which no pattern grows. "
            "Patterns are made of one ratio: + is a step larger by it, - one smaller by it, 0 one "
            "of equal size. Growth is that over one period just beyond the safe ratio.",
        )
    ]


def _theory(found: Sequence[dict[str, Any]]) -> list[Table]:
    rows = [
        [
            f["integrator"],
            group,
            _coefficients(formula["rho"]),
            _coefficients(formula["sigma"]),
            str(formula["order"]),
            _told(formula["zero_roots"], formula["zero_stable"]),
            _told(formula["infinity_roots"], formula["infinity_stable"]),
        ]
        for f in found
        if f["theory"]
        for group, formula in f["theory"]["formulas"].items()
    ]
    if not rows:
        return []
    smallest = "; ".join(
        f"{f['integrator']} {number(f['theory']['smallest_ratio'])}" for f in found if f["theory"]
    )
    head = ["integrator", "of", "rho", "sigma", "order", "roots of rho", "roots of sigma"]
    return [
        Table(
            "The same methods as linear multistep formulas",
            head,
            rows,
            note="rho(E) u = h^k sigma(E) d^k u/dt^k with k = 2 for q and 1 for v and x; "
            "coefficients from the highest power of E. Roots of rho govern small steps, those of "
            "sigma infinite frequency. Smallest ratio of neighbouring steps that keeps an updated "
            f"gamma in its interval, alpha_m/(1 - alpha_m): {smallest}.",
        )
    ]


def _coefficients(values: Sequence[float]) -> str:
    return ", ".join(f"{round(value, 12) + 0.0:.6g}" for value in values)


def _root(re: float, im: float, times: int) -> str:
    text = f"{round(re, 6) + 0.0:.4g}"
    text += f"{im:+.4g}i" if abs(im) > 1e-6 else ""
    return text + (f" (×{times})" if times > 1 else "")  # noqa: RUF001


def _roots(roots: Sequence[Any]) -> str:
    return ", ".join(_root(root["re"], root["im"], times) for root, times in roots) or "infinite"


def _told(roots: Sequence[dict[str, Any]], good: bool) -> str:
    text = ", ".join(_root(r["re"], r["im"], r["times"]) for r in roots)
    return text + ("" if good else ": not stable")


def _ranges(ranges: Sequence[Sequence[float | None]]) -> str:
    ends = (f"{number(a)} to {'infinity' if b is None else number(b)}" for a, b in ranges)
    return "; ".join(ends) or "none"
