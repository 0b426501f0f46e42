"""Error over cost of all runs, with the Pareto front of each scene."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from reports.charts.line_styles import LineStyle
from reports.charts.vega_lite import (
    GREY,
    ChartOptions,
    Dataset,
    Spec,
    by_series,
    config,
    datasets,
    dimmed,
    log_axis,
    log_scale,
    menu,
    pick,
    quantity,
    run_tooltip,
    short,
)
from reports.pareto_front import compared_scenes, pareto_front
from reports.ranking import COST, GROUP, RANKED_COSTS, RANKED_GROUPS
from reports.series import (
    GROUP_NAMES,
    Series,
    cost_of,
    error_of,
    ok_runs,
    trusted_error,
)


def pareto_chart(
    scenes: Mapping[str, Sequence[Series]], styles: Mapping[str, LineStyle], interactive: bool
) -> Spec | None:
    """Error over cost of all runs, a panel per scene, with the Pareto front as a step line."""
    scenes = compared_scenes(scenes)
    labels = list(dict.fromkeys(s.label for series in scenes.values() for s in series if s.ok))
    rows = [row for scene, series in scenes.items() for row in _rows(scene, series, labels)]
    groups = [group for group in RANKED_GROUPS if any(group in row for row in rows)]
    if not groups:
        return None
    data = Dataset("pareto_front", rows)
    options = ChartOptions({label: styles[label] for label in labels}, interactive=interactive)
    group, cost = ("group", "cost") if interactive else (f"'{GROUP}'", f"'{COST}'")
    tooltip = run_tooltip(
        quantity("error", title="error", format=".3g"),
        *(quantity(name, title=title, format=".3g") for name, title in RANKED_COSTS.items()),
    )
    # Every panel has its own range: the digits 1, 2, 5 have labels where they fit.
    x_axis, y_axis = (log_axis((1, 50), text) for text in ("~g" if interactive else "~s", ".0e"))
    title = None if interactive else RANKED_COSTS[COST]
    x = quantity("across", title=title, scale=log_scale(), axis=x_axis)
    y = quantity("error", title="relative error", scale=log_scale(), axis=y_axis)
    steps: Spec = {
        "transform": [{"filter": "datum.on_front"}],
        "mark": {"type": "line", "interpolate": "step-after", "color": GREY, "strokeWidth": 5,
                 "opacity": 0.45, "strokeJoin": "round"},
        "encoding": {"x": x, "y": y | {"field": "level"}, "order": quantity("across")},
    }  # fmt: skip
    color = by_series(options.colors, options)
    points: Spec = {
        "mark": {"type": "point", "filled": True},
        "encoding": {
            "x": x,
            "y": y,
            "color": color,
            "shape": by_series(options.shapes, options),
            "size": {"condition": {"test": "datum.on_front", "value": 70}, "value": 28},
            "opacity": dimmed(1.0, options),
            "tooltip": tooltip,
        },
    }
    if interactive:
        points["params"] = [pick()]
    return {
        "datasets": datasets([data]),
        "params": _menus(groups) if interactive else [],
        "data": data.source,
        "transform": [
            {"calculate": f"{json.dumps(labels)}[datum.s]", "as": "series"},
            {"calculate": f"datum[{group}]", "as": "error"},
            {"calculate": f"datum[{cost}]", "as": "across"},
            {"calculate": f"datum[{group} + '_' + {cost}]", "as": "on_front"},
            {"calculate": f"max(datum.error, datum[{group} + '_least'])", "as": "level"},
            # A scene without the group loses its panel, not only its points.
            {"filter": "datum.error > 0 && datum.across > 0"},
        ],
        "facet": {
            "field": "scene",
            "type": "nominal",
            "sort": list(scenes),
            "title": None,
            "header": {"labelColor": GREY, "labelFontSize": 12, "labelFontWeight": "bold"},
        },
        "columns": 3,
        "spec": {"layer": [steps, points], "width": 270, "height": 170},
        "resolve": {"scale": {"x": "independent", "y": "independent"}},
        "config": config(),
    }


def _rows(scene: str, series: Sequence[Series], labels: Sequence[str]) -> list[dict[str, Any]]:
    """A row per run: its costs and errors, and the pairs of them in which it is on the front."""
    runs = ok_runs(series)
    least = {group: trusted_error(runs, group, "max") for group in RANKED_GROUPS}
    fronts = {
        f"{group}_{cost}": {r.key for r in pareto_front(series, group, cost)}
        for group in RANKED_GROUPS
        for cost in RANKED_COSTS
    }
    rows = []
    for s in series:
        for r in s.ok:
            row = {"scene": scene, "s": labels.index(s.label), "run": r.resolution}
            row |= {cost: short(cost_of(r, cost)) for cost in RANKED_COSTS}
            for group in RANKED_GROUPS:
                if (error := short(error_of(r, group, "max"))) is not None:
                    row |= {group: error, f"{group}_least": short(least[group])}
            rows.append(row | {name: 1 for name, keys in fronts.items() if r.key in keys})
    return rows


def _menus(groups: Sequence[str]) -> list[Spec]:
    first = GROUP if GROUP in groups else groups[0]
    return [
        menu("group", first, {group: GROUP_NAMES[group] for group in groups}, "error in "),
        menu("cost", COST, RANKED_COSTS, " at the cost of "),
    ]
