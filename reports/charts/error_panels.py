"""Panels of errors: a group's error against step size or cost, with guides to the eye."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from bench.results.quantities import COST, COSTS, ERROR_NAMES, NORMS
from reports.charts import vega_lite as vl
from reports.series import (
    Series,
    cost_of,
    error_of,
    ok_runs,
    reference_error,
    seconds_of,
    step_or_tolerance,
    whole_order,
)

#: A reference's error is drawn if it lies less than this factor below the errors.
_DEEP = 1e3
#: Number formats of an axis by its field; counts have a suffix.
_FORMATS = {"h": "~g", "seconds": ".0e"}
#: A guide to the eye runs this factor above the errors.
_CLEAR = 2.0


def error_data(
    series: Sequence[Series],
    group: str,
    options: vl.ChartOptions,
    counts: Sequence[str] = (COST,),
) -> vl.Dataset:
    """One row per run and norm with an error above zero, named after the group."""
    rows: list[dict[str, Any]] = []
    for s in series:
        for record in s.ok:
            run = {
                "h": vl.short(step_or_tolerance(record)),
                "run": record.resolution,
                "seconds": vl.short(seconds_of(record)),
                "fastest": vl.short(min(record.run_s, default=None)),
                "slowest": vl.short(max(record.run_s, default=None)),
                **{name: cost_of(record, name) for name in counts},
            }
            for norm in options.norms:
                error = vl.short(error_of(record, group, norm))
                if error is not None and error > 0:
                    rows.append({"series": s.label, "norm": norm, "error": error, **run})
    return vl.Dataset(group, rows)


def full_norm(series: Sequence[Series], groups: Sequence[str], norm: str) -> str:
    """The norm if every group has an error above zero in it, else the first such norm."""

    def full(norm: str) -> bool:
        return all(any(error_of(r, group, norm) for r in ok_runs(series)) for group in groups)

    return norm if full(norm) else next(filter(full, NORMS), norm)


def error_panel(
    data: vl.Dataset,
    across: tuple[str, str],
    options: vl.ChartOptions,
    first: bool,
    behind: Sequence[vl.Spec] = (),
) -> vl.Spec | None:
    """Error against ``across`` (field, title), log-log, in front of the layers ``behind``.

    None if there is nothing to draw. ``first``: the panel handles clicks on the shared legend.
    """
    field, title = across
    rows = [row for row in data.rows if row.get(field)]
    if not rows:
        return None
    zoomed = f"zoom_{field}_{data.name}" if options.interactive else ""
    x_axis = vl.log_axis(
        [row[field] for row in rows], _FORMATS.get(field, "~s"), zoomed and f"{zoomed}.{field}"
    )
    y_axis = vl.log_axis([row["error"] for row in rows], ".0e", zoomed and f"{zoomed}.error")
    x = vl.log_quantity(field, title=title, axis=x_axis)
    y_title = f"relative error in {ERROR_NAMES[data.name]}"
    y = vl.log_quantity("error", title=y_title, axis=y_axis | {"minExtent": 38})
    tooltip = vl.run_tooltip(
        vl.quantity("error", title=f"error in {data.name}", format=".3g"),
        vl.quantity("seconds", title="median s", format=".3g"),
        vl.quantity(COST, title=COSTS[COST].title, format=".3s"),
    )
    layers = error_lines(options, {"x": x}, "h", tooltip, size=55)
    if field == "seconds":
        fastest = vl.log_quantity("fastest", title=title)
        ends = {"x": fastest, "x2": {"field": "slowest"}, "opacity": options.opacity(0.45)}
        ends |= {"color": options.colors()}
        layers.append({"mark": {"type": "rule", "strokeWidth": 1}, "encoding": ends})
    filters = [f"datum.{field} > 0"]
    if options.interactive:
        filters.append("datum.norm == norm")
        # The shared legend works only with a selection of the first layer.
        layers[0]["params"] = [vl.zoom(zoomed), *([vl.pick()] if first else [])]
    return {
        "data": data.source,
        "transform": [{"filter": text} for text in filters],
        "encoding": {"y": y},
        "layer": [*behind, *layers],
    }


def error_lines(
    options: vl.ChartOptions, place: vl.Spec, order: str, tooltip: list[vl.Spec], size: int = 60
) -> list[vl.Spec]:
    """The layers of lines and points at ``place`` (the channels x, y), in the order of a field."""
    bright = place | {"color": options.colors(), "opacity": options.opacity()}
    dashes = {"strokeDash": options.dashes_without_legend(), "order": vl.quantity(order)}
    return [
        {
            "transform": [vl.COPIED],
            "mark": {"type": "line", "strokeWidth": 1.8},
            "encoding": bright | dashes,
        },
        {
            "mark": {"type": "point", "filled": True, "size": size},
            "encoding": bright | {"shape": options.shapes(), "tooltip": tooltip},
        },
    ]


def floor_row(floor: float, lowest: float) -> dict[str, float | int | None]:
    """A row with the reference's own error, hidden if it lies far below all errors.

    The hidden line stands at the lowest error: Vega warns of a scale without values.
    """
    seen = floor > 0 and floor * _DEEP >= lowest
    return {"floor": vl.short(floor if seen else lowest), "seen": int(seen)}


def floor_layer() -> vl.Spec:
    """A dashed line at the reference's own error."""
    return {
        "mark": {"type": "rule", "color": vl.GREY, "strokeDash": [5, 5]},
        "encoding": {
            "y": vl.log_quantity("floor"),
            "opacity": {"condition": {"test": "datum.seen", "value": 1}, "value": 0},
            "tooltip": vl.quantity("floor", title="reference's own error", format=".2g"),
        },
    }


def floor_rule(
    series: Sequence[Series], data: vl.Dataset, options: vl.ChartOptions
) -> list[vl.Spec]:
    """A line at the reference's own error, if it can be seen in any norm of the panel."""
    runs, rows = ok_runs(series), []
    for norm in options.norms:
        errors = [row["error"] for row in data.rows if row["norm"] == norm]
        if errors:
            rows.append(
                {"norm": norm} | floor_row(reference_error(runs, data.name, norm), min(errors))
            )
    if not any(row["seen"] for row in rows):
        return []
    layer = {"data": {"values": rows}} | floor_layer()
    if options.interactive:
        layer["transform"] = [{"filter": "datum.norm == norm"}]
    return [layer]


def slope_guides(
    series: Sequence[Series], data: vl.Dataset, options: vl.ChartOptions
) -> list[vl.Spec]:
    """A thin line for each whole order found, above the errors that were fitted by it."""
    found = {norm: list(_guides(series, data.name, norm)) for norm in options.norms}
    if not any(found.values()):
        return []
    rows = [row for norm, guides in found.items() for row in guides or _no_guide(data, norm)]
    layer: vl.Spec = {"data": {"values": rows}}
    if options.interactive:
        layer["transform"] = [{"filter": "datum.norm == norm"}]
    x, y = vl.log_quantity("h"), vl.log_quantity("error")
    ends = {"x": x, "y": y, "x2": {"field": "h2"}, "y2": {"field": "error2"}}
    rule = {"type": "rule", "color": vl.GREY, "strokeWidth": 1}
    text = {"type": "text", "color": vl.GREY, "align": "right", "dx": -6, "dy": -5}
    named = {"x": x, "y": y, "text": {"field": "name"}}
    return [layer | {"mark": rule, "encoding": ends}, layer | {"mark": text, "encoding": named}]


def _no_guide(data: vl.Dataset, norm: str) -> list[dict[str, Any]]:
    """A guide of no length: Vega warns of a scale without values."""
    points = [(row["h"], row["error"]) for row in data.rows if row["norm"] == norm]
    ends = ({"h": h, "error": error, "h2": h, "error2": error} for h, error in points[:1])
    return [{"norm": norm, "name": ""} | end for end in ends]


def _guides(series: Sequence[Series], group: str, norm: str) -> Iterator[dict[str, Any]]:
    fits = [(s, fit) for s in series if (fit := s.fit(group, norm)).window]
    for order in sorted({whole for _, fit in fits if (whole := whole_order(fit))}):
        ends = []
        for s, fit in fits:
            if whole_order(fit) == order and fit.window:
                coarse, fine = fit.window
                last = min(s.ok, key=lambda r, h=fine: abs(step_or_tolerance(r) - h))
                ends.append((_CLEAR * (error_of(last, group, norm) or 0.0), fine, coarse))
        error, fine, coarse = max(ends)
        yield {
            "norm": norm,
            "name": f"order {order}",
            "h": vl.short(coarse),
            "error": vl.short(error * (coarse / fine) ** order),
            "h2": vl.short(fine),
            "error2": vl.short(error),
        }
