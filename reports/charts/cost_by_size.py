"""Cost against the size of a scene."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Any

from bench.results.records import Record, SceneRecord
from reports.charts.line_styles import LineStyle
from reports.charts.vega_lite import (
    ChartOptions,
    Dataset,
    Spec,
    arrange,
    by_series,
    category,
    log_axis,
    log_scale,
    quantity,
    short,
)
from reports.series import label_of, seconds_of

#: A kind of scene is drawn from this many sizes on.
_LEAST = 3
#: Fields and titles of the panels.
_PANELS = (
    ("per_second", "seconds per simulated second"),
    ("per_step", "seconds per step"),
    ("per_unknown", "seconds per step and unknown"),
)


def size_charts(
    records: Iterable[Record],
    scenes: Mapping[tuple[str, float], SceneRecord],
    styles: Mapping[str, LineStyle],
) -> dict[str, Spec]:
    """A chart for every kind of scene with runs in several sizes, by the name of the kind."""
    made = {}
    for kind, rows in _rows(records, scenes).items():
        if len({row["unknowns"] for row in rows}) >= _LEAST:
            chart = _chart(kind, rows, styles)
            if chart:
                made[kind] = chart
    return made


def _rows(
    records: Iterable[Record], scenes: Mapping[tuple[str, float], SceneRecord]
) -> dict[str, list[dict[str, Any]]]:
    """The run with the most steps of every method and size, by kind of scene."""
    best: dict[tuple[str, int, str], Record] = {}
    for record in records:
        scene, steps = scenes.get((record.problem, record.t_end)), record.work.get("steps")
        if record.status == "ok" and scene and steps and seconds_of(record):
            key = record.problem.split("[")[0], sum(scene.sizes.values()), label_of(record)
            if key not in best or steps > (best[key].work["steps"] or 0):
                best[key] = record
    rows = defaultdict(list)
    for (kind, unknowns, label), record in sorted(best.items(), key=lambda item: item[0]):
        seconds, steps = seconds_of(record) or 0.0, record.work["steps"] or 1
        rows[kind].append(
            {
                "series": label,
                "unknowns": unknowns,
                "per_second": short(seconds / (record.t_end - record.t0)),
                "per_step": short(seconds / steps),
                "per_unknown": short(seconds / steps / unknowns),
            }
        )
    return rows


def _chart(kind: str, rows: list[dict[str, Any]], styles: Mapping[str, LineStyle]) -> Spec | None:
    shown = {row["series"] for row in rows}
    options = ChartOptions({label: style for label, style in styles.items() if label in shown})
    data = Dataset(f"sizes-{kind}", rows)
    x_axis = log_axis([row["unknowns"] for row in rows], "~s")
    panels = [
        {
            "data": data.source,
            "mark": {"type": "line", "strokeWidth": 1.8, "point": {"size": 45}},
            "encoding": {
                "x": quantity("unknowns", scale=log_scale(), axis=x_axis),
                "y": quantity(
                    field,
                    title=title,
                    scale=log_scale(),
                    axis=log_axis([row[field] for row in rows], ".0e"),
                ),
                "color": by_series(options.colors, options),
                "strokeDash": by_series(options.dashes, options),
                "tooltip": [
                    category("series"),
                    quantity("unknowns"),
                    quantity(field, title=title, format=".3g"),
                ],
            },
        }
        for field, title in _PANELS
    ]
    return arrange(panels, [data], 3)
