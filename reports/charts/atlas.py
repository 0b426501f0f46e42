"""Charts of the failure atlas: sweeps and histories of an experiment."""

from __future__ import annotations

from bench.atlas.results import PartResult
from reports.charts.line_styles import line_styles
from reports.charts.vega_lite import (
    ChartOptions,
    Dataset,
    Spec,
    arrange,
    by_series,
    log_axis,
    log_scale,
    quantity,
    short,
)


def experiment_chart(part: PartResult) -> Spec | None:
    """The sweep, and the history of the component shown; None if there is neither."""
    cases = [(f"{k}. {c.label}", c) for k, c in enumerate(part.cases, 1)]
    options = ChartOptions(line_styles((label, c.family) for label, c in cases))
    sweep = [
        {"series": label, "x": short(x), "value": short(y)}
        for label, case in cases
        if len(case.x) > 1
        for x, y in zip(case.x, case.y, strict=True)
        if y is not None and y > 0
    ]
    history = [
        {"series": label, "t": short(t), "value": short(v)}
        for label, case in cases
        if case.history
        for t, v in zip(*case.history, strict=True)
    ]
    panels, data = [], []
    if sweep:
        table = Dataset("sweep", sweep)
        axis = next(case.axis for case in part.cases if len(case.x) > 1)
        x = quantity(
            "x", title=axis, scale=log_scale(), axis=log_axis([r["x"] for r in sweep], "~g")
        )
        values = [row["value"] for row in sweep]
        y = quantity("value", title=part.quantity, scale=log_scale(), axis=log_axis(values, ".0e"))
        panels.append(_lines(table, options, x, y, points=True))
        data.append(table)
    if history:
        table = Dataset("history", history)
        x, y = quantity("t", title="t in s"), quantity("value", title=part.show)
        panels.append(_lines(table, options, x, y | {"scale": {"zero": False}}, points=False))
        data.append(table)
    return arrange(panels, data, 2, height=210)


def _lines(data: Dataset, options: ChartOptions, x: Spec, y: Spec, points: bool) -> Spec:
    mark = {"type": "line", "strokeWidth": 1.6, "clip": True}
    return {
        "data": data.source,
        "mark": mark | ({"point": {"size": 40}} if points else {}),
        "encoding": {
            "x": x,
            "y": y,
            "color": by_series(options.colors, options),
            "strokeDash": by_series(options.dashes, options),
        },
    }
