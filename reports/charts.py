"""Charts as pure functions of records; the colours suit light and dark pages."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
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
_UNITS = {"seconds": "median seconds per run", "residuals": "residual evaluations"}


def convergence(
    series: Sequence[Series],
    groups: Sequence[str],
    looks: Mapping[str, Look],
    norm: str = "end",
    interactive: bool = False,
) -> alt.Chart | None:
    """Error against step size, one panel per group; None if there is nothing to draw.

    An interactive chart carries all norms and a choice between them.
    """
    stepped = [s for s in series if s.controls == "step" and s.ok]
    looks = {s.label: looks[s.label] for s in stepped}
    norms = NORMS if interactive else (norm,)
    panels = []
    for group in groups:
        rows = _points(stepped, group, norms)
        floor = _floor(stepped, group, rows)
        panel = _panel(rows, ("h", "step size h in s"), group, looks, floor, norm, interactive)
        panels += [panel] if panel else []
    columns = 2 if len(panels) in (2, 4) else 3
    return _arrange(panels, columns)


def work_precision(
    series: Sequence[Series],
    groups: Sequence[str],
    looks: Mapping[str, Look],
    norm: str = "end",
    interactive: bool = False,
) -> alt.Chart | None:
    """Error in the groups against seconds and against counted work; None if nothing to draw."""
    series = [s for s in series if s.ok]
    looks = {s.label: looks[s.label] for s in series}
    norms = NORMS if interactive else (norm,)
    panels, columns = [], 0
    for unit, title in _UNITS.items():
        row = []
        for group in groups:
            rows = [r for r in _points(series, group, norms) if r.get(unit)]
            floor = _floor(series, group, rows)
            panel = _panel(rows, (unit, title), group, looks, floor, norm, interactive)
            row += [panel] if panel else []
        panels += row
        columns = max(columns, len(row))
    return _arrange(panels, max(columns, 1))


def trajectory(
    runs: Sequence[tuple[str, Rows]],
    reference: Rows | None,
    groups: Sequence[str],
    looks: Mapping[str, Look],
    coordinates: Sequence[str] = (),
    interactive: bool = False,
) -> alt.Chart | None:
    """Components of the groups over time, the reference as a broad grey line behind.

    Parameters
    ----------
    runs
        Label and sampled values of each run.
    coordinates
        Names of the entries of q, which also name those of v and a.
    """
    labels = [label for label, _ in runs]
    # One wide table serves all panels; labels are numbers in it, so that the page stays small.
    data = [row for i, (_, rows) in enumerate(runs) for row in _wide(rows, groups, i)]
    back = _wide(reference, groups, -1) if reference else []
    fields = sorted({key for row in [*data, *back] for key in row} - {"t", "s"})
    panels = []
    for group in groups:
        sizes = [f for f in fields if f.rstrip("0123456789") == group]
        for i in range(min(len(sizes), MOST_COMPONENTS)):
            field, title = f"{group}{i}", _component(group, i, coordinates)
            layers = []
            if any(field in row for row in back):
                line = alt.Chart(alt.InlineData(values=back)).mark_line(
                    color=GREY, strokeWidth=5, opacity=0.4, clip=True
                )
                layers.append(line.encode(*_over_time(field, title)))
            if any(field in row for row in data):
                layers.append(_lines(data, field, title, labels, looks, interactive))
            if layers:
                panels.append(alt.layer(*layers))
    return _arrange(panels, min(3, len(panels)), height=150)


def drawing(drawings: Sequence[Mapping[str, Any]]) -> alt.Chart | None:
    """The mechanism at several times, the last one solid; the same scale on both axes."""
    rows, last = [], len(drawings) - 1
    for i, picture in enumerate(drawings):
        fade = 1.0 if i == last else 0.12 + 0.28 * (i / max(last, 1))
        for j, line in enumerate(picture["lines"]):
            rows += [
                {"line": f"{i}.{j}", "k": k, "x": _short(x), "y": _short(y), "fade": round(fade, 2)}
                for k, (x, y) in enumerate(line)
                if math.isfinite(x) and math.isfinite(y)
            ]
    if not rows:
        return None
    (x0, x1), (y0, y1) = ((min(r[c] for r in rows), max(r[c] for r in rows)) for c in "xy")
    extent = max(x1 - x0, y1 - y0, 1e-9)
    # At least a third of the other side, so that a mass on a line still has a picture.
    wide, high = (max(b - a, extent / 3) + 0.1 * extent for a, b in ((x0, x1), (y0, y1)))
    pixels = min(520 / wide, 320 / high)

    def axis(name: str, low: float, high: float, span: float) -> dict[str, Any]:
        middle = (low + high) / 2
        domain = [middle - span / 2, middle + span / 2]
        return {
            "title": f"{name} in m",
            "scale": alt.Scale(domain=domain, nice=False, zero=False),
            "axis": alt.Axis(tickCount=5),
        }

    chart = (
        alt.Chart(alt.InlineData(values=rows))
        .mark_line(color="#3b82c4", strokeWidth=2.5, strokeJoin="round", strokeCap="round")
        .encode(
            x=alt.X("x:Q", **axis("x", x0, x1, wide)),
            y=alt.Y("y:Q", **axis("y", y0, y1, high)),
            detail="line:N",
            order="k:Q",
            opacity=alt.Opacity("fade:Q", scale=None, legend=None),
        )
        .properties(width=round(wide * pixels), height=round(high * pixels))
    )
    return _dress(chart)


# ---- pieces ------------------------------------------------------------------------------
def _points(series: Sequence[Series], group: str, norms: Sequence[str]) -> list[dict[str, Any]]:
    """One row per run and norm; only what a logarithmic axis can show."""
    rows = []
    for s in series:
        for record in s.ok:
            seconds = seconds_of(record)
            extra = {
                "h": _short(size_of(record)),
                "run": record.resolution,
                "seconds": _short(seconds),
                "fastest": _short(min(record.run_s, default=None)),
                "slowest": _short(max(record.run_s, default=None)),
                "residuals": record.work.get("residuals"),
            }
            extra = {k: v for k, v in extra.items() if v is not None}
            for norm in norms:
                error = _short(error_of(record, group, norm))
                if error is not None and error > 0:
                    rows.append({"series": s.label, "norm": norm, "error": error, **extra})
    return rows


def _floor(series: Sequence[Series], group: str, rows: Sequence[Mapping]) -> float | None:
    """The reference's own error, unless it lies so deep that it would squeeze the lines."""
    floor = max((r.reference_error.get(group, 0.0) for s in series for r in s.ok), default=0.0)
    lowest = min((row["error"] for row in rows), default=0.0)
    return floor if floor > 0 and floor * 1e3 >= lowest else None


def _panel(
    rows: list[dict[str, Any]],
    across: tuple[str, str],
    group: str,
    looks: Mapping[str, Look],
    floor: float | None,
    norm: str,
    interactive: bool,
) -> alt.LayerChart | None:
    """Error in one group against something, log-log, with points, lines and the floor."""
    if not rows:
        return None
    field, title = across
    data = alt.Chart(alt.InlineData(values=rows))
    if interactive:
        data = data.transform_filter("datum.norm == norm")
    x = alt.X(f"{field}:Q", title=title, scale=_log(), axis=_log_axis())
    y = alt.Y(
        "error:Q", title=f"relative error in {GROUP_NAMES[group]}", scale=_log(), axis=_log_axis()
    )
    color, dash, shape = _channels(looks)
    tips = [
        alt.Tooltip("series:N", title="integrator"),
        alt.Tooltip("run:N", title="resolution"),
        alt.Tooltip("error:Q", title=f"error in {group}", format=".3g"),
        alt.Tooltip("seconds:Q", title="median s", format=".3g"),
        alt.Tooltip("residuals:Q", title="residual evaluations", format="d"),
    ]
    layers = []
    if floor is not None:
        rule = alt.Chart(alt.InlineData(values=[{"floor": floor}])).mark_rule(
            color=GREY, strokeDash=[5, 5]
        )
        tip = alt.Tooltip("floor:Q", title="reference's own error", format=".2g")
        layers.append(rule.encode(y=alt.Y("floor:Q", scale=_log()), tooltip=tip))
    lines = data.mark_line(strokeWidth=1.8).encode(x=x, y=y, strokeDash=dash, order="h:Q")
    points = data.mark_point(filled=True, size=55).encode(x=x, y=y, shape=shape, tooltip=tips)
    marks = [lines, points]
    if field == "seconds":
        ends = {"x": alt.X("fastest:Q", title=title, scale=_log()), "x2": "slowest:Q"}
        marks.insert(0, data.mark_rule(strokeWidth=1).encode(y=y, **ends))
    marks = [mark.encode(color=color) for mark in marks]
    if interactive:
        pick = _pick()
        marks = [mark.encode(opacity=_dimmed(pick)) for mark in marks]
        marks[-1] = marks[-1].add_params(pick, _zoom(f"{field}_{group}"), _norm_choice(norm))
    return alt.layer(*layers, *marks)


def _lines(
    data: list[dict[str, Any]],
    field: str,
    title: str,
    labels: Sequence[str],
    looks: Mapping[str, Look],
    interactive: bool,
) -> alt.Chart:
    color, dash, _ = _channels(looks)
    chart = (
        alt.Chart(alt.InlineData(values=data))
        .transform_calculate(series=f"{json.dumps(list(labels))}[datum.s]")
        .mark_line(strokeWidth=1.4, clip=True)
        .encode(*_over_time(field, title), color=color, strokeDash=dash)
    )
    if interactive:
        pick, zoom = _pick(), _zoom(field)
        chart = chart.encode(opacity=_dimmed(pick)).add_params(pick, zoom)
    return chart


def _over_time(field: str, title: str) -> tuple[alt.X, alt.Y]:
    return (
        alt.X("t:Q", title="time in s", scale=alt.Scale(nice=False, zero=False)),
        alt.Y(f"{field}:Q", title=title, scale=alt.Scale(zero=False)),
    )


def _component(group: str, i: int, coordinates: Sequence[str]) -> str:
    name = coordinates[i] if group in "qva" and i < len(coordinates) else str(i + 1)
    return f"{group}[{name}]"


def _wide(rows: Rows, groups: Sequence[str], number_of_run: int) -> list[dict[str, Any]]:
    table = []
    for k, t in enumerate(rows.t):
        row: dict[str, Any] = {"t": _short(t), "s": number_of_run}
        for group in groups:
            values = rows.values.get(group) or []
            for i, value in enumerate(values[k][:MOST_COMPONENTS] if k < len(values) else []):
                short = _short(value)
                if short is not None:
                    row[f"{group}{i}"] = short
        table.append(row)
    return table


def _channels(looks: Mapping[str, Look]) -> tuple[alt.Color, alt.StrokeDash, alt.Shape]:
    """Colour, dash and shape with one scale over all panels, so that they share a legend."""
    legend = alt.Legend(
        title=None, orient="bottom", direction="vertical", columns=2, labelLimit=440, symbolSize=90
    )

    def scale(values: list[Any]) -> alt.Scale:
        return alt.Scale(domain=list(looks), range=values)

    kinds = looks.values()
    return (
        alt.Color("series:N", scale=scale([look.color for look in kinds]), legend=legend),
        alt.StrokeDash("series:N", scale=scale([list(look.dash) for look in kinds]), legend=legend),
        alt.Shape("series:N", scale=scale([look.shape for look in kinds]), legend=legend),
    )


def _log() -> alt.Scale:
    return alt.Scale(type="log", nice=False, padding=12)


def _log_axis() -> alt.Axis:
    # Whole decades where there are many, everything between where there are few.
    return alt.Axis(format="~g", tickCount=6, labelOverlap="greedy", labelSeparation=6)


def _pick() -> alt.Parameter:
    """A click on the legend isolates a method; with Shift, several."""
    return alt.selection_point(name="pick", fields=["series"], bind="legend")


def _dimmed(pick: alt.Parameter) -> Any:
    return alt.condition(pick, alt.value(1.0), alt.value(0.07))


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


def _arrange(panels: Sequence[alt.LayerChart], columns: int, height: int = 250) -> alt.Chart | None:
    if not panels:
        return None
    width = {1: 620, 2: 410}.get(columns, 270)
    panels = [panel.properties(width=width, height=height) for panel in panels]
    return _dress(alt.concat(*panels, columns=columns, spacing=24))


def _dress(chart: alt.Chart) -> alt.Chart:
    """No background and greys that read on light and on dark pages."""
    text = {"labelColor": GREY, "titleColor": GREY}
    return (
        chart.configure(background="transparent", font="system-ui, sans-serif")
        .configure_view(stroke=GREY, strokeOpacity=0.35)
        .configure_axis(
            **text,
            gridColor=GREY,
            gridOpacity=0.18,
            domainColor=GREY,
            tickColor=GREY,
            titleFontWeight="normal",
            titleFontSize=12,
            labelFontSize=11,
        )
        .configure_legend(**text, labelFontSize=12)
    )


def _short(value: float | None) -> float | None:
    """Five digits are more than a picture shows; None for what is not a number."""
    if value is None or not math.isfinite(value):
        return None
    return float(f"{value:.5g}")
