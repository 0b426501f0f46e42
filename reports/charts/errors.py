"""Charts of errors: of a group against step sizes, costs or the error of another group."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any

from bench.results.quantities import COST, COSTS, ERROR_NAMES, NORM, NORMS
from reports.charts import vega_lite as vl
from reports.charts.line_styles import LineStyle
from reports.formatting import order_text, symbols
from reports.names import scene_name
from reports.questions import Question
from reports.series import Series, ok_runs, reference_error, with_starts

#: Titles of what errors are shown against.
_ACROSS = {name: cost.title for name, cost in COSTS.items()} | {"h": "step size h in s"}
_ACROSS |= {group: f"relative error in {name}" for group, name in ERROR_NAMES.items()}
#: A reference's error is drawn if it lies less than this factor below the errors.
_DEEP = 1e3
#: Number formats of an axis by its field; counts have a suffix.
_FORMATS = {"h": "~g", "seconds": ".0e"} | dict.fromkeys(ERROR_NAMES, ".0e")
#: A guide to the eye runs this factor above the errors; a fitted order this close to a whole number
#: has one.
_CLEAR, _NEAR = 2.0, 0.25


def convergence_chart(
    series: Sequence[Series],
    groups: Sequence[str],
    styles: Mapping[str, LineStyle],
    norm: str = NORM,
) -> vl.Spec | None:
    """Error against step size, a panel per group; the legend names the fitted orders."""
    own, notes = [s for s in series if s.controls == "step" and s.ok], {}
    names = with_starts(own, {s.label: styles[s.label].name for s in own})
    for s in own:
        fits = {symbols(group): s.fit(group, norm) for group in groups}
        known = [f"{g} {order_text(f.order)}" for g, f in fits.items() if f.order is not None]
        start = names[s.label].removeprefix(styles[s.label].name)
        notes[s.label] = f"{start}: order {', '.join(known) or 'not determined'}"
    return error_charts(own, groups, ["h"], styles, norm, notes)


def error_against_cost(
    scenes: Mapping[str, Sequence[Series]], styles: Mapping[str, LineStyle], question: Question
) -> vl.Spec | None:
    """Error against cost on every scene with several integrators, a panel each; None without any.

    Group, norm and cost are those of the question.
    """
    group, cost, norm = question.group, question.cost, question.norm
    ended = {name: [s for s in series if s.ok] for name, series in scenes.items()}
    own = {name: series for name, series in ended.items() if len(series) > 1}
    lines = vl.Lines({s.label: styles[s.label] for runs in own.values() for s in runs})
    panels, data = [], []
    for name, series in own.items():
        data.append(vl.Dataset(f"runs on {name}", run_rows(series, [group], norm, [cost])))
        panel = _panel(series, data[-1], group, cost, lines, norm, first=not panels)
        title = {"text": scene_name(name), "color": vl.GREY, "fontSize": 12}
        panels += [panel | {"title": title}] if panel else []
    return vl.arrange(panels, data, 3, height=170)


def error_charts(
    series: Sequence[Series],
    groups: Sequence[str],
    across: Sequence[str],
    styles: Mapping[str, LineStyle],
    norm: str = NORM,
    notes: Mapping[str, str] | None = None,
) -> vl.Spec | None:
    """Errors in groups against "h", costs or other errors, a panel each; None if all are empty.

    ``notes`` stand after the names of integrators in the legend.
    """
    series = [s for s in series if s.ok]
    lines = vl.Lines({s.label: styles[s.label] for s in series}, notes or {})
    data = vl.Dataset("runs", run_rows(series, groups, norm, across))
    panels: list[vl.Spec] = []
    for name, group in product(across, groups):
        panel = _panel(series, data, group, name, lines, norm, first=not panels)
        panels += [panel] if panel else []
    columns = {1: 1, 2: 2, 4: 2, 8: 4}.get(len(panels), 3)
    return vl.arrange(panels, [data], columns, height=340 if across[0] in ERROR_NAMES else 250)


def run_rows(
    series: Sequence[Series], groups: Sequence[str], norm: str, across: Sequence[str]
) -> list[dict[str, Any]]:
    """A row per run that has an error: what it is shown against, its costs, and the errors.

    The column of an error has the name of its group and norm, such as "a_max". An error of zero
    has no place on a logarithmic axis.
    """
    rows = []
    shown = [*dict.fromkeys([*(g for g in across if g in ERROR_NAMES), *groups])]
    places = [k for k in dict.fromkeys([*across, "seconds", COST]) if k not in ERROR_NAMES]
    for s in series:
        for r in s.ok:
            row: dict[str, Any] = {"series": s.label, "run": r.resolution}
            for name in places:
                value = r.h if name == "h" else r.cost(name)
                row[name] = value if isinstance(value, int) else vl.short(value)
            errors = {f"{g}_{norm}": e for g in shown if (e := vl.short(r.error(g, norm)))}
            rows += [row | errors] if errors else []
    return rows


def _panel(
    series: Sequence[Series],
    data: vl.Dataset,
    group: str,
    across: str,
    lines: vl.Lines,
    norm: str,
    first: bool,
) -> vl.Spec | None:
    """Error of a group against one of `_ACROSS`, log-log; None if there is nothing to draw.

    Guides to the eye are behind: the reference's own error unless it lies far below, the slopes of
    whole orders, or where both errors are the same.
    """
    x, y = (f"{name}_{norm}" if name in ERROR_NAMES else name for name in (across, group))
    rows = [row for row in data.rows if row.get(x) and row.get(y)]
    if not rows:
        return None
    zoom = f"zoom_{across}_{group}"

    def place(field: str, name: str, **more: Any) -> vl.Spec:
        values = [row[field] for row in rows]
        axis = vl.log_axis(values, _FORMATS.get(name, "~s"), f"{zoom}['{field}']", **more)
        told = f", {NORMS[norm]}" if name in ERROR_NAMES and norm != NORM else ""
        return vl.log_quantity(field, title=_ACROSS[name] + told, axis=axis)

    behind = []
    floor, lowest = reference_error(ok_runs(series), group, norm), min(row[y] for row in rows)
    if floor > 0 and lowest <= floor * _DEEP:
        told = vl.quantity("floor", title="reference's own error", format=".2g")
        rule = {"y": vl.log_quantity("floor"), "tooltip": told}
        behind += _guide([{"floor": vl.short(floor)}], rule, strokeDash=[5, 5])
    if slopes := [*_slopes(series, group, norm)] if across == "h" else []:
        at = {"x": vl.log_quantity("h"), "y": vl.log_quantity("error")}
        ends = {"x2": {"field": "h2"}, "y2": {"field": "error2"}}
        behind += _guide(slopes, at | ends, strokeWidth=1)
        named = at | {"text": {"field": "name"}}
        behind += _guide(slopes, named, type="text", align="right", dx=-6, dy=-5)
    if across in ERROR_NAMES:
        both = [row[field] for row in rows for field in (x, y)]
        ends = [{"x": error, "y": error} for error in (min(both), max(both))]
        at = {name: vl.log_quantity(name) for name in "xy"}
        behind += _guide(ends, at, type="line", strokeWidth=1, strokeDash=[5, 5])
    tooltip = [vl.category("series", title="integrator"), vl.category("run", title="resolution")]
    titles = {y: f"error in {group}"} | {n: _ACROSS[n] for n in ("seconds", COST)}
    titles |= {x: f"error in {across}"} if across in ERROR_NAMES else {}
    tooltip += [vl.quantity(name, title=text, format=".3g") for name, text in titles.items()]
    bright = {"x": place(x, across), "y": place(y, group, minExtent=38)}
    bright |= {"color": lines.channel("color"), "opacity": vl.PICKED}
    dashes, copied = lines.hidden_dashes()
    line = {
        "params": vl.moves(zoom, first),
        "transform": [copied],
        "mark": {"type": "line", "strokeWidth": 1.8, "order": False},  # that of the rows
        "encoding": bright | {"strokeDash": dashes},
    }
    points = {
        "mark": {"type": "point", "filled": True, "size": 55},
        "encoding": bright | {"shape": lines.channel("shape"), "tooltip": tooltip},
    }
    filtered = {"filter": f"datum['{y}'] > 0 && datum['{x}'] > 0"}
    layers = [*behind, line, points]
    return {"data": data.source, "transform": [filtered], "layer": layers}


def _guide(rows: Sequence[vl.Spec], places: vl.Spec, **mark: Any) -> list[vl.Spec]:
    """A layer of a guide to the eye, with data of its own."""
    look = {"type": "rule", "color": vl.GREY} | mark
    return [{"data": {"values": rows}, "mark": look, "encoding": places}]


def _slopes(series: Sequence[Series], group: str, norm: str) -> Iterator[dict[str, Any]]:
    """A line for each whole order found, above the errors that were fitted by it."""
    ends: dict[int, list[tuple[float, float, float]]] = {}
    for s in series:
        fit = s.fit(group, norm)
        whole = round(fit.order or 0.0) if fit.verdict == "converges" else 0
        if fit.window and fit.order and whole > 0 and abs(fit.order - whole) <= _NEAR:
            coarse, fine = fit.window
            last = min(s.ok, key=lambda r, h=fine: abs(r.size - h))
            own = _CLEAR * (last.error(group, norm) or 0.0), fine, coarse
            ends.setdefault(whole, []).append(own)
    for order in sorted(ends):
        error, fine, coarse = max(ends[order])
        top = vl.short(error * (coarse / fine) ** order)
        start = {"name": f"order {order}", "h": vl.short(coarse), "error": top}
        yield start | {"h2": vl.short(fine), "error2": vl.short(error)}
