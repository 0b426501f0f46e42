"""The Pareto front of each scene: runs that no other beats in error and cost at once."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence

from bench.results.records import Record
from reports.charts.vega import (
    GREY,
    Data,
    Spec,
    View,
    by_series,
    config,
    dimmed,
    log_axis,
    log_scale,
    menu,
    pick,
    quantity,
    short,
)
from reports.series import GROUP_NAMES, TRUST, Look, Series, error_of, floor_of, label_of
from reports.text.ranking import COSTS, JUDGED, LEAST, cost_of
from reports.text.tables import Table

_GROUP, _COST = "a", "residuals"


def front(series: Sequence[Series], group: str, cost: str) -> list[Record]:
    """The runs that are not dominated, from cheap to dear.

    A run is dominated if another costs no more and errs no more, and one of both less. Errors
    below the trust in the scene's reference count as equal, all of them that small.
    """
    runs = [r for s in series for r in s.ok]
    least = _least(runs, group)
    able = [
        (value, max(error, least), r)
        for r in runs
        if (value := cost_of(r, cost)) and (error := error_of(r, group, "max")) is not None
    ]
    able.sort(key=lambda known: known[:2])
    best: list[tuple[float, float, Record]] = []
    for value, error, r in able:
        if not best or error < best[-1][1] or (value, error) == best[-1][:2]:
            best.append((value, error, r))
    return [r for *_, r in best]


def _least(runs: Sequence[Record], group: str) -> float:
    return TRUST * floor_of(runs, group, "max")


def table(scenes: Mapping[str, Sequence[Series]], ids: Mapping[str, str]) -> Table | None:
    """Whose runs are on the front of the accelerations; ``ids`` are anchors of records by key."""
    rows, links = [], {}
    for scene, series in _compared(scenes).items():
        cells = []
        for j, cost in enumerate(COSTS, 1):
            runs = front(series, _GROUP, cost)
            counts = Counter(map(label_of, runs))
            cells.append(", ".join(f"{label} ({n})" for label, n in counts.items()))
            links[len(rows), j] = [ids[r.key] for r in runs]
        if any(cells):
            rows.append([scene, *(cell or "not measured" for cell in cells)])
    if not rows:
        return None
    return Table(
        "Not beaten in acceleration and cost at once",
        ["scene", *(LEAST[cost] for cost in COSTS)],
        rows,
        note="Integrators from cheap to accurate, with the number of their runs that no other run "
        "of the scene beats or equals in both (the Pareto front).",
        links=links,
    )


def chart(
    scenes: Mapping[str, Sequence[Series]], looks: Mapping[str, Look], interactive: bool
) -> Spec | None:
    """Error over cost of all runs, a panel per scene, with the front as a step line."""
    scenes = _compared(scenes)
    labels = list(dict.fromkeys(s.label for series in scenes.values() for s in series if s.ok))
    rows = [row for scene, series in scenes.items() for row in _rows(scene, series, labels)]
    groups = [group for group in JUDGED if any(group in row for row in rows)]
    if not groups:
        return None
    data = Data("front", rows)
    view = View({label: looks[label] for label in labels}, interactive=interactive)
    group, cost = ("group", "cost") if interactive else (f"'{_GROUP}'", f"'{_COST}'")
    tips = [
        {"field": "series", "type": "nominal", "title": "integrator"},
        {"field": "run", "type": "nominal", "title": "resolution"},
        quantity("error", title="error", format=".3g"),
        *(quantity(name, title=title, format=".3g") for name, title in COSTS.items()),
    ]
    # Every panel has its own range: the digits 1, 2, 5 where they fit.
    x_axis, y_axis = (log_axis((1, 50), text) for text in ("~g" if interactive else "~s", ".0e"))
    title = None if interactive else COSTS[_COST]
    x = quantity("across", title=title, scale=log_scale(), axis=x_axis)
    y = quantity("error", title="relative error", scale=log_scale(), axis=y_axis)
    steps: Spec = {
        "transform": [{"filter": "datum.best"}],
        "mark": {"type": "line", "interpolate": "step-after", "color": GREY, "strokeWidth": 5,
                 "opacity": 0.45, "strokeJoin": "round"},
        "encoding": {"x": x, "y": y | {"field": "level"}, "order": quantity("across")},
    }  # fmt: skip
    color = by_series(view.colors, view)
    points: Spec = {
        "mark": {"type": "point", "filled": True},
        "encoding": {
            "x": x,
            "y": y,
            "color": color,
            "shape": by_series(view.shapes, view),
            "size": {"condition": {"test": "datum.best", "value": 70}, "value": 28},
            "opacity": dimmed(1.0, view),
            "tooltip": tips,
        },
    }
    if interactive:
        points["params"] = [pick()]
    return {
        "datasets": {data.name: data.text},
        "params": _menus(groups) if interactive else [],
        "data": data.source,
        "transform": [
            {"calculate": f"{json.dumps(labels)}[datum.s]", "as": "series"},
            {"calculate": f"datum[{group}]", "as": "error"},
            {"calculate": f"datum[{cost}]", "as": "across"},
            {"calculate": f"datum[{group} + '_' + {cost}]", "as": "best"},
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


def _rows(scene: str, series: Sequence[Series], labels: Sequence[str]) -> list[dict]:
    """A row per run: its costs and errors, and for which pairs of them it is on the front."""
    runs = [r for s in series for r in s.ok]
    least = {group: _least(runs, group) for group in JUDGED}
    on = {
        f"{group}_{cost}": {r.key for r in front(series, group, cost)}
        for group in JUDGED
        for cost in COSTS
    }
    rows = []
    for s in series:
        for r in s.ok:
            row = {"scene": scene, "s": labels.index(s.label), "run": r.resolution}
            row |= {cost: short(cost_of(r, cost)) for cost in COSTS}
            for group in JUDGED:
                if (error := short(error_of(r, group, "max"))) is not None:
                    row |= {group: error, f"{group}_least": short(least[group])}
            rows.append(row | {name: 1 for name, keys in on.items() if r.key in keys})
    return rows


def _compared(scenes: Mapping[str, Sequence[Series]]) -> dict[str, Sequence[Series]]:
    """Scenes on which more than one integrator came to the end."""
    return {name: series for name, series in scenes.items() if sum(bool(s.ok) for s in series) > 1}


def _menus(groups: Sequence[str]) -> list[Spec]:
    first = _GROUP if _GROUP in groups else groups[0]
    return [
        menu("group", first, {group: GROUP_NAMES[group] for group in groups}, "error in "),
        menu("cost", _COST, COSTS, " at the cost of "),
    ]
