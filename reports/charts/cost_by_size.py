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
_PANELS = {
    "per_second": "seconds per simulated second",
    "per_step": "seconds per step",
    "per_unknown": "seconds per step and unknown",
}


def size_charts(
    records: Iterable[Record],
    scenes: Mapping[tuple[str, float], SceneRecord],
    styles: Mapping[str, LineStyle],
) -> dict[str, vl.Spec]:
    """A chart for every kind of scene with runs in several sizes, by the name of the kind.

    Of every method and size it has the run with the most steps.
    """
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
        costs = seconds / (record.t_end - record.t0), seconds / steps, seconds / steps / unknowns
        row = {"series": label, "unknowns": unknowns}
        rows[kind].append(row | dict(zip(_PANELS, map(vl.short, costs), strict=True)))
    return {
        kind: _chart(kind, own, styles)
        for kind, own in rows.items()
        if len({row["unknowns"] for row in own}) >= _LEAST
    }


def _chart(kind: str, rows: list[dict[str, Any]], styles: Mapping[str, LineStyle]) -> vl.Spec:
    shown = {row["series"] for row in rows}
    lines = vl.Lines({label: style for label, style in styles.items() if label in shown})
    data = vl.Dataset(f"sizes-{kind}", rows)
    x_axis = vl.log_axis([row["unknowns"] for row in rows], "~s")
    panels = []
    for field, title in _PANELS.items():
        y_axis = vl.log_axis([row[field] for row in rows], ".0e")
        x = vl.log_quantity("unknowns", axis=x_axis)
        y = vl.log_quantity(field, title=title, axis=y_axis)
        panels.append(vl.line_panel(data, x, y, lines, point={"size": 45}, tooltip=True))
    return vl.arrange(panels, [data], 3) or {}
