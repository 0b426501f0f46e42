"""Charts of measurements beside the cells: errors over steps, over costs, and times of steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bench.results.gradients import Gradients
from bench.results.precision import PrecisionRun, groups_of
from bench.results.realtime import RealTimeRun
from reports.charts import vega_lite as vl
from reports.charts.line_styles import DASHES, MARKS, line_styles
from reports.formatting import symbols

#: Quantiles of the time of a step, as columns of `StepTimes` and in words.
_QUANTILES = {"median_us": "median", "p999_us": "99.9 %", "worst_us": "worst"}


# ---- a fixed budget per step -------------------------------------------------------------
def budget_chart(runs: Sequence[RealTimeRun]) -> vl.Spec | None:
    """Times of the steps of each run beside the deadline, and its error; a row for each run."""
    options = vl.ChartOptions(line_styles(run.integrator for run in runs))
    names = [f"{options.styles[run.integrator].name}, {run.iterations}" for run in runs]
    times, errors = [], []
    for name, run in zip(names, runs, strict=True):
        row = {"series": run.integrator, "text": name}
        for column, word in _QUANTILES.items():
            times.append(row | {"line": word, "time": vl.short(getattr(run.times, column))})
        if run.error:
            errors.append(row | {"error": vl.short(run.error)})
    if not times:
        return None
    deadline = 1e6 / runs[0].rate
    data = vl.Dataset("times", times), vl.Dataset("errors", errors)
    known = [row["time"] for row in times]
    x = vl.log_quantity("time", title="time of a step in µs", axis=vl.log_axis(known, "~s"))
    y = vl.category("text", title=None, sort=None, scale={"domain": names})
    y |= {"axis": {"labelLimit": 320, "grid": True}}
    both = {"x": x, "y": y, "color": options.colors(legend=None)}
    marks = _kinds(_QUANTILES.values(), MARKS)
    panels: list[vl.Spec] = [
        {
            "data": data[0].source,
            "layer": [
                {"mark": {"type": "line", "strokeWidth": 1.4}, "encoding": both},
                {
                    "mark": {"type": "point", "filled": True, "size": 60, "opacity": 1},
                    "encoding": both
                    | {"shape": marks, "tooltip": _tooltip("quantile", time="time in µs")},
                },
                {
                    "data": {"values": [{}]},
                    "mark": {"type": "rule", "color": vl.GREY, "strokeWidth": 2},
                    "encoding": {"x": {"datum": deadline}},
                },
            ],
        }
    ]
    if errors:
        axis = vl.log_axis([row["error"] for row in errors], ".0e")
        title = "largest relative error of q, v, a, λ"
        bare = y | {"axis": y["axis"] | {"labels": False}}
        panels.append(
            {
                "data": data[1].source,
                "mark": {"type": "point", "filled": True, "size": 80, "opacity": 1},
                "encoding": both
                | {"x": vl.log_quantity("error", title=title, axis=axis), "y": bare}
                | {"tooltip": _tooltip(error="error")},
            }
        )
    return vl.arrange(panels, data[: len(panels)], 2, height=24 * len(runs) + 16)


# ---- precisions --------------------------------------------------------------------------
def precision_chart(runs: Sequence[PrecisionRun]) -> vl.Spec | None:
    """Errors over the step in each precision, a panel for each group of variables."""
    rows = [
        {"series": run.integrator, "line": run.precision, "h": vl.short(run.h)}
        | {group: vl.short(error) for group, error in run.errors.items() if error}
        for run in runs
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
            row |= {"cost": vl.short(run.run_s * run.cost), "place": len(rows)}
            errors = enumerate(run.errors)
            rows.append(row | {f"by{k}": vl.short(error) for k, error in errors if error})
    by = found[0].exact.by if found else []
    panels = {f"by{k}": f"relative error of derivatives by {name}" for k, name in enumerate(by)}
    return _lines(rows, "cost", "processor seconds of the gradient", panels, "way")


# ---- parts -------------------------------------------------------------------------------
def _lines(
    rows: list[dict[str, Any]], x: str, x_title: str, panels: dict[str, str], kind: str
) -> vl.Spec | None:
    """A panel for each column, with a line for each method and each ``kind`` of its runs.

    Methods have their colours; kinds have dashes and marks.
    """
    options = vl.ChartOptions(line_styles(row["series"] for row in rows))
    data = vl.Dataset("sweep", rows)
    kinds = dict.fromkeys(row["line"] for row in rows)
    axis = vl.log_axis([row[x] for row in rows], "~g" if x == "h" else ".0e")
    made = []
    for column, title in panels.items():
        known = [row[column] for row in rows if row.get(column)]
        if known:
            y_axis = vl.log_axis(known, ".0e")
            encoding = {
                "x": vl.log_quantity(x, title=x_title, axis=axis),
                "y": vl.log_quantity(column, title=title, axis=y_axis),
                "color": options.colors(),
                "strokeDash": _kinds(kinds, [list(dash) for dash in DASHES]),
                "shape": _kinds(kinds, MARKS),
                "tooltip": _tooltip(kind, **{x: x_title, column: title}),
            }
            if "place" in data.columns:  # costs need not grow from run to run
                encoding["order"] = vl.quantity("place")
            mark = {"type": "line", "strokeWidth": 1.6, "point": {"size": 45, "filled": False}}
            made.append(
                {
                    "data": data.source,
                    "transform": [{"filter": f"datum[{column!r}] > 0"}],
                    "mark": mark,
                    "encoding": encoding,
                }
            )
    return vl.arrange(made, [data], 2, height=230)


def _kinds(names: Any, values: Sequence[Any]) -> vl.Spec:
    """A channel with a dash or a mark for each kind of line."""
    scale = {"domain": [*names], "range": [*values[: len([*names])]]}
    return vl.category("line", scale=scale, legend={"title": None, "symbolFillColor": vl.GREY})


def _tooltip(kind: str = "", **numbers: str) -> list[vl.Spec]:
    """Texts at a point: the method, the kind of its line, and numbers by their columns."""
    kinds = [vl.category("line", title=kind)] if kind else []
    shown = [vl.quantity(column, title=t, format=".3g") for column, t in numbers.items()]
    return [vl.category("series", title="integrator"), *kinds, *shown]
