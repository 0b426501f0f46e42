"""The interactive work-precision chart: menus choose group, norm and cost."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from bench.results.quantities import COST, COSTS, ERROR_NAMES, NORM, NORMS, whole
from reports.charts import vega_lite as vl
from reports.charts.error_panels import error_lines, floor_layer, floor_row
from reports.charts.line_styles import LineStyle, styles_of
from reports.series import Series, cost_of, error_of, ok_runs, reference_error, seconds_of

#: Costs of the menu, by the column that holds them.
_COSTS = {
    **{c: cost.title for c, cost in COSTS.items() if c not in ("solves", "rejected")},
    "h": "step size h in s",
    "rtol": "relative tolerance",
}


def work_precision_with_menus(
    series: Sequence[Series], groups: Sequence[str], styles: Mapping[str, LineStyle]
) -> vl.Spec | None:
    """Error against cost; menus choose group, norm and cost. None if there is nothing to draw."""
    series = [s for s in series if s.ok]
    options = vl.ChartOptions(styles_of(series, styles), interactive=True)
    known = {name for r in ok_runs(series) for name in r.errors}
    errors_of = [name for name in (*groups, *map(whole, groups)) if name in known]
    rows: list[dict[str, Any]] = []
    for s in series:
        for r in s.ok:
            run = {
                "series": s.label,
                "run": r.resolution,
                "fastest": vl.short(min(r.run_s, default=None)),
                "slowest": vl.short(max(r.run_s, default=None)),
                "seconds": vl.short(seconds_of(r)),
                "h": vl.short(r.h),
                "rtol": vl.short(r.rtol),
                "operations": vl.short(cost_of(r, "operations")),
                **{cost: r.work.get(cost) for cost in _COSTS if cost in r.work},
            }
            # A column per error, not a row: the page stays small.
            errors = {
                f"{group}_{norm}": error
                for group in errors_of
                for norm in NORMS
                if (error := vl.short(error_of(r, group, norm)))
            }
            rows += [run | errors] if errors else []
    if not rows:
        return None
    data = vl.Dataset("runs", rows)
    costs = [cost for cost in _COSTS if any(row.get(cost) for row in rows)]
    first = "a" if "a" in groups else groups[0]
    params = [
        vl.menu("group", first, {name: ERROR_NAMES[name] for name in errors_of}, "error in "),
        vl.menu("norm", NORM, NORMS, " taken "),
        vl.menu(
            "cost", COST if COST in costs else costs[0], {c: _COSTS[c] for c in costs}, " against "
        ),
    ]
    tooltip = vl.run_tooltip(
        vl.quantity("error", title="error", format=".3g"),
        *(vl.quantity(c, title=_COSTS[c], format=".3g") for c in costs if c not in ("h", "rtol")),
    )
    floors = _floors(series, errors_of, rows)
    chosen = {"transform": [{"filter": "datum.group === group && datum.norm === norm"}]}
    # The range changes with the menus: the digits 1, 2, 5 have labels where they fit.
    place = {
        channel: vl.log_quantity(field, title=None, axis=vl.log_axis((1, 50), text, minExtent=40))
        for channel, field, text in (("x", "across", "~g"), ("y", "error", ".0e"))
    }
    lines = error_lines(options, place, "seconds", tooltip)
    lines[0]["params"] = [vl.zoom("zoom_error"), vl.pick()]
    # A single view, not a grid of one: the titles need its width and height.
    return {
        "datasets": vl.datasets([table for table in (data, floors) if table.rows]),
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
            *([{"data": floors.source} | chosen | floor_layer()] if floors.rows else []),
            *lines,
            {
                "mark": {"type": "rule", "strokeWidth": 1},
                "encoding": {
                    "x": vl.log_quantity("low"),
                    "x2": {"field": "high"},
                    "y": vl.log_quantity("error"),
                    "color": options.colors(),
                    "opacity": options.opacity(0.45),
                },
            },
            _title(f"{json.dumps(_COSTS)}[cost]", x="width / 2", y="height + 34"),
            _title(
                f"'relative error in ' + {json.dumps(ERROR_NAMES)}[group]",
                x="-56",
                y="height / 2",
                turn=270,
            ),
        ],
        "width": 620,
        "height": 340,
        "config": vl.config(),
    }


def _floors(
    series: Sequence[Series], groups: Sequence[str], rows: Sequence[Mapping[str, Any]]
) -> vl.Dataset:
    """The reference's own error in every group and norm; no rows if none can be seen."""
    runs = ok_runs(series)
    errors = {
        (group, norm): [row[f"{group}_{norm}"] for row in rows if f"{group}_{norm}" in row]
        for group in groups
        for norm in NORMS
    }
    table = [
        {"group": group, "norm": norm} | floor_row(reference_error(runs, group, norm), min(found))
        for (group, norm), found in errors.items()
        if found
    ]
    return vl.Dataset("floors", table if any(row["seen"] for row in table) else [])


def _title(text: str, x: str, y: str, turn: int = 0) -> vl.Spec:
    """An axis title that depends on a menu; titles of Vega-Lite cannot."""
    mark = {"type": "text", "text": {"expr": text}, "color": vl.GREY, "fontSize": 12, "angle": turn}
    place = {"x": {"expr": x}, "y": {"expr": y}, "clip": False}
    return {"data": {"values": [{}]}, "mark": mark | place}
