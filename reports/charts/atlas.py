"""Charts of the failure atlas: sweeps and histories of an experiment."""

from __future__ import annotations

from bench.results.experiments import PartResult
from reports.charts import vega_lite as vl
from reports.charts.line_styles import line_styles


def experiment_chart(part: PartResult) -> vl.Spec | None:
    """The sweep, and the history of the component shown; None if there is neither."""
    cases = [(f"{k}. {c.label}", c) for k, c in enumerate(part.cases, 1)]
    options = vl.ChartOptions(line_styles(label for label, _ in cases))
    sweep = [
        {"series": label, "x": vl.short(x), "value": vl.short(y)}
        for label, case in cases
        if len(case.x) > 1
        for x, y in zip(case.x, case.y, strict=True)
        if y is not None and y > 0
    ]
    history = [
        {"series": label, "t": vl.short(t), "value": vl.short(v)}
        for label, case in cases
        if case.history
        for t, v in zip(*case.history, strict=True)
    ]
    panels, data = [], []
    if sweep:
        table = vl.Dataset("sweep", sweep)
        axis = next(case.axis for case in part.cases if len(case.x) > 1)
        x = vl.log_quantity("x", title=axis, axis=vl.log_axis([r["x"] for r in sweep], "~g"))
        values = [row["value"] for row in sweep]
        y = vl.log_quantity("value", title=part.quantity, axis=vl.log_axis(values, ".0e"))
        panels.append(_lines(table, options, x, y, points=True))
        data.append(table)
    if history:
        table = vl.Dataset("history", history)
        x, y = vl.quantity("t", title="t in s"), vl.quantity("value", title=part.show)
        panels.append(_lines(table, options, x, y | {"scale": {"zero": False}}, points=False))
        data.append(table)
    return vl.arrange(panels, data, 2, height=210)


def _lines(
    data: vl.Dataset, options: vl.ChartOptions, x: vl.Spec, y: vl.Spec, points: bool
) -> vl.Spec:
    mark = {"type": "line", "strokeWidth": 1.6, "clip": True}
    return {
        "data": data.source,
        "mark": mark | ({"point": {"size": 40}} if points else {}),
        "encoding": {"x": x, "y": y, "color": options.colors(), "strokeDash": options.dashes()},
    }
