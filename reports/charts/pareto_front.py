"""Error over cost of all runs, with the Pareto front of each scene."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace

from bench.results.quantities import COSTS, ERROR_NAMES, NORM, RANKED_COSTS, VIOLATIONS
from bench.results.records import Record
from reports.charts import vega_lite as vl
from reports.charts.error_panels import RunRows, cost_tooltip, run_rows
from reports.charts.line_styles import LineStyle
from reports.questions.question import FIRST, TABLE_GROUPS, Question
from reports.series import Series, label_of, ok_runs, trusted_error

#: Errors of the menu.
_GROUPS = (*TABLE_GROUPS, *VIOLATIONS)


def pareto_chart(
    scenes: Mapping[str, Sequence[Series]],
    styles: Mapping[str, LineStyle],
    interactive: bool,
    first: Question = FIRST,
    own: str = "",
) -> vl.Spec | None:
    """Error over cost of all runs, a panel per scene, with the Pareto front as a step line.

    Group and cost are those of the ``first`` question, unless a reader chooses others. Of an
    ``own`` integrator there are all runs, joined by a line; of the others the front alone, for the
    first question.
    """
    # Those on which more than one integrator reached the end.
    scenes = {
        name: series
        for name, series in scenes.items()
        if len(ended := [s.label for s in series if s.ok]) > 1 and (not own or own in ended)
    }
    asked: Sequence[str] = _GROUPS
    costs: Sequence[str] = RANKED_COSTS
    if own:
        asked, costs = [first.group], [first.cost]
        scenes = {name: _against_others(series, own, first) for name, series in scenes.items()}
    rows = [
        row for scene, series in scenes.items() for row in _rows(scene, series, own, asked, costs)
    ]
    shown = {row["series"] for row in rows}
    labels = dict.fromkeys(s.label for runs in scenes.values() for s in runs if s.label in shown)
    groups = {g: ERROR_NAMES[g] for g in _GROUPS if any(f"{g}_{NORM}" in row for row in rows)}
    if not groups:
        return None
    data = vl.Dataset("pareto_front", rows)
    options = vl.ChartOptions({label: styles[label] for label in labels}, interactive=interactive)
    group, cost = ("group", "cost") if interactive else (f"'{first.group}'", f"'{first.cost}'")
    titles = {name: COSTS[name].title for name in RANKED_COSTS}
    # Every panel has its own range: the digits 1, 2, 5 have labels where they fit.
    x_axis, y_axis = (vl.log_axis((1, 50), text) for text in ("~g" if interactive else "~s", ".0e"))
    x = vl.log_quantity("across", title=None if interactive else titles[first.cost], axis=x_axis)
    y = vl.log_quantity("error", title="relative error", axis=y_axis)
    steps: vl.Spec = {
        "transform": [{"filter": "datum.on_front"}],
        "mark": {"type": "line", "interpolate": "step-after", "color": vl.GREY, "strokeWidth": 5,
                 "opacity": 0.45, "strokeJoin": "round"},
        "encoding": {"x": x, "y": y | {"field": "level"}, "order": vl.quantity("across")},
    }  # fmt: skip
    error = vl.quantity("error", title="error", format=".3g")
    points: vl.Spec = {
        "mark": {"type": "point", "filled": True},
        "encoding": {
            "x": x,
            "y": y,
            "color": options.colors(),
            "shape": options.shapes(),
            "size": {"condition": {"test": "datum.on_front", "value": 70}, "value": 28},
            "opacity": options.opacity(),
            "tooltip": vl.run_tooltip(error, *cost_tooltip(RANKED_COSTS)),
        },
    }
    line: vl.Spec = {
        "transform": [{"filter": f"datum.series === {json.dumps(own)}"}],
        "mark": {"type": "line", "strokeWidth": 2.5, "order": False},
        "encoding": {"x": x, "y": y, "color": options.colors()},
    }
    if interactive:
        points["params"] = [vl.pick()]
    menus = [
        vl.menu(
            "group",
            first.group if first.group in groups else next(iter(groups)),
            groups,
            "error in ",
        ),
        vl.menu("cost", first.cost, titles, " at the cost of "),
    ]
    return {
        "datasets": vl.datasets([data]),
        "params": menus if interactive else [],
        "data": data.source,
        "transform": [
            {"calculate": f"datum[{group} + '_{NORM}']", "as": "error"},
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
        "spec": {"layer": [steps, *([line] if own else []), points], "width": 270, "height": 170},
        "resolve": {"scale": {"x": "independent", "y": "independent"}},
        "config": vl.config(),
    }


def pareto_front(series: Sequence[Series], group: str, cost: str) -> list[Record]:
    """The runs that are not dominated, from cheap to dear.

    A run is dominated if another costs no more and errs no more, and one of both less. Errors
    that the reference is too coarse to judge count as equal.

    Parameters
    ----------
    series
        The integrators of one scene.
    group
        Group of variables; its relative error in the norm `NORM` is compared.
    cost
        A cost of `bench.results.quantities.COSTS`.
    """
    runs = ok_runs(series)
    least = trusted_error(runs, group, NORM)
    points = [
        (value, max(error, least), r)
        for r in runs
        if (value := r.cost(cost)) is not None and (error := r.error(group, NORM)) is not None
    ]
    points.sort(key=lambda point: point[:2])
    front: list[tuple[float, float, Record]] = []
    for value, error, r in points:
        if not front or error < front[-1][1] or (value, error) == front[-1][:2]:
            front.append((value, error, r))
    return [r for *_, r in front]


def _rows(
    scene: str, series: Sequence[Series], own: str, groups: Sequence[str], costs: Sequence[str]
) -> RunRows:
    """The rows of the runs, with the pairs of group and cost in which they are on the front.

    With an ``own`` integrator, the front is that of the others.
    """
    others = [s for s in series if s.label != own]
    least = {f"{g}_least": vl.short(trusted_error(ok_runs(series), g, NORM)) for g in groups}
    fronts = {
        f"{group}_{cost}": {(label_of(r), r.resolution) for r in pareto_front(others, group, cost)}
        for group in groups
        for cost in costs
    }
    return [
        {"scene": scene, **row, **least}
        | {name: 1 for name, runs in fronts.items() if (row["series"], row["run"]) in runs}
        for row in run_rows(series, groups, [NORM], RANKED_COSTS)
    ]


def _against_others(series: Sequence[Series], own: str, first: Question) -> list[Series]:
    """The runs of an integrator, and those of the others' front."""
    others = [s for s in series if s.label != own]
    front = {r.key for r in pareto_front(others, first.group, first.cost)}
    chosen = (
        replace(s, records=tuple(r for r in s.records if s.label == own or r.key in front))
        for s in series
    )
    return [s for s in chosen if s.records]
