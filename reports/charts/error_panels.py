"""Panels of errors: a group's error against steps or costs, with guides to the eye."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from typing import Any

from bench.results.quantities import COST, COSTS, ERROR_NAMES, NORM, NORMS
from bench.results.records import Record
from reports.charts import vega_lite as vl
from reports.series import (
    Series,
    ok_runs,
    reference_error,
    step_or_tolerance,
    whole_order,
)

#: Titles of what errors are shown against.
ACROSS = {name: cost.title for name, cost in COSTS.items()} | {
    "h": "step size h in s",
    "rtol": "relative tolerance",
}
#: A reference's error is drawn if it lies less than this factor below the errors.
_DEEP = 1e3
#: Number formats of an axis by its field; counts have a suffix.
_FORMATS = {"h": "~g", "seconds": ".0e"}
#: A guide to the eye runs this factor above the errors.
_CLEAR = 2.0

RunRows = list[dict[str, Any]]


def run_rows(
    series: Sequence[Series], groups: Sequence[str], norms: Sequence[str], across: Sequence[str]
) -> RunRows:
    """A row per run that has an error: what it is shown against, and a column per error.

    The column of an error has the name of its group and norm, such as "a_max". An error of zero
    has no place on a logarithmic axis. "a_low" and "a_high" are the ends of the errors from this
    start and from later ones, where there are any.
    """
    rows = []
    for s in series:
        for r in s.ok:
            row: dict[str, Any] = {"series": s.label, "run": r.resolution}
            for name in across:
                value = getattr(r, name) if name in ("h", "rtol") else r.cost(name)
                row[name] = value if isinstance(value, int) else vl.short(value)
            if "seconds" in across:
                row["fastest"] = vl.short(min(r.run_s, default=None))
                row["slowest"] = vl.short(max(r.run_s, default=None))
            errors = {
                f"{group}_{norm}": error
                for group in groups
                for norm in norms
                if (error := vl.short(r.error(group, norm)))
            }
            bars = {f"{group}_{end}": e for group in groups for end, e in _bar(r, group).items()}
            rows += [row | errors | bars] if errors else []
    return rows


def _bar(record: Record, group: str) -> dict[str, Any]:
    found = [record.error(group, NORM), *(errors.get(group) for errors in record.later)]
    known = [error for error in found if error]
    return {"low": vl.short(min(known)), "high": vl.short(max(known))} if len(known) > 1 else {}


def _errors_by_norm(
    rows: Sequence[Mapping[str, Any]], group: str, norms: Sequence[str]
) -> dict[str, list[float]]:
    """The errors of a group in rows of `run_rows`."""
    return {n: [row[f"{group}_{n}"] for row in rows if f"{group}_{n}" in row] for n in norms}


def full_norm(series: Sequence[Series], groups: Sequence[str], norm: str) -> str:
    """The norm if every group has an error above zero in it, else the first such norm."""

    def full(norm: str) -> bool:
        return all(any(r.error(group, norm) for r in ok_runs(series)) for group in groups)

    return norm if full(norm) else next(filter(full, NORMS), norm)


def error_panel(
    series: Sequence[Series],
    data: vl.Dataset,
    group: str,
    across: str,
    options: vl.ChartOptions,
    first: bool,
) -> vl.Spec | None:
    """Error of a group against one of `ACROSS`, log-log; None if there is nothing to draw.

    ``data`` are the `run_rows` of the series. ``first``: the panel handles clicks on the shared
    legend.
    """
    rows = [row for row in data.rows if row.get(across)]
    errors = _errors_by_norm(rows, group, options.norms)
    if not any(errors.values()):
        return None
    zoomed = f"zoom_{across}_{group}" if options.interactive else ""
    field = "error" if options.interactive else f"{group}_{options.norm}"
    x_axis = vl.log_axis(
        [row[across] for row in rows], _FORMATS.get(across, "~s"), zoomed and f"{zoomed}.{across}"
    )
    y_axis = vl.log_axis([*chain(*errors.values())], ".0e", zoomed and f"{zoomed}.error")
    place = {
        "x": vl.log_quantity(across, title=ACROSS[across], axis=x_axis),
        "y": vl.log_quantity(
            field, title=f"relative error in {ERROR_NAMES[group]}", axis=y_axis | {"minExtent": 38}
        ),
    }
    costs = [name for name in ("seconds", COST) if name in data.columns]
    tooltip = vl.run_tooltip(
        vl.quantity(field, title=f"error in {group}", format=".3g"),
        *(vl.quantity(name, title=ACROSS[name], format=".3g") for name in costs),
    )
    lines = error_lines(options, place, tooltip, size=55)
    transform: list[vl.Spec] = [{"filter": f"datum['{field}'] > 0 && datum.{across} > 0"}]
    if options.interactive:
        transform.insert(0, {"calculate": f"datum['{group}_' + norm]", "as": "error"})
        # The shared legend works only with a selection of the first layer.
        lines[0]["params"] = [vl.zoom(zoomed), *([vl.pick()] if first else [])]
    if across == "seconds":
        lines.append(_times_layer(options, place["y"]))
    if any(f"{group}_low" in row for row in rows):
        lines.append(_later_layer(options, place["x"], group))
    behind = _floor_layer(_floors(series, group, errors), options)
    behind += _slope_guides(series, group, errors, data, options) if across == "h" else []
    return {"data": data.source, "transform": transform, "layer": [*behind, *lines]}


def error_lines(
    options: vl.ChartOptions, place: vl.Spec, tooltip: list[vl.Spec], size: int = 60
) -> list[vl.Spec]:
    """The layers of lines and points at ``place`` (the channels x, y), from coarse to fine."""
    bright = place | {"color": options.colors(), "opacity": options.opacity()}
    return [
        {
            "transform": [vl.COPIED],
            "mark": {"type": "line", "strokeWidth": 1.8, "order": False},  # that of the rows
            "encoding": bright | {"strokeDash": options.dashes_without_legend()},
        },
        {
            "mark": {"type": "point", "filled": True, "size": size},
            "encoding": bright | {"shape": options.shapes(), "tooltip": tooltip},
        },
    ]


def _times_layer(options: vl.ChartOptions, y: vl.Spec) -> vl.Spec:
    """A bar from the fastest to the slowest sample of each run."""
    ends = {"x": vl.log_quantity("fastest"), "x2": {"field": "slowest"}, "y": y}
    looks = {"color": options.colors(), "opacity": options.opacity(0.45)}
    return {"mark": {"type": "rule", "strokeWidth": 1}, "encoding": ends | looks}


def _later_layer(options: vl.ChartOptions, x: vl.Spec, group: str) -> vl.Spec:
    """A bar over the errors of each run from its start and from later ones, in their norm."""
    ends = {"y": vl.log_quantity(f"{group}_low"), "y2": {"field": f"{group}_high"}, "x": x}
    looks = {"color": options.colors(), "opacity": options.opacity(0.45)}
    shown = f"datum['{group}_low'] > 0 && {options.shown_norm} === '{NORM}'"
    return {
        "transform": [{"filter": shown}],
        "mark": {"type": "rule", "strokeWidth": 1},
        "encoding": ends | looks,
    }


# ---- the reference's own error ------------------------------------------------------------
def _floors(series: Sequence[Series], group: str, errors: Mapping[str, Sequence[float]]) -> RunRows:
    """The reference's own error in a group by norm; no rows if none can be seen.

    It is hidden if it lies far below all ``errors``, which are by norm. The hidden line stands at
    the lowest error: Vega warns of a scale without values.
    """
    rows = []
    for norm, found in errors.items():
        if found:
            floor, lowest = reference_error(ok_runs(series), group, norm), min(found)
            seen = floor > 0 and floor * _DEEP >= lowest
            row = {"norm": norm, "floor": vl.short(floor if seen else lowest), "seen": int(seen)}
            rows.append(row)
    return rows if any(row["seen"] for row in rows) else []


def _floor_layer(rows: RunRows, options: vl.ChartOptions) -> list[vl.Spec]:
    """A dashed line at the reference's own error in the norm shown."""
    if not rows:
        return []
    return [
        {
            "data": {"values": rows},
            "transform": [{"filter": f"datum.norm === {options.shown_norm}"}],
            "mark": {"type": "rule", "color": vl.GREY, "strokeDash": [5, 5]},
            "encoding": {
                "y": vl.log_quantity("floor"),
                "opacity": {"condition": {"test": "datum.seen", "value": 1}, "value": 0},
                "tooltip": vl.quantity("floor", title="reference's own error", format=".2g"),
            },
        }
    ]


# ---- guides ------------------------------------------------------------------------------
def _slope_guides(
    series: Sequence[Series],
    group: str,
    errors: Mapping[str, Sequence[float]],
    data: vl.Dataset,
    options: vl.ChartOptions,
) -> list[vl.Spec]:
    """A thin line for each whole order found, above the errors that were fitted by it."""
    found = {norm: list(_guides(series, group, norm)) for norm in errors}
    if not any(found.values()):
        return []
    rows = [row for n, guides in found.items() for row in guides or _no_guide(data, group, n)]
    layer: vl.Spec = {"data": {"values": rows}}
    layer["transform"] = [{"filter": f"datum.norm === {options.shown_norm}"}]
    x, y = vl.log_quantity("h"), vl.log_quantity("error")
    ends = {"x": x, "y": y, "x2": {"field": "h2"}, "y2": {"field": "error2"}}
    rule = {"type": "rule", "color": vl.GREY, "strokeWidth": 1}
    text = {"type": "text", "color": vl.GREY, "align": "right", "dx": -6, "dy": -5}
    named = {"x": x, "y": y, "text": {"field": "name"}}
    return [layer | {"mark": rule, "encoding": ends}, layer | {"mark": text, "encoding": named}]


def _no_guide(data: vl.Dataset, group: str, norm: str) -> RunRows:
    """A guide of no length: Vega warns of a scale without values."""
    points = [(row["h"], e) for row in data.rows if (e := row.get(f"{group}_{norm}"))]
    return [
        {"norm": norm, "name": "", "h": h, "error": error, "h2": h, "error2": error}
        for h, error in points[:1]
    ]


def _guides(series: Sequence[Series], group: str, norm: str) -> Iterator[dict[str, Any]]:
    fits = [(s, fit) for s in series if (fit := s.fit(group, norm)).window]
    for order in sorted({whole for _, fit in fits if (whole := whole_order(fit))}):
        ends = []
        for s, fit in fits:
            if whole_order(fit) == order and fit.window:
                coarse, fine = fit.window
                last = min(s.ok, key=lambda r, h=fine: abs(step_or_tolerance(r) - h))
                ends.append((_CLEAR * (last.error(group, norm) or 0.0), fine, coarse))
        error, fine, coarse = max(ends)
        yield {
            "norm": norm,
            "name": f"order {order}",
            "h": vl.short(coarse),
            "error": vl.short(error * (coarse / fine) ** order),
            "h2": vl.short(fine),
            "error2": vl.short(error),
        }
