"""The pieces of which charts are made: rows, panels, scales and ways to point at things."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import altair as alt

from bench.records import NORMS, Rows
from reports.series import (
    GROUP_NAMES,
    NORM_NAMES,
    Look,
    Series,
    error_of,
    seconds_of,
    size_of,
)

GREY = "#808080"
#: A group with more components than this is drawn by its first ones.
MOST_COMPONENTS = 3
_FORMATS = {"seconds": ".0e", "residuals": "~s"}


@dataclass(frozen=True)
class View:
    """How a chart is to look: a look per label, the norm shown, alive or a still picture."""

    looks: Mapping[str, Look]
    norm: str = "end"
    interactive: bool = False


def csv_data(rows: Sequence[Mapping[str, Any]]) -> alt.InlineData:
    """Rows as one string of comma-separated values: names once, and nothing to copy or check."""
    head = list(dict.fromkeys(key for row in rows for key in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, head, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    words = {"series", "look", "norm", "run", "line"}
    parse = {key: "string" if key in words else "number" for key in head}
    return alt.InlineData(values=text.getvalue(), format={"type": "csv", "parse": parse})


def error_panel(
    series: Sequence[Series], group: str, across: tuple[str, str], view: View, first: bool
) -> alt.LayerChart | None:
    """Error in one group against (field, title), log-log: lines, points and the floor.

    None if nothing is there to draw. The first panel of a chart takes the controls of all.
    """
    field, title = across
    norms = NORMS if view.interactive else (view.norm,)
    rows = _error_rows(series, group, norms, list(view.looks))
    if not any(row.get(field) for row in rows):
        return None
    data = alt.Chart(csv_data(rows)).transform_filter(f"datum.{field} > 0")
    if view.interactive:
        data = data.transform_filter("datum.norm == norm")
    looks = view.looks.values()
    color = _channel(alt.Color, view.looks, [look.color for look in looks])
    shape = _channel(alt.Shape, view.looks, [look.shape for look in looks])
    # Dashes around a point would spoil the legend: they go by number and stay out of it.
    numbers = [str(i) for i in range(len(looks))]
    dashes = alt.Scale(domain=numbers, range=[list(look.dash) for look in looks])
    dash = alt.StrokeDash("look:N", scale=dashes, legend=None)
    x = alt.X(f"{field}:Q", title=title, scale=_log(), axis=_log_axis(_FORMATS.get(field, "~g")))
    y_title = f"relative error in {GROUP_NAMES[group]}"
    y = alt.Y("error:Q", title=y_title, scale=_log(), axis=_log_axis(".0e", room=38))
    tips = [
        alt.Tooltip("series:N", title="integrator"),
        alt.Tooltip("run:N", title="resolution"),
        alt.Tooltip("error:Q", title=f"error in {group}", format=".3g"),
        alt.Tooltip("seconds:Q", title="median s", format=".3g"),
        alt.Tooltip("residuals:Q", title="residual evaluations", format="d"),
    ]
    lines = data.mark_line(strokeWidth=1.8).encode(x=x, y=y, strokeDash=dash, order="h:Q")
    points = data.mark_point(filled=True, size=55).encode(x=x, y=y, shape=shape, tooltip=tips)
    marks = [(lines, 1.0), (points, 1.0)]
    if field == "seconds":
        ends = {"x": alt.X("fastest:Q", title=title, scale=_log()), "x2": "slowest:Q"}
        marks.append((data.mark_rule(strokeWidth=1).encode(y=y, **ends), 0.45))
    layers = [
        mark.encode(color=color, opacity=_dimmed(full) if view.interactive else alt.value(full))
        for mark, full in marks
    ]
    if view.interactive:
        controls = [_pick(), _norm_choice(view.norm)] if first else []
        # The first layer: the shared legend answers only to that one's selection.
        layers[0] = layers[0].add_params(_zoom(f"{field}_{group}"), *controls)
    return alt.layer(*_floor_rule(series, group, rows), *layers)


def _error_rows(
    series: Sequence[Series], group: str, norms: Sequence[str], labels: Sequence[str]
) -> list[dict[str, Any]]:
    """One row per run and norm; only errors that a logarithmic axis can show."""
    rows = []
    for s in series:
        for record in s.ok:
            run = {
                "look": labels.index(s.label),
                "h": short(size_of(record)),
                "run": record.resolution,
                "seconds": short(seconds_of(record)),
                "fastest": short(min(record.run_s, default=None)),
                "slowest": short(max(record.run_s, default=None)),
                "residuals": record.work.get("residuals"),
            }
            for norm in norms:
                error = short(error_of(record, group, norm))
                if error is not None and error > 0:
                    rows.append({"series": s.label, "norm": norm, "error": error, **run})
    return rows


def _floor_rule(
    series: Sequence[Series], group: str, rows: Sequence[Mapping[str, Any]]
) -> list[alt.Chart]:
    """The reference's own error, unless it lies so deep that it would squeeze the lines."""
    floor = max((r.reference_error.get(group, 0.0) for s in series for r in s.ok), default=0.0)
    if floor <= 0 or floor * 1e3 < min(row["error"] for row in rows):
        return []
    tip = alt.Tooltip("floor:Q", title="reference's own error", format=".2g")
    rule = alt.Chart(csv_data([{"floor": floor}])).mark_rule(color=GREY, strokeDash=[5, 5])
    return [rule.encode(y=alt.Y("floor:Q", scale=_log()), tooltip=tip)]


def run_lines(
    data: alt.InlineData, field: str, title: str, labels: Sequence[str], view: View, first: bool
) -> alt.Chart:
    """One component over time, a line per run."""
    looks = view.looks.values()
    color = _channel(alt.Color, view.looks, [look.color for look in looks], "line")
    dash = _channel(alt.StrokeDash, view.looks, [list(look.dash) for look in looks], "line")
    chart = (
        alt.Chart(data)
        .transform_calculate(series=f"{json.dumps(list(labels))}[datum.s]")
        .mark_line(strokeWidth=1.4, clip=True)
        .encode(*over_time(field, title), color=color, strokeDash=dash)
    )
    if view.interactive:
        controls = [_pick()] if first else []
        chart = chart.encode(opacity=_dimmed(1.0)).add_params(_zoom(field), *controls)
    return chart


def over_time(field: str, title: str) -> tuple[alt.X, alt.Y]:
    """The two axes of a component over time."""
    return (
        alt.X("t:Q", title="time in s", scale=alt.Scale(nice=False, zero=False)),
        alt.Y(f"{field}:Q", title=title, scale=alt.Scale(zero=False)),
    )


def component(group: str, i: int, coordinates: Sequence[str]) -> str:
    """A component as an axis names it: q[X], lam[1]."""
    name = coordinates[i] if group in "qva" and i < len(coordinates) else str(i + 1)
    return f"{group}[{name}]"


def wide_rows(rows: Rows, groups: Sequence[str], number_of_run: int) -> list[dict[str, Any]]:
    """A row per time with the first components of every group."""
    table = []
    for k, t in enumerate(rows.t):
        row: dict[str, Any] = {"t": short(t), "s": number_of_run}
        for group in groups:
            values = rows.values.get(group) or []
            for i, value in enumerate(values[k][:MOST_COMPONENTS] if k < len(values) else []):
                if (shown := short(value)) is not None:
                    row[f"{group}{i}"] = shown
        table.append(row)
    return table


def _channel(kind: Any, looks: Mapping[str, Look], values: list[Any], symbol: str = "point") -> Any:
    """A channel by series; all channels and panels have one domain, so they share a legend."""
    legend = alt.Legend(
        title=None,
        orient="bottom",
        direction="vertical",
        columns=2,
        columnPadding=40,
        labelLimit=440,
        **({"symbolType": "stroke", "symbolSize": 400} if symbol == "line" else {"symbolSize": 90}),
    )
    return kind("series:N", scale=alt.Scale(domain=list(looks), range=values), legend=legend)


def _log() -> alt.Scale:
    return alt.Scale(type="log", nice=False, padding=12)


def _log_axis(numbers: str, room: int = 0) -> alt.Axis:
    exponent = "log(datum.value) / LN10"
    decade = f"abs({exponent} - round({exponent})) < 1e-6"
    return alt.Axis(
        format=numbers,
        tickCount=6,
        labelOverlap="greedy",
        minExtent=room,
        labelSeparation=6,
        gridOpacity=alt.condition(decade, alt.value(1.0), alt.value(0.25)),
    )


def _pick() -> alt.Parameter:
    """A click on the legend isolates a method; with Shift, several."""
    return alt.selection_point(name="pick", fields=["series"], bind="legend")


def _dimmed(full: float) -> Any:
    return alt.condition(alt.param("pick"), alt.value(full), alt.value(0.07))


def _zoom(name: str) -> alt.Parameter:
    """Pan by mouse, zoom with Ctrl and the wheel: plain scrolling and touch move the page."""
    return alt.selection_interval(
        name=f"zoom_{name}",
        bind="scales",
        zoom="wheel![event.ctrlKey]",
        translate="[pointerdown[event.pointerType === 'mouse'], window:pointerup] "
        "> window:pointermove!",
    )


def _norm_choice(norm: str) -> alt.Parameter:
    names = [NORM_NAMES[n] for n in NORMS]
    return alt.param(
        name="norm",
        value=norm,
        bind=alt.binding_radio(options=list(NORMS), labels=names, name="Error "),
    )


def arrange(panels: Sequence[alt.LayerChart], columns: int, height: int = 250) -> alt.Chart | None:
    """Panels in a grid, dressed; None of none."""
    if not panels:
        return None
    width = {1: 620, 2: 410}.get(columns, 270)
    for panel in panels:
        panel.width, panel.height = width, height
    return dress(alt.concat(*panels, columns=columns, spacing=24))


def dress(chart: alt.Chart) -> alt.Chart:
    """No background and greys that read on light and on dark pages."""
    text = {"labelColor": GREY, "titleColor": GREY}
    # Set in place: each fluent call would copy the whole chart.
    chart.config = alt.Config(
        background="transparent",
        font="Arial, Liberation Sans, Helvetica, sans-serif",
        view=alt.ViewConfig(stroke=GREY, strokeOpacity=0.35),
        axis=alt.AxisConfig(
            **text,
            gridColor=GREY,
            gridOpacity=0.3,
            domainColor=GREY,
            tickColor=GREY,
            titleFontWeight="normal",
            titleFontSize=12,
            labelFontSize=11,
        ),
        legend=alt.LegendConfig(**text, labelFontSize=12),
    )
    return chart


def short(value: float | None) -> float | None:
    """Five digits are more than a picture shows; None for what is not a number."""
    if value is None or not math.isfinite(value):
        return None
    return float(f"{value:.5g}")
