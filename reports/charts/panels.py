"""One panel each: errors of a group against step size or cost, a component over time."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Any

from bench.results.quantities import NORMS
from bench.results.records import Rows
from reports.charts.vega import (
    GREY,
    Data,
    Spec,
    View,
    by_series,
    dimmed,
    log_axis,
    log_scale,
    pick,
    quantity,
    short,
    zoom,
)
from reports.series import (
    GROUP_NAMES,
    Series,
    error_of,
    floor_of,
    seconds_of,
    size_of,
    whole_order,
)

#: A group with more components than this is drawn by its first ones.
MOST_COMPONENTS = 3
#: How an axis writes its numbers; counts have a suffix.
#: A reference's error is drawn if it lies less than this factor below the errors.
DEEP = 1e3
_FORMATS = {"h": "~g", "seconds": ".0e"}
#: A guide to the eye runs this factor above the errors.
_CLEAR = 2.0


# ---- errors ------------------------------------------------------------------------------
def error_data(
    series: Sequence[Series], group: str, view: View, counts: Sequence[str] = ("residuals",)
) -> Data:
    """One row per run and norm, named after the group; errors that a log axis can show."""
    rows, labels = [], list(view.looks)
    for s in series:
        for record in s.ok:
            run = {
                "look": labels.index(s.label),
                "h": short(size_of(record)),
                "run": record.resolution,
                "seconds": short(seconds_of(record)),
                "fastest": short(min(record.run_s, default=None)),
                "slowest": short(max(record.run_s, default=None)),
                **{name: record.work.get(name) for name in counts},
            }
            for norm in view.norms:
                error = short(error_of(record, group, norm))
                if error is not None and error > 0:
                    rows.append({"series": s.label, "norm": norm, "error": error, **run})
    return Data(group, rows)


def full_norm(series: Sequence[Series], groups: Sequence[str], norm: str) -> str:
    """The norm, or where a group has no error above zero in it, the first in which all have."""

    def full(norm: str) -> bool:
        runs = [r for s in series for r in s.ok]
        return all(any(error_of(r, group, norm) for r in runs) for group in groups)

    return norm if full(norm) else next(filter(full, NORMS), norm)


def error_panel(
    data: Data, across: tuple[str, str], view: View, first: bool, behind: Sequence[Spec] = ()
) -> Spec | None:
    """Error against (field, title), log-log: lines and points before the layers ``behind``.

    None if nothing is there to draw. The first panel hears the clicks on the legend of all.
    """
    field, title = across
    rows = [row for row in data.rows if row.get(field)]
    if not rows:
        return None
    zoomed = f"zoom_{field}_{data.name}" if view.interactive else ""
    x_axis = log_axis(
        [row[field] for row in rows], _FORMATS.get(field, "~s"), zoomed and f"{zoomed}.{field}"
    )
    y_axis = log_axis([row["error"] for row in rows], ".0e", zoomed and f"{zoomed}.error")
    x = quantity(field, title=title, scale=log_scale(), axis=x_axis)
    y_title = f"relative error in {GROUP_NAMES[data.name]}"
    y = quantity("error", title=y_title, scale=log_scale(), axis=y_axis | {"minExtent": 38})
    color = {"color": by_series(view.colors, view)}
    bright = color | {"opacity": dimmed(1.0, view)}
    # Dashes around a point would spoil the legend: they go by number and stay out of it.
    numbers = [str(i) for i in range(len(view.looks))]
    dash = {"field": "look", "scale": {"domain": numbers, "range": view.dashes}, "legend": None}
    lines: Spec = {
        "mark": {"type": "line", "strokeWidth": 1.8},
        "encoding": {"x": x, "strokeDash": dash | {"type": "nominal"}, "order": quantity("h")}
        | bright,
    }
    points: Spec = {
        "mark": {"type": "point", "filled": True, "size": 55},
        "encoding": {"x": x, "shape": by_series(view.shapes, view), "tooltip": _tips(data.name)}
        | bright,
    }
    layers = [lines, points]
    if field == "seconds":
        fastest = quantity("fastest", title=title, scale=log_scale())
        ends = {"x": fastest, "x2": {"field": "slowest"}, "opacity": dimmed(0.45, view)}
        layers.append({"mark": {"type": "rule", "strokeWidth": 1}, "encoding": ends | color})
    filters = [f"datum.{field} > 0"]
    if view.interactive:
        filters.append("datum.norm == norm")
        # The first layer: the shared legend answers only to that one's selection.
        lines["params"] = [zoom(zoomed), *([pick()] if first else [])]
    return {
        "data": data.source,
        "transform": [{"filter": text} for text in filters],
        "encoding": {"y": y},
        "layer": [*behind, *layers],
    }


def _tips(group: str) -> list[Spec]:
    return [
        {"field": "series", "type": "nominal", "title": "integrator"},
        {"field": "run", "type": "nominal", "title": "resolution"},
        quantity("error", title=f"error in {group}", format=".3g"),
        quantity("seconds", title="median s", format=".3g"),
        quantity("residuals", title="residual evaluations", format="d"),
    ]


def floor_row(floor: float, lowest: float) -> dict[str, float | int | None]:
    """The reference's own error, unless it lies so deep that it would squeeze the lines.

    Then an unseen line at the lowest error takes its place: a scale with no value to show warns.
    """
    seen = floor > 0 and floor * DEEP >= lowest
    return {"floor": short(floor if seen else lowest), "seen": int(seen)}


def floor_layer() -> Spec:
    """A dashed line at the floor."""
    return {
        "mark": {"type": "rule", "color": GREY, "strokeDash": [5, 5]},
        "encoding": {
            "y": quantity("floor", scale=log_scale()),
            "opacity": {"condition": {"test": "datum.seen", "value": 1}, "value": 0},
            "tooltip": quantity("floor", title="reference's own error", format=".2g"),
        },
    }


def floor_rule(series: Sequence[Series], data: Data, view: View) -> list[Spec]:
    """The reference's own error in every norm of a panel, where it can be seen in one of them."""
    runs, rows = [r for s in series for r in s.ok], []
    for norm in view.norms:
        errors = [row["error"] for row in data.rows if row["norm"] == norm]
        if errors:
            rows.append({"norm": norm} | floor_row(floor_of(runs, data.name, norm), min(errors)))
    if not any(row["seen"] for row in rows):
        return []
    layer = {"data": {"values": rows}} | floor_layer()
    if view.interactive:
        layer["transform"] = [{"filter": "datum.norm == norm"}]
    return [layer]


def slope_guides(series: Sequence[Series], data: Data, view: View) -> list[Spec]:
    """A thin line for each whole order found, over the highest errors that were fitted by it."""
    found = {norm: list(_guides(series, data.name, norm)) for norm in view.norms}
    if not any(found.values()):
        return []
    rows = [row for norm, guides in found.items() for row in guides or _nothing(data, norm)]
    layer: Spec = {"data": {"values": rows}}
    if view.interactive:
        layer["transform"] = [{"filter": "datum.norm == norm"}]
    x, y = quantity("h", scale=log_scale()), quantity("error", scale=log_scale())
    ends = {"x": x, "y": y, "x2": {"field": "h2"}, "y2": {"field": "error2"}}
    rule = {"type": "rule", "color": GREY, "strokeWidth": 1}
    text = {"type": "text", "color": GREY, "align": "right", "dx": -6, "dy": -5}
    named = {"x": x, "y": y, "text": {"field": "name"}}
    return [layer | {"mark": rule, "encoding": ends}, layer | {"mark": text, "encoding": named}]


def _nothing(data: Data, norm: str) -> list[dict[str, Any]]:
    """A guide of no length in the place of none: a scale with no value to show warns."""
    rows = [row for row in data.rows if row["norm"] == norm][:1]
    return [
        {"norm": norm, "name": "", "h": h, "error": error, "h2": h, "error2": error}
        for h, error in ((row["h"], row["error"]) for row in rows)
    ]


def _guides(series: Sequence[Series], group: str, norm: str) -> Iterator[dict[str, Any]]:
    fits = [(s, fit) for s in series if (fit := s.fit(group, norm)).window]
    for order in sorted({whole for _, fit in fits if (whole := whole_order(fit))}):
        ends = []
        for s, fit in fits:
            if whole_order(fit) == order:
                coarse, fine = fit.window
                last = min(s.ok, key=lambda r, h=fine: abs(size_of(r) - h))
                ends.append((_CLEAR * error_of(last, group, norm), fine, coarse))
        error, fine, coarse = max(ends)
        yield {
            "norm": norm,
            "name": f"order {order}",
            "h": short(coarse),
            "error": short(error * (coarse / fine) ** order),
            "h2": short(fine),
            "error2": short(error),
        }


# ---- values over time --------------------------------------------------------------------
def run_lines(
    data: Data, field: str, title: str, labels: Sequence[str], view: View, first: bool
) -> Spec:
    """One component over time, a line per run."""
    legend = {"symbolType": "stroke", "symbolSize": 400}
    layer: Spec = {
        "data": data.source,
        "transform": [{"calculate": f"{json.dumps(list(labels))}[datum.s]", "as": "series"}],
        "mark": {"type": "line", "strokeWidth": 1.4, "clip": True},
        "encoding": {
            **_over_time(field, title),
            "color": by_series(view.colors, view, **legend),
            "strokeDash": by_series(view.dashes, view, **legend),
            "opacity": dimmed(1.0, view),
        },
    }
    if view.interactive:
        layer["params"] = [zoom(f"zoom_{field}"), *([pick()] if first else [])]
    return layer


def reference_line(data: Data, field: str, title: str) -> Spec:
    """One component of the reference over time, broad and grey."""
    mark = {"type": "line", "color": GREY, "strokeWidth": 5, "opacity": 0.4, "clip": True}
    return {"data": data.source, "mark": mark, "encoding": _over_time(field, title)}


def _over_time(field: str, title: str) -> Spec:
    return {
        "x": quantity("t", title="time in s", scale={"nice": False, "zero": False}),
        "y": quantity(field, title=title, scale={"zero": False}),
    }


def component(group: str, i: int, coordinates: Sequence[str]) -> str:
    """A component as an axis names it: q[X], lam[1]."""
    name = coordinates[i] if group in "qva" and i < len(coordinates) else str(i + 1)
    return f"{group}[{name}]"


def first_components(groups: Sequence[str]) -> list[tuple[str, int]]:
    """The first components of every group: motion a row per coordinate, then the others."""
    motion = [(g, i) for i in range(MOST_COMPONENTS) for g in groups if g in "qva"]
    return motion + [(g, i) for g in groups if g not in "qva" for i in range(MOST_COMPONENTS)]


def wide_rows(
    rows: Rows, components: Sequence[tuple[str, int]], number_of_run: int
) -> list[dict[str, Any]]:
    """A row per time with these components, as far as they are there."""
    table = []
    for k, t in enumerate(rows.t):
        row: dict[str, Any] = {"t": short(t), "s": number_of_run}
        for group, i in components:
            values = rows.values.get(group) or []
            if (
                k < len(values)
                and i < len(values[k])
                and (shown := short(values[k][i])) is not None
            ):
                row[f"{group}{i}"] = shown
        table.append(row)
    return table
