"""Charts of errors: against step size, against cost, acceleration against position."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bench.results.quantities import COST, GROUP_NAMES, NORM, NORMS
from reports.charts import vega_lite as vl
from reports.charts.error_panels import (
    error_lines,
    error_panel,
    full_norm,
    run_rows,
)
from reports.charts.line_styles import LineStyle, styles_of
from reports.formatting import order_text
from reports.names import scene_name
from reports.questions.question import Question
from reports.series import Series


def convergence_chart(
    series: Sequence[Series],
    groups: Sequence[str],
    styles: Mapping[str, LineStyle],
    norm: str = NORM,
    interactive: bool = False,
) -> vl.Spec | None:
    """Error against step size, one panel per group; None if there is nothing to draw.

    An interactive chart holds all norms and starts with one that has errors in every group. The
    legend names the fitted orders of the norm that is shown.
    """
    constant_steps = [s for s in series if s.controls == "step" and s.ok]
    if interactive:
        norm = full_norm(constant_steps, groups, norm)
    norms = NORMS if interactive else (norm,)
    notes = {n: {s.label: _orders(s, groups, n) for s in constant_steps} for n in norms}
    options = vl.ChartOptions(styles_of(constant_steps, styles), norm, interactive, notes)
    return error_charts(constant_steps, groups, ["h"], options)


def _orders(series: Series, groups: Sequence[str], norm: str) -> str:
    """Text of the legend: the fitted orders of the groups in which they are determined."""
    fits = {group: series.fit(group, norm) for group in groups}
    known = [f"{g} {order_text(f.order)}" for g, f in fits.items() if f.order is not None]
    return f": order {', '.join(known)}" if known else ": order not determined"


def error_against_cost(
    scenes: Mapping[str, Sequence[Series]], styles: Mapping[str, LineStyle], question: Question
) -> vl.Spec | None:
    """Error against cost on every scene with several integrators, a panel each; None without any.

    Group, norm and cost are those of the question.
    """
    group, cost, norm = question.group, question.cost, question.norm
    ended = {name: [s for s in series if s.ok] for name, series in scenes.items()}
    own = {name: series for name, series in ended.items() if len(series) > 1}
    options = vl.ChartOptions(styles_of((s for runs in own.values() for s in runs), styles), norm)
    panels, data = [], []
    for name, series in own.items():
        rows = run_rows(series, [group], [norm], [cost, "seconds"])
        data.append(vl.Dataset(f"runs on {name}", rows))
        panel = error_panel(series, data[-1], group, cost, options, first=not panels)
        title = {"text": scene_name(name), "color": vl.GREY, "fontSize": 12}
        panels += [panel | {"title": title}] if panel else []
    return vl.arrange(panels, data, 3, height=170)


def work_precision_chart(
    series: Sequence[Series],
    groups: Sequence[str],
    styles: Mapping[str, LineStyle],
    interactive: bool = False,
) -> vl.Spec | None:
    """Errors in the groups against seconds and residual evaluations, a panel each.

    None if there is nothing to draw.
    """
    series = [s for s in series if s.ok]
    norm = full_norm(series, groups, NORM) if interactive else NORM
    options = vl.ChartOptions(styles_of(series, styles), norm, interactive)
    return error_charts(series, groups, ["seconds", "residuals"], options)


def error_charts(
    series: Sequence[Series], groups: Sequence[str], across: Sequence[str], options: vl.ChartOptions
) -> vl.Spec | None:
    """Errors in the groups against some of `ACROSS`, a panel each; None if all are empty."""
    shown = dict.fromkeys([*across, "seconds", COST])
    data = vl.Dataset("runs", run_rows(series, groups, options.norms, [*shown]))
    panels: list[vl.Spec] = []
    for name in across:
        for group in groups:
            panel = error_panel(series, data, group, name, options, first=not panels)
            panels += [panel] if panel else []
    columns = {1: 1, 2: 2, 4: 2, 8: 4}.get(len(panels), 3)
    return vl.arrange(panels, [data], columns, params=options.norm_buttons)


def acceleration_accuracy(
    series: Sequence[Series],
    styles: Mapping[str, LineStyle],
    norm: str = NORM,
    interactive: bool = False,
) -> vl.Spec | None:
    """Error in the acceleration over the error in the position, a line per integrator.

    Below the grey diagonal accelerations are relatively better than positions, above it worse.
    """
    series = [s for s in series if s.ok]
    options = vl.ChartOptions(styles_of(series, styles), norm, interactive)
    rows = run_rows(series, "qa", options.norms, ())
    norms = [n for n in options.norms if any({f"q_{n}", f"a_{n}"} <= row.keys() for row in rows)]
    if not norms:
        return None
    data = vl.Dataset("accuracy", rows)
    values = {g: [e for row in rows for n in norms if (e := row.get(f"{g}_{n}"))] for g in "qa"}
    ends = [f(f(errors) for errors in values.values()) for f in (min, max)]
    line: vl.Spec = {
        "data": {"values": [{"q": e, "a": e} for e in ends]},
        "mark": {"type": "line", "color": vl.GREY, "strokeWidth": 1, "strokeDash": [5, 5]},
        "encoding": {g: vl.log_quantity(f) for g, f in (("x", "q"), ("y", "a"))},
    }
    place = {
        channel: vl.log_quantity(
            group,
            title=f"relative error in {GROUP_NAMES[group]}",
            axis=vl.log_axis(values[group], ".0e"),
        )
        for channel, group in (("x", "q"), ("y", "a"))
    }
    tooltip = [vl.quantity(group, title=f"error in {group}", format=".3g") for group in "qa"]
    layers = error_lines(options, place, vl.run_tooltip(*tooltip))
    panel: vl.Spec = {
        "data": data.source,
        "transform": [
            *({"calculate": f"datum['{g}_' + {options.shown_norm}]", "as": g} for g in "qa"),
            {"filter": "datum.q > 0 && datum.a > 0"},
        ],
        "layer": [line, *layers],
    }
    if interactive:
        layers[0]["params"] = [vl.zoom("zoom_a"), vl.pick()]
    return vl.arrange([panel], [data], 1, height=340, params=options.norm_buttons)
