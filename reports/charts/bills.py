"""Chart of bills: a bar per run, stacked of the parts of its floating-point operations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.results.quantities import PARTS
from reports.charts import vega_lite as vl
from reports.charts.line_styles import LineStyle
from reports.formatting import number
from reports.series import Series

#: Of more runs than this the finest one of each integrator is drawn.
MOST_BARS = 24
#: Colours of the parts: evaluations in greens, linear algebra in browns, the method's own in grey.
_COLORS = ("#2f8f6b", "#8cc9ae", "#e3b778", "#b8692f", "#7a3f1d", "#8a93a6")


def bills(series: Sequence[Series], styles: Mapping[str, LineStyle]) -> vl.Spec | None:
    """Parts of each run's operations, in percent; None if no run has a bill.

    The label of a bar ends with the sum. Rows are those of the series, from coarse to fine.
    """
    runs = [(s, r) for s in series for r in s.ok if r.cost("operations")]
    if len(runs) > MOST_BARS:
        runs = [(s, s.finest) for s in series if s.finest.cost("operations")]
    if not runs:
        return None
    rows: list[dict[str, Any]] = []
    for s, r in runs:
        total = r.cost("operations") or 0.0
        bar = f"{styles[s.label].name}, {r.resolution.split(',')[0]}: {number(total)}"
        for order, part in enumerate(PARTS):
            if count := r.operations.get(part):
                row = {"line": bar, "series": s.label, "text": part}
                row |= {"percent": vl.short(100 * count / total), "order": order}
                rows.append(row | {"count": vl.short(count)})
    data, bars = vl.Dataset("bills", rows), list(dict.fromkeys(row["line"] for row in rows))
    legend = {"title": None, "orient": "top", "direction": "horizontal", "columns": len(PARTS)}
    scale = {"domain": list(PARTS), "range": list(_COLORS)}
    title = "part of the floating-point operations in %"
    panel = {
        "data": data.source,
        "mark": {"type": "bar"},
        "encoding": {
            "y": vl.category("line", title=None, sort=bars, axis={"labelLimit": 420}),
            "x": vl.quantity("percent", title=title, scale={"domain": [0, 100]}),
            "color": vl.category("text", scale=scale, legend=legend),
            "order": vl.quantity("order"),
            "tooltip": [
                vl.category("series", title="integrator"),
                vl.category("line", title="run"),
                vl.category("text", title="part"),
                vl.quantity("count", title="operations", format=".3g"),
                vl.quantity("percent", title="%", format=".3g"),
            ],
        },
    }
    return vl.arrange([panel], [data], 1, height=max(60, 18 * len(bars)))
