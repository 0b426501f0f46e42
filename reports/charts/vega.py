"""The pieces of which panels are made: data, channels, scales and ways to point at things.

A piece is plain Vega-Lite, a dictionary: nothing to copy, and the same for a page and an SVG.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from bench.results.quantities import NORMS
from reports.series import NORM_NAMES, Look

#: A chart or a part of one, as Vega-Lite spells it.
Spec = dict[str, Any]

GREY = "#808080"
_TEXT_COLUMNS = {
    *("series", "look", "norm", "run", "line", "scene", "group", "target", "cost", "text"),
}
#: Logarithmic axes name the digits 1, 2, 5 over fewer than two decades, else the decades.
_DIGITS = ((5.0, range(1, 10)), (100.0, (1, 2, 5)), (math.inf, (1,)))


@dataclass(frozen=True)
class View:
    """How a chart is to look: a look per label, the norm shown, alive or a still picture."""

    looks: Mapping[str, Look]
    norm: str = "end"
    interactive: bool = False
    #: What the legend says of a label in a norm, after its name: notes[norm][label].
    notes: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    @property
    def norms(self) -> tuple[str, ...]:
        """The norms that the chart carries."""
        return NORMS if self.interactive else (self.norm,)

    @property
    def controls(self) -> list[Spec]:
        """Buttons above the chart that choose the norm of all its panels."""
        if not self.interactive:
            return []
        labels = [NORM_NAMES[n] for n in NORMS]
        buttons = {"input": "radio", "options": list(NORMS), "labels": labels, "name": "Error "}
        return [{"name": "norm", "value": self.norm, "bind": buttons}]

    @property
    def colors(self) -> list[str]:
        """A colour per label."""
        return [look.color for look in self.looks.values()]

    @property
    def dashes(self) -> list[list[int]]:
        """Dashes per label."""
        return [list(look.dash) for look in self.looks.values()]

    @property
    def shapes(self) -> list[str]:
        """The shape of a point per label."""
        return [look.shape for look in self.looks.values()]


@dataclass(frozen=True)
class Data:
    """Rows under a name, from which any number of panels draw."""

    name: str
    rows: Sequence[Mapping[str, Any]]

    @cached_property
    def columns(self) -> list[str]:
        """The names of the columns."""
        return list(dict.fromkeys(key for row in self.rows for key in row))

    @property
    def text(self) -> str:
        """The rows as comma-separated values, which name each column once."""
        text = io.StringIO()
        writer = csv.DictWriter(text, self.columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.rows)
        return text.getvalue()

    @property
    def source(self) -> Spec:
        """Where a panel finds the rows, and how it reads them."""
        parse = {key: "string" if key in _TEXT_COLUMNS else "number" for key in self.columns}
        return {"name": self.name, "format": {"type": "csv", "parse": parse}}


# ---- channels and axes -------------------------------------------------------------------
def quantity(field: str, **more: Any) -> Spec:
    """A channel that shows numbers."""
    return {"field": field, "type": "quantitative", **more}


def by_series(values: list[Any], view: View, **legend: Any) -> Spec:
    """A channel by series; all channels and panels have one domain, so they share a legend."""
    if view.notes:
        chosen = "norm" if view.interactive else json.dumps(view.norm)
        noted = f"{json.dumps(view.notes)}[{chosen}][datum.value]"
        # One column, as the lines are long; not cut at the usual width.
        legend |= {"labelExpr": f"datum.value + {noted}", "labelLimit": 0, "columns": 1}
    return {
        "field": "series",
        "type": "nominal",
        "scale": {"domain": list(view.looks), "range": values},
        "legend": {"title": None, **legend},
    }


def log_scale() -> Spec:
    """Logarithmic, with some room at the ends."""
    return {"type": "log", "nice": False, "padding": 12}


def log_axis(values: Sequence[float], numbers: str, zoomed: str = "", **more: Any) -> Spec:
    """Grid lines of decades stand out; labels at few digits, or at all where ``zoomed`` holds."""
    ratio = max(values) / min(values)
    digits = next(list(digits) for limit, digits in _DIGITS if ratio < limit)
    exponent = "log(datum.value) / LN10"
    decade = f"abs({exponent} - round({exponent})) < 1e-6"
    digit = f"round(datum.value / pow(10, floor({exponent} + 1e-6)))"
    named = f"indexof({digits}, {digit}) >= 0" + (f" || {zoomed}" if zoomed else "")
    return {
        "tickCount": 6,
        # The label that comes with a tick is empty at some digits; this one never is.
        "labelExpr": f"{named} ? format(datum.value, '{numbers}') : ''",
        "labelOverlap": "greedy",
        "labelSeparation": 6,
        "gridOpacity": {"condition": {"test": decade, "value": 1.0}, "value": 0.25},
        **more,
    }


# ---- pointing ----------------------------------------------------------------------------
def pick() -> Spec:
    """A click on the legend isolates a method; with Shift, several."""
    return {"name": "pick", "select": {"type": "point", "fields": ["series"]}, "bind": "legend"}


def dimmed(full: float, view: View) -> Spec:
    """Opacity: what is not picked fades, in a chart that answers."""
    if not view.interactive:
        return {"value": full}
    return {"condition": {"param": "pick", "value": full}, "value": 0.07}


def menu(name: str, value: str, choices: Mapping[str, str], title: str) -> Spec:
    """A choice among names, each shown by what it stands for."""
    options, labels = list(choices), list(choices.values())
    bind = {"input": "select", "options": options, "labels": labels, "name": title}
    return {"name": name, "value": value, "bind": bind}


def zoom(name: str) -> Spec:
    """Pan by mouse, zoom with Ctrl and the wheel: plain scrolling and touch move the page."""
    drag = "[pointerdown[event.pointerType === 'mouse'], window:pointerup] > window:pointermove!"
    select = {"type": "interval", "zoom": "wheel![event.ctrlKey]", "translate": drag}
    return {"name": name, "select": select, "bind": "scales"}


# ---- charts ------------------------------------------------------------------------------
def arrange(
    panels: Sequence[Spec],
    data: Sequence[Data],
    columns: int,
    height: int = 250,
    params: Sequence[Spec] = (),
) -> Spec | None:
    """Panels in a grid over their data; None of none."""
    if not panels:
        return None
    size = {"width": {1: 620, 2: 410}.get(columns, 270), "height": height}
    return {
        "datasets": {table.name: table.text for table in data},
        "params": list(params),
        "concat": [panel | size for panel in panels],
        "columns": columns,
        "spacing": 24,
        "config": config(),
    }


def config() -> Spec:
    """No background and greys that read on light and on dark pages; legends below."""
    text = {"labelColor": GREY, "titleColor": GREY}
    return {
        "background": "transparent",
        "font": "Arial, Liberation Sans, Helvetica, sans-serif",
        "view": {"stroke": GREY, "strokeOpacity": 0.35},
        "axis": {
            **text,
            "gridColor": GREY,
            "gridOpacity": 0.3,
            "domainColor": GREY,
            "tickColor": GREY,
            "titleFontWeight": "normal",
            "titleFontSize": 12,
            "labelFontSize": 11,
        },
        "legend": {
            **text,
            "labelFontSize": 12,
            "orient": "bottom",
            "direction": "vertical",
            "columns": 2,
            "columnPadding": 40,
            "labelLimit": 440,
            "symbolSize": 90,
        },
    }


def short(value: float | None) -> float | None:
    """Five digits are more than a picture shows; None for what is not a number."""
    if value is None or not math.isfinite(value):
        return None
    return float(f"{value:.5g}")
