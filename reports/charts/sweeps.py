"""Charts of measurements beside the cells: errors over steps, over costs, and times of steps."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from bench.results.gradients import Gradients
from bench.results.precision import PrecisionRun, groups_of
from bench.results.realtime import RealTimeRun
from reports.charts import vega_lite as vl
from reports.charts.line_styles import DASHES, MARKS, line_styles
from reports.formatting import symbols

#: Quantiles of the time of a step, as columns of `StepTimes` and in words.
_QUANTILES = {"median_us": "median", "p999_us": "99.9 %", "worst_us": "worst"}
#: Colours of precisions, with a contrast of 3:1 or more against light and dark papers.
_COLORS = ("#487be1", "#cf5b22", "#189240")


# ---- a fixed budget per step -------------------------------------------------------------
def budget_chart(runs: Sequence[RealTimeRun]) -> vl.Spec | None:
    """Times of the steps of each run beside the deadline, and its error; a row for each run."""
    options = vl.ChartOptions(line_styles(run.integrator for run in runs))
    names, times, errors = [], [], []
    for run in runs:
        limit = "" if run.iterations == "none" else f" ({run.iterations})"
        names.append(options.styles[run.integrator].name + limit)
        row = {"series": run.integrator, "text": names[-1]}
        for column, word in _QUANTILES.items():
            if value := getattr(run.times, column):
                times.append(row | {"line": word, "time": vl.short(value)})
        if run.error:
            errors.append(row | {"error": vl.short(run.error)})
    y = vl.category("text", title=None, sort=None, scale={"domain": names})
    y |= {"axis": {"labelLimit": 320, "grid": True}}
    both = {"y": y, "color": options.colors(legend=None)}
    point = {"type": "point", "filled": True, "size": 60, "opacity": 1}
    deadline = {
        "data": {"values": [{}]},
        "mark": {"type": "rule", "color": vl.GREY, "strokeWidth": 2},
        "encoding": {"x": {"datum": 1e6 / runs[0].rate}} if runs else {},
    }
    x = _log("time", "time of a step in µs", times, "~s")
    marks = _kinds(_QUANTILES.values(), MARKS, symbolFillColor=vl.GREY)
    line = {"mark": {"type": "line"}, "encoding": both | {"x": x, "detail": vl.category("text")}}
    tooltip = _tooltip("quantile", time="time in µs")
    points = {"mark": point, "encoding": both | {"x": x, "shape": marks, "tooltip": tooltip}}
    data = [vl.Dataset("times", times), vl.Dataset("errors", errors)]
    left: vl.Spec = {"data": data[0].source, "layer": [line, points, deadline]}
    bare = y | {"axis": y["axis"] | {"labels": False}}
    x = _log("error", "largest relative error of q, v, a, λ", errors, ".0e")
    encoding = both | {"x": x, "y": bare, "tooltip": _tooltip(error="error")}
    right = {"data": data[1].source, "mark": point, "encoding": encoding}
    panels = [panel for panel, rows in ((left, times), (right, errors)) if rows]
    return vl.arrange(panels, data, 2, height=24 * len(runs) + 16)


# ---- precisions --------------------------------------------------------------------------
def precision_chart(runs: Sequence[PrecisionRun]) -> vl.Spec | None:
    """Errors over the step in each precision, a panel for each group of variables."""
    rows = [
        {"series": run.integrator, "line": run.precision, "h": vl.short(run.h), "place": k}
        | {group: vl.short(error) for group, error in run.errors.items() if error}
        for k, run in enumerate(runs)
    ]
    panels = {group: f"relative error of {symbols(group)}" for group in groups_of(runs)}
    return _lines(rows, "h", "h in s", panels, "precision")


# ---- derivatives -------------------------------------------------------------------------
def gradient_chart(found: Sequence[Gradients]) -> vl.Spec | None:
    """Errors of derivatives over the processor time that they take, a panel for each parameter."""
    rows = []
    for run in (run for gradients in found for run in gradients.runs):
        if run.run_s and run.cost:
            row = {"series": run.integrator, "line": run.way, "run": run.resolution}
            row |= {"seconds": vl.short(run.run_s * run.cost), "place": len(rows)}
            errors = enumerate(run.errors)
            rows.append(row | {f"by{k}": vl.short(error) for k, error in errors if error})
    by = found[0].exact.by if found else []
    panels = {f"by{k}": f"relative error of derivatives by {name}" for k, name in enumerate(by)}
    return _lines(rows, "seconds", "processor seconds of the gradient", panels, "way")


# ---- parts -------------------------------------------------------------------------------
def _lines(
    rows: list[dict[str, Any]], x: str, x_title: str, panels: dict[str, str], kind: str
) -> vl.Spec | None:
    """A panel for each column, with a line for each method and each ``kind`` of its runs.

    Methods have their marks and kinds have dashes. The colour is that of the method, or of the
    precision: variants of a method have almost one colour, and precisions are what is compared.
    """
    options = vl.ChartOptions(line_styles(row["series"] for row in rows))
    data = vl.Dataset("sweep", rows)
    kinds = dict.fromkeys(row["line"] for row in rows)
    color = _kinds(kinds, _COLORS) if kind == "precision" else options.colors()
    dashes = _kinds(kinds, [list(dash) for dash in DASHES])
    made = []
    for column, title in panels.items():
        if not any(row.get(column) for row in rows):
            continue
        both = {
            "x": _log(x, x_title, rows, "~g"),
            "y": _log(column, title, rows, ".0e"),
            "color": color,
            "order": vl.quantity("place"),  # costs need not grow from run to run
        }
        # Detail keeps the lines of methods apart where the colour does not.
        lines = both | {"strokeDash": dashes, "detail": vl.category("series")}
        tooltip = _tooltip(kind, **{x: x_title, column: title})
        points = both | {"shape": options.shapes(), "tooltip": tooltip}
        made.append(
            {
                "data": data.source,
                "transform": [{"filter": f"datum[{column!r}] > 0"}],
                "layer": [
                    {"mark": {"type": "line", "strokeWidth": 1.6}, "encoding": lines},
                    {"mark": {"type": "point", "size": 45}, "encoding": points},
                ],
            }
        )
    return vl.arrange(made, [data], 2, height=230)


def _log(column: str, title: str, rows: Sequence[dict[str, Any]], numbers: str) -> vl.Spec:
    """A logarithmic channel of a column, with its title."""
    axis = vl.log_axis([row.get(column) for row in rows], numbers)
    return vl.log_quantity(column, title=title, axis=axis)


def _kinds(names: Iterable[str], values: Sequence[Any], **legend: Any) -> vl.Spec:
    """A channel with a colour, a dash or a mark for each kind of line."""
    domain = list(names)
    scale = {"domain": domain, "range": list(values[: len(domain)])}
    return vl.category("line", scale=scale, legend={"title": None, **legend})


def _tooltip(kind: str = "", **numbers: str) -> list[vl.Spec]:
    """Texts at a point: the method, the kind of its line, and numbers by their columns."""
    kinds = [vl.category("line", title=kind)] if kind else []
    shown = [vl.quantity(column, title=t, format=".3g") for column, t in numbers.items()]
    return [vl.category("series", title="integrator"), *kinds, *shown]
