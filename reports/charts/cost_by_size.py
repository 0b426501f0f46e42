"""Cost against the size of a scene."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Any

from bench.results.records import Record, SceneRecord
from reports.charts import vega_lite as vl
from reports.charts.line_styles import LineStyle
from reports.series import label_of

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
) -> dict[str, vl.Spec]:
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
        sizes = sum(n for of, n in scene.sizes.items() if of != "nv") if scene else 0
        if record.status == "ok" and sizes and steps and record.seconds:
            key = record.problem.split("[")[0], sizes, label_of(record)
            if key not in best or steps > (best[key].work["steps"] or 0):
                best[key] = record
    rows = defaultdict(list)
    for (kind, unknowns, label), record in sorted(best.items(), key=lambda item: item[0]):
        seconds, steps = record.seconds or 0.0, record.work["steps"] or 1
        rows[kind].append(
            {
                "series": label,
                "unknowns": unknowns,
                "per_second": vl.short(seconds / (record.t_end - record.t0)),
                "per_step": vl.short(seconds / steps),
                "per_unknown": vl.short(seconds / steps / unknowns),
            }
        )
    return rows


def _chart(
    kind: str, rows: list[dict[str, Any]], styles: Mapping[str, LineStyle]
) -> vl.Spec | None:
    shown = {row["series"] for row in rows}
    options = vl.ChartOptions({label: style for label, style in styles.items() if label in shown})
    data = vl.Dataset(f"sizes-{kind}", rows)
    x_axis = vl.log_axis([row["unknowns"] for row in rows], "~s")
    panels = [
        {
            "data": data.source,
            "mark": {"type": "line", "strokeWidth": 1.8, "point": {"size": 45}},
            "encoding": {
                "x": vl.log_quantity("unknowns", axis=x_axis),
                "y": vl.log_quantity(
                    field, title=title, axis=vl.log_axis([row[field] for row in rows], ".0e")
                ),
                "color": options.colors(),
                "strokeDash": options.dashes(),
                "tooltip": [
                    vl.category("series"),
                    vl.quantity("unknowns"),
                    vl.quantity(field, title=title, format=".3g"),
                ],
            },
        }
        for field, title in _PANELS
    ]
    return vl.arrange(panels, [data], 3)
