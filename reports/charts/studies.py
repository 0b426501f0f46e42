"""Charts as pure functions of records; the colours suit light and dark pages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from bench.results.quantities import COSTS
from bench.results.records import Rows
from reports.charts.panels import (
    component,
    error_data,
    error_panel,
    first_components,
    floor_rule,
    full_norm,
    reference_line,
    run_lines,
    slope_guides,
    wide_rows,
)
from reports.charts.vega import (
    Data,
    Spec,
    View,
    arrange,
    config,
    log_axis,
    log_scale,
    quantity,
    short,
)
from reports.series import Look, Series


def convergence(
    series: Sequence[Series],
    groups: Sequence[str],
    looks: Mapping[str, Look],
    norm: str = "end",
    interactive: bool = False,
) -> Spec | None:
    """Error against step size, one panel per group; None if there is nothing to draw.

    An interactive chart carries all norms and a choice between them; it starts with one that has
    errors in every group. The legend names the fitted orders of the norm that is shown.
    """
    stepped = [s for s in series if s.controls == "step" and s.ok]
    if interactive:
        norm = full_norm(stepped, groups, norm)
    view = View({s.label: looks[s.label] for s in stepped}, norm, interactive)
    notes = {n: {s.label: _orders(s, groups, n) for s in stepped} for n in view.norms}
    view = replace(view, notes=notes)
    data, panels = [error_data(stepped, group, view) for group in groups], []
    for table in data:
        behind = floor_rule(stepped, table, view) + slope_guides(stepped, table, view)
        across = ("h", "step size h in s")
        panel = error_panel(table, across, view, not panels, behind)
        panels += [panel] if panel else []
    columns = {1: 1, 2: 2, 4: 2}.get(len(panels), 3)
    return arrange(panels, data, columns, params=view.controls)


def _orders(series: Series, groups: Sequence[str], norm: str) -> str:
    """The fitted orders as a legend names them; groups whose order is not determined are out."""
    fits = {group: series.fit(group, norm) for group in groups}
    known = [f"{g} {round(f.order, 2) + 0.0:.2f}" for g, f in fits.items() if f.order is not None]
    return f": order {', '.join(known)}" if known else ": order not determined"


def work_precision(
    series: Sequence[Series],
    groups: Sequence[str],
    looks: Mapping[str, Look],
    norm: str = "end",
) -> Spec | None:
    """A picture of the errors in the groups against seconds and counted work; None of nothing.

    A page that answers shows `reports.charts.interactive.explorer` instead.
    """
    series = [s for s in series if s.ok]
    view = View({s.label: looks[s.label] for s in series}, norm)
    data, panels, columns = [error_data(series, group, view) for group in groups], [], 1
    for across in [(cost, COSTS[cost]) for cost in ("seconds", "residuals")]:
        before = len(panels)
        for table in data:
            panel = error_panel(table, across, view, not panels, floor_rule(series, table, view))
            panels += [panel] if panel else []
        columns = max(columns, len(panels) - before)
    return arrange(panels, data, columns)


def trajectory(
    runs: Sequence[tuple[str, Rows]],
    reference: Rows | None,
    groups: Sequence[str],
    looks: Mapping[str, Look],
    coordinates: Sequence[str] = (),
    interactive: bool = False,
    components: Sequence[tuple[str, int]] = (),
) -> Spec | None:
    """Components of the groups over time, the reference as a broad grey line behind.

    Parameters
    ----------
    runs
        Label and sampled values of each run.
    coordinates
        Names of the entries of q, which also name those of v and a.
    components
        What is drawn; the first few of every group if nothing is said.
    """
    components = components or first_components(groups)
    labels = [label for label, _ in runs]
    # One wide table serves all panels; labels are numbers in it, so that the page stays small.
    rows = [row for i, (_, run) in enumerate(runs) for row in wide_rows(run, components, i)]
    drawn = Data("runs", rows)
    behind = Data("reference", wide_rows(reference, components, -1) if reference else [])
    view = View(looks, interactive=interactive)
    panels: list[Spec] = []
    for group, i in components:
        name, title = f"{group}{i}", component(group, i, coordinates)
        layers = []
        if name in behind.columns:
            layers.append(reference_line(behind, name, title))
        if name in drawn.columns:
            layers.append(run_lines(drawn, name, title, labels, view, first=not panels))
        panels += [{"layer": layers}] if layers else []
    return arrange(panels, [drawn, behind], min(3, len(panels)), height=150)


#: What is drawn over time beside the variables: title, and whether the axis is logarithmic.
HISTORIES = {
    "h": ("step size h in s", True),
    "gamma": ("weight gamma", False),
    "position": ("constraint residual, position", True),
    "velocity": ("constraint residual, velocity", True),
    "energy": ("relative change of the energy", True),
}


def histories(
    runs: Sequence[tuple[str, Rows]], looks: Mapping[str, Look], interactive: bool = False
) -> Spec | None:
    """Notes over time, a panel each; what is the same number in every row is left out."""
    labels = list(dict.fromkeys(label for label, _ in runs))
    view = View({label: looks[label] for label in labels}, interactive=interactive)
    rows = [
        {"s": labels.index(label), "t": short(t)}
        | {n: short(run.notes[n][k]) for n in HISTORIES if run.notes.get(n)}
        for label, run in runs
        for k, t in enumerate(run.t)
    ]
    data, panels = Data("histories", rows), []
    for name, (title, logarithmic) in HISTORIES.items():
        told = [[v for v in run.notes.get(name, []) if v is not None] for _, run in runs]
        if not any(_varies(values) for values in told):
            continue
        values = [abs(v) for values in told for v in values if v or not logarithmic]
        layer = run_lines(data, name, title, labels, view, first=not panels)
        if logarithmic:
            layer["transform"].append({"filter": f"datum.{name} > 0"})
            axis = log_axis(values, ".0e")
            layer["encoding"]["y"] |= {"scale": log_scale(), "axis": axis}
        panels.append({"layer": [layer]})
    return arrange(panels, [data], min(3, len(panels)), height=170)


def _varies(values: Sequence[float]) -> bool:
    return bool(values) and max(values) - min(values) > 1e-9 * max(map(abs, values))


def drawing(drawings: Sequence[Mapping[str, Any]]) -> Spec | None:
    """The mechanism at several times, the last one solid; the same scale on both axes."""
    rows, last = [], len(drawings) - 1
    for i, picture in enumerate(drawings):
        fade = 1.0 if i == last else 0.12 + 0.28 * (i / max(last, 1))
        for j, line in enumerate(picture["lines"]):
            rows += [
                {"line": f"{i}.{j}", "k": k, "x": short(x), "y": short(y), "fade": round(fade, 2)}
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

    def axis(name: str, low: float, high: float, span: float) -> Spec:
        middle = (low + high) / 2
        scale = {"domain": [middle - span / 2, middle + span / 2], "nice": False, "zero": False}
        return quantity(name, title=f"{name} in m", scale=scale, axis={"tickCount": 5})

    data = Data("drawings", rows)
    return {
        "datasets": {data.name: data.text},
        "data": data.source,
        "mark": {
            "type": "line",
            "color": "#3b82c4",
            "strokeWidth": 2.5,
            "strokeJoin": "round",
            "strokeCap": "round",
        },
        "encoding": {
            "x": axis("x", x0, x1, wide),
            "y": axis("y", y0, y1, high),
            "detail": {"field": "line", "type": "nominal"},
            "order": quantity("k"),
            "opacity": quantity("fade", scale=None, legend=None),
        },
        "width": round(wide * pixels),
        "height": round(high * pixels),
        "config": config(),
    }
