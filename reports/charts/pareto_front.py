"""Error over cost of all runs, with the Pareto front of each scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.results.quantities import COST, COSTS, GROUP_NAMES, NORM, RANKED_COSTS
from reports.charts import vega_lite as vl
from reports.charts.line_styles import LineStyle
from reports.pareto_front import compared_scenes, pareto_front
from reports.ranking import GROUP, RANKED_GROUPS
from reports.series import Series, cost_of, error_of, ok_runs, trusted_error


def pareto_chart(
    scenes: Mapping[str, Sequence[Series]], styles: Mapping[str, LineStyle], interactive: bool
) -> vl.Spec | None:
    """Error over cost of all runs, a panel per scene, with the Pareto front as a step line."""
    scenes = compared_scenes(scenes)
    labels = list(dict.fromkeys(s.label for series in scenes.values() for s in series if s.ok))
    rows = [row for scene, series in scenes.items() for row in _rows(scene, series)]
    groups = [group for group in RANKED_GROUPS if any(group in row for row in rows)]
    if not groups:
        return None
    data = vl.Dataset("pareto_front", rows)
    options = vl.ChartOptions({label: styles[label] for label in labels}, interactive=interactive)
    group, cost = ("group", "cost") if interactive else (f"'{GROUP}'", f"'{COST}'")
    titles = {name: COSTS[name].title for name in RANKED_COSTS}
    tooltip = vl.run_tooltip(
        vl.quantity("error", title="error", format=".3g"),
        *(vl.quantity(name, title=title, format=".3g") for name, title in titles.items()),
    )
    # Every panel has its own range: the digits 1, 2, 5 have labels where they fit.
    x_axis, y_axis = (vl.log_axis((1, 50), text) for text in ("~g" if interactive else "~s", ".0e"))
    title = None if interactive else titles[COST]
    x = vl.log_quantity("across", title=title, axis=x_axis)
    y = vl.log_quantity("error", title="relative error", axis=y_axis)
    steps: vl.Spec = {
        "transform": [{"filter": "datum.on_front"}],
        "mark": {"type": "line", "interpolate": "step-after", "color": vl.GREY, "strokeWidth": 5,
                 "opacity": 0.45, "strokeJoin": "round"},
        "encoding": {"x": x, "y": y | {"field": "level"}, "order": vl.quantity("across")},
    }  # fmt: skip
    points: vl.Spec = {
        "mark": {"type": "point", "filled": True},
        "encoding": {
            "x": x,
            "y": y,
            "color": options.colors(),
            "shape": options.shapes(),
            "size": {"condition": {"test": "datum.on_front", "value": 70}, "value": 28},
            "opacity": options.opacity(),
            "tooltip": tooltip,
        },
    }
    if interactive:
        points["params"] = [vl.pick()]
    first, names = GROUP if GROUP in groups else groups[0], {g: GROUP_NAMES[g] for g in groups}
    menus = [
        vl.menu("group", first, names, "error in "),
        vl.menu("cost", COST, titles, " at the cost of "),
    ]
    return {
        "datasets": vl.datasets([data]),
        "params": menus if interactive else [],
        "data": data.source,
        "transform": [
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
            "header": {"labelColor": vl.GREY, "labelFontSize": 12, "labelFontWeight": "bold"},
        },
        "columns": 3,
        "spec": {"layer": [steps, points], "width": 270, "height": 170},
        "resolve": {"scale": {"x": "independent", "y": "independent"}},
        "config": vl.config(),
    }


def _rows(scene: str, series: Sequence[Series]) -> list[dict[str, Any]]:
    """A row per run: its costs and errors, and the pairs of them in which it is on the front."""
    runs = ok_runs(series)
    least = {group: trusted_error(runs, group, NORM) for group in RANKED_GROUPS}
    fronts = {
        f"{group}_{cost}": {r.key for r in pareto_front(series, group, cost)}
        for group in RANKED_GROUPS
        for cost in RANKED_COSTS
    }
    rows = []
    for s in series:
        for r in s.ok:
            row = {"scene": scene, "series": s.label, "run": r.resolution}
            row |= {cost: vl.short(cost_of(r, cost)) for cost in RANKED_COSTS}
            for group in RANKED_GROUPS:
                if (error := vl.short(error_of(r, group, NORM))) is not None:
                    row |= {group: error, f"{group}_least": vl.short(least[group])}
            rows.append(row | {name: 1 for name, keys in fronts.items() if r.key in keys})
    return rows
