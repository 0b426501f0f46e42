"""Charts of work: the parts of the operations of runs, and times against the size of a scene."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import Any

from bench.results.quantities import PARTS
from bench.results.records import Record, SceneRecord
from reports.charts import vega_lite as vl
from reports.charts.line_styles import LineStyle
from reports.formatting import number
from reports.scenes import NO_SCENE
from reports.series import Series, label_of, ok_runs

#: Of more runs than this the finest one of each integrator is drawn.
MOST_BARS = 24
#: Colours of the parts: evaluations in greens, linear algebra in browns, the method's own in grey.
_COLORS = ("#2f8f6b", "#8cc9ae", "#e3b778", "#b8692f", "#7a3f1d", "#8a93a6")
#: A kind of scene is drawn from this many sizes on.
_LEAST = 3
#: Fields and titles of the panels of sizes.
_PANELS = {
    "per_second": "seconds per simulated second",
    "per_step": "seconds per step",
    "per_unknown": "seconds per step and unknown",
}


def bills(series: Sequence[Series], styles: Mapping[str, LineStyle]) -> vl.Spec | None:
    """Parts of each run's operations, in percent: a bar per run; None if no run has a bill.

    The label of a bar ends with the sum. Rows are those of the series, from coarse to fine.
    """
    runs = [(s, r) for s in series for r in s.ok if r.cost("operations")]
    if len(runs) > MOST_BARS:
        runs = [(s, s.finest) for s in series if s.finest.cost("operations")]
    rows: list[dict[str, Any]] = []
    for s, r in runs:
        total = r.cost("operations") or 0.0
        bar = f"{styles[s.label].name}, {r.resolution.split(',')[0]}: {number(total)}"
        for order, part in enumerate(PARTS):
            if count := r.operations.get(part):
                row = {"line": bar, "series": s.label, "text": part}
                row |= {"percent": vl.short(100 * count / total), "order": order}
                rows.append(row | {"count": vl.short(count)})
    if not rows:
        return None
    data, bars = vl.Dataset("bills", rows), list(dict.fromkeys(row["line"] for row in rows))
    legend = {"orient": "top", "direction": "horizontal", "columns": len(PARTS)}
    title = "part of the floating-point operations in %"
    looks: dict[str, str] = dict(zip(PARTS, _COLORS, strict=True))
    words = {"series": "integrator", "line": "run", "text": "part"}
    numbers = {"count": "operations", "percent": "%"}
    panel = {
        "data": data.source,
        "mark": {"type": "bar"},
        "encoding": {
            "y": vl.category("line", title=None, sort=bars, axis={"labelLimit": 420}),
            "x": vl.quantity("percent", title=title, scale={"domain": [0, 100]}),
            "color": vl.colors("text", looks, **legend),
            "order": vl.quantity("order"),
            "tooltip": [
                *(vl.category(field, title=name) for field, name in words.items()),
                *(vl.quantity(field, title=name, format=".3g") for field, name in numbers.items()),
            ],
        },
    }
    return vl.arrange([panel], [data], 1, height=max(60, 18 * len(bars)))


def size_charts(
    series: Mapping[str, Sequence[Series]],
    scenes: Mapping[str, SceneRecord],
    styles: Mapping[str, LineStyle],
) -> dict[str, vl.Spec]:
    """A chart for every kind of scene with runs in several sizes, by the name of the kind.

    Of every method and size it has the run with the most steps.
    """
    best: dict[tuple[str, int, str], tuple[int, Record]] = {}
    for name, own in series.items():
        sizes = scenes.get(name, NO_SCENE).sizes
        unknowns = sum(n for of, n in sizes.items() if of != "nv")
        for r in ok_runs(own) if unknowns else ():
            if r.seconds and (steps := r.work.get("steps")):
                key = r.problem.split("[")[0], unknowns, label_of(r)
                best[key] = max(best.get(key, (0, r)), (steps, r), key=itemgetter(0))
    rows = defaultdict(list)
    for (kind, unknowns, label), (steps, r) in sorted(best.items(), key=itemgetter(0)):
        seconds = r.seconds or 0.0
        costs = seconds / (r.t_end - r.t0), seconds / steps, seconds / steps / unknowns
        row = {"series": label, "unknowns": unknowns}
        rows[kind].append(row | dict(zip(_PANELS, map(vl.short, costs), strict=True)))
    charts = {}
    for kind, own in rows.items():
        sizes = [row["unknowns"] for row in own]
        if len({*sizes}) < _LEAST:
            continue
        shown = {row["series"] for row in own}
        lines = vl.Lines({label: style for label, style in styles.items() if label in shown})
        data, x = vl.Dataset(f"sizes-{kind}", own), vl.log_quantity("unknowns", sizes, "~s")
        places = {
            field: vl.log_quantity(field, [row[field] for row in own], ".0e", title=title)
            for field, title in _PANELS.items()
        }
        mark = {"point": {"size": 45}, "tooltip": True}
        panels = [vl.line_panel(data, x, y, lines, **mark) for y in places.values()]
        charts[kind] = vl.arrange(panels, [data], 3) or {}
    return charts
