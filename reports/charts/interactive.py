"""Errors against costs with menus, and acceleration beside position accuracy."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from bench.results import quantities
from bench.results.quantities import NORMS
from reports.charts.panels import floor_layer, floor_row
from reports.charts.vega import (
    GREY,
    Data,
    Spec,
    View,
    arrange,
    by_series,
    config,
    dimmed,
    log_axis,
    log_scale,
    menu,
    pick,
    quantity,
    short,
    zoom,
)
from reports.series import (
    GROUP_NAMES,
    NORM_NAMES,
    Look,
    Series,
    error_of,
    floor_of,
    seconds_of,
    size_of,
)

#: What an error can be set against, by the column that holds it.
_COUNTS = ("jacobians", "factorisations", "newton", "steps")
COSTS = {cost: quantities.COSTS[cost] for cost in ("seconds", "residuals", *_COUNTS)} | {
    "h": "step size h in s",
    "rtol": "relative tolerance",
}


def explorer(
    series: Sequence[Series], groups: Sequence[str], looks: Mapping[str, Look]
) -> Spec | None:
    """Any group in any norm against any cost, chosen by menus; None if nothing is to be drawn."""
    series = [s for s in series if s.ok]
    view = View({s.label: looks[s.label] for s in series}, interactive=True)
    rows: list[dict[str, Any]] = []
    for s in series:
        for r in s.ok:
            run = {
                "series": s.label,
                "look": list(view.looks).index(s.label),
                "run": r.resolution,
                "fastest": short(min(r.run_s, default=None)),
                "slowest": short(max(r.run_s, default=None)),
                "seconds": short(seconds_of(r)),
                "h": short(r.h),
                "rtol": short(r.rtol),
                **{cost: r.work.get(cost) for cost in COSTS if cost in r.work},
            }
            # A column per error, not a row: the page stays small.
            errors = {
                f"{group}_{norm}": error
                for group in groups
                for norm in NORMS
                if (error := short(error_of(r, group, norm)))
            }
            rows += [run | errors] if errors else []
    if not rows:
        return None
    data = Data("runs", rows)
    costs = [cost for cost in COSTS if any(row.get(cost) for row in rows)]
    first = "a" if "a" in groups else groups[0]
    params = [
        menu("group", first, {g: GROUP_NAMES[g] for g in groups}, "error in "),
        menu("norm", "max", NORM_NAMES, " taken "),
        menu("cost", costs[0], {c: COSTS[c] for c in costs}, " against "),
    ]
    titles = json.dumps(COSTS), json.dumps(GROUP_NAMES)
    tips = [
        {"field": "series", "type": "nominal", "title": "integrator"},
        {"field": "run", "type": "nominal", "title": "resolution"},
        quantity("error", title="error", format=".3g"),
        *(quantity(c, title=COSTS[c], format=".3g") for c in costs if c not in ("h", "rtol")),
    ]
    floors = _floors(series, groups, rows)
    lines = _lines(view, "across", "error", "seconds", tips)
    for channel, numbers in (("x", "~g"), ("y", ".0e")):
        # The range is the menus' choice: the digits 1, 2, 5 where they fit.
        lines[0]["encoding"][channel]["axis"] = log_axis((1, 50), numbers, minExtent=40)
    # One view, not a grid of one: the titles have to know its width and height.
    return {
        "datasets": {table.name: table.text for table in (data, floors) if table.rows},
        "params": params,
        "data": data.source,
        "transform": [
            {"calculate": "datum[group + '_' + norm]", "as": "error"},
            {"calculate": "datum[cost]", "as": "across"},
            {"filter": "datum.error > 0 && datum.across > 0"},
            {"calculate": "cost === 'seconds' ? datum.fastest : datum.across", "as": "low"},
            {"calculate": "cost === 'seconds' ? datum.slowest : datum.across", "as": "high"},
        ],
        "layer": [
            *([_floor_line(floors)] if floors.rows else []),
            *lines,
            {
                "mark": {"type": "rule", "strokeWidth": 1},
                "encoding": {
                    "x": quantity("low", scale=log_scale()),
                    "x2": {"field": "high"},
                    "y": quantity("error", scale=log_scale()),
                    "color": by_series(view.colors, view),
                    "opacity": dimmed(0.45, view),
                },
            },
            _title(f"{titles[0]}[cost]", x="width / 2", y="height + 34"),
            _title(f"'relative error in ' + {titles[1]}[group]", x="-56", y="height / 2", turn=270),
        ],
        "width": 620,
        "height": 340,
        "config": config(),
    }


def accuracy(
    series: Sequence[Series],
    looks: Mapping[str, Look],
    norm: str = "max",
    interactive: bool = False,
) -> Spec | None:
    """Error in the acceleration over the error in the position, a line per integrator.

    Below the grey diagonal accelerations are relatively better than positions, above it worse.
    """
    series = [s for s in series if s.ok]
    view = View({s.label: looks[s.label] for s in series}, norm, interactive)
    rows = [
        {
            "series": s.label,
            "look": list(view.looks).index(s.label),
            "run": r.resolution,
            "norm": n,
            "q": q,
            "a": a,
            "h": short(size_of(r)),
        }
        for s in series
        for r in s.ok
        for n in view.norms
        if (q := short(error_of(r, "q", n))) and (a := short(error_of(r, "a", n)))
    ]
    if not rows:
        return None
    data = Data("accuracy", rows)
    ends = [f([row[g] for row in rows for g in "qa"]) for f in (min, max)]
    line: Spec = {
        "data": {"values": [{"q": e, "a": e} for e in ends]},
        "mark": {"type": "line", "color": GREY, "strokeWidth": 1, "strokeDash": [5, 5]},
        "encoding": {g: quantity(f, scale=log_scale()) for g, f in (("x", "q"), ("y", "a"))},
    }
    tips = [
        {"field": "series", "type": "nominal", "title": "integrator"},
        {"field": "run", "type": "nominal", "title": "resolution"},
        quantity("q", title="error in q", format=".3g"),
        quantity("a", title="error in a", format=".3g"),
    ]
    layers = _lines(view, "q", "a", "h", tips)
    for channel, group in (("x", "q"), ("y", "a")):
        axis = log_axis([row[group] for row in rows], ".0e")
        layers[0]["encoding"][channel] |= {
            "title": f"relative error in {GROUP_NAMES[group]}",
            "axis": axis,
        }
    panel: Spec = {"data": data.source, "layer": [line, *layers]}
    if interactive:
        panel["transform"] = [{"filter": "datum.norm == norm"}]
    return arrange([panel], [data], 1, height=340, params=view.controls)


def _lines(view: View, x: str, y: str, order: str, tips: list[Spec]) -> list[Spec]:
    """A line and its points for every series, log-log; the first layer listens to the pointer."""
    color = {"color": by_series(view.colors, view), "opacity": dimmed(1.0, view)}
    place = {
        "x": quantity(x, title=None, scale=log_scale()),
        "y": quantity(y, title=None, scale=log_scale()),
    }
    numbers = [str(i) for i in range(len(view.looks))]
    dash = {
        "field": "look",
        "type": "nominal",
        "scale": {"domain": numbers, "range": view.dashes},
        "legend": None,
    }
    lines: Spec = {
        "mark": {"type": "line", "strokeWidth": 1.8},
        "encoding": {**place, "strokeDash": dash, "order": quantity(order), **color},
    }
    if view.interactive:
        lines["params"] = [zoom(f"zoom_{y}"), pick()]
    points: Spec = {
        "mark": {"type": "point", "filled": True, "size": 60},
        "encoding": {**place, "shape": by_series(view.shapes, view), "tooltip": tips, **color},
    }
    return [lines, points]


def _floors(
    series: Sequence[Series], groups: Sequence[str], rows: Sequence[Mapping[str, Any]]
) -> Data:
    """The reference's own error in every group and norm that is drawn."""
    runs = [r for s in series for r in s.ok]
    errors = {
        (group, norm): [row[f"{group}_{norm}"] for row in rows if f"{group}_{norm}" in row]
        for group in groups
        for norm in NORMS
    }
    table = [
        {"group": group, "norm": norm} | floor_row(floor_of(runs, group, norm), min(found))
        for (group, norm), found in errors.items()
        if found
    ]
    return Data("floors", table if any(row["seen"] for row in table) else [])


def _floor_line(floors: Data) -> Spec:
    chosen = {"transform": [{"filter": "datum.group === group && datum.norm === norm"}]}
    return {"data": floors.source} | chosen | floor_layer()


def _title(text: str, x: str, y: str, turn: int = 0) -> Spec:
    """An axis title that follows a menu: Vega-Lite's own cannot."""
    mark = {"type": "text", "text": {"expr": text}, "color": GREY, "fontSize": 12, "angle": turn}
    place = {"x": {"expr": x}, "y": {"expr": y}, "clip": False}
    return {"data": {"values": [{}]}, "mark": mark | place}
