"""Charts as pure functions of records; the colours suit light and dark pages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import altair as alt

from bench.records import Rows
from reports.marks import (
    GREY,
    MOST_COMPONENTS,
    View,
    arrange,
    component,
    csv_data,
    dress,
    error_panel,
    over_time,
    run_lines,
    short,
    wide_rows,
)
from reports.series import Look, Series


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
    view = View({s.label: looks[s.label] for s in stepped}, norm, interactive)
    panels = []
    for group in groups:
        panel = error_panel(stepped, group, ("h", "step size h in s"), view, first=not panels)
        panels += [panel] if panel else []
    return arrange(panels, {1: 1, 2: 2, 4: 2}.get(len(panels), 3))


def work_precision(
    series: Sequence[Series],
    groups: Sequence[str],
    looks: Mapping[str, Look],
    norm: str = "end",
    interactive: bool = False,
) -> alt.Chart | None:
    """Error in the groups against seconds and against counted work; None if nothing to draw."""
    series = [s for s in series if s.ok]
    view = View({s.label: looks[s.label] for s in series}, norm, interactive)
    panels, columns = [], 1
    for unit in (("seconds", "median seconds per run"), ("residuals", "residual evaluations")):
        before = len(panels)
        for group in groups:
            panel = error_panel(series, group, unit, view, first=not panels)
            panels += [panel] if panel else []
        columns = max(columns, len(panels) - before)
    return arrange(panels, columns)


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
    rows = [row for i, (_, run) in enumerate(runs) for row in wide_rows(run, groups, i)]
    back = wide_rows(reference, groups, -1) if reference else []
    drawn, behind = csv_data(rows), csv_data(back)
    in_runs, in_back = ({key for row in some for key in row} for some in (rows, back))
    view = View(looks, interactive=interactive)
    panels: list[alt.LayerChart] = []
    # Motion side by side, a row per coordinate, then what holds and drives it.
    motion = [(g, i) for i in range(MOST_COMPONENTS) for g in groups if g in "qva"]
    rest = [(g, i) for g in groups if g not in "qva" for i in range(MOST_COMPONENTS)]
    for group, i in motion + rest:
        name, title = f"{group}{i}", component(group, i, coordinates)
        layers = []
        if name in in_back:
            layers.append(
                alt.Chart(behind)
                .mark_line(color=GREY, strokeWidth=5, opacity=0.4, clip=True)
                .encode(*over_time(name, title))
            )
        if name in in_runs:
            layers.append(run_lines(drawn, name, title, labels, view, first=not panels))
        panels += [alt.layer(*layers)] if layers else []
    return arrange(panels, min(3, len(panels)), height=150)


def drawing(drawings: Sequence[Mapping[str, Any]]) -> alt.Chart | None:
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

    def axis(name: str, low: float, high: float, span: float) -> dict[str, Any]:
        middle = (low + high) / 2
        domain = [middle - span / 2, middle + span / 2]
        return {
            "title": f"{name} in m",
            "scale": alt.Scale(domain=domain, nice=False, zero=False),
            "axis": alt.Axis(tickCount=5),
        }

    chart = (
        alt.Chart(csv_data(rows))
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
    return dress(chart)
