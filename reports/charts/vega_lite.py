"""Building blocks of charts: data sets, channels, axes, interaction, panels.

A block is plain Vega-Lite, a dictionary: the same for a page and for an SVG file.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from bench.results.flat_rows import csv_text
from problems.base.text import clean_json
from reports.charts.line_styles import LineStyle
from reports.formatting import symbols

#: A chart or a part of one: a specification of Vega-Lite, https://vega.github.io/vega-lite.
Spec = dict[str, Any]

GREY = "#808080"
_TEXT_COLUMNS = {"series", "run", "line", "scene", "target", "text", "state"}
#: Differences of larger numbers overflow.
_LARGEST = 1e300
#: Logarithmic axes name the digits 1, 2, 5 over fewer than two decades, else the decades.
_DIGITS = ((0.7, range(1, 10)), (2.0, (1, 2, 5)), (math.inf, (1,)))
#: The opacity of lines: those that are not picked fade.
PICKED: Spec = {"condition": {"param": "pick", "value": 1.0}, "value": 0.07}


class Lines(NamedTuple):
    """Channels of a chart's lines: their styles by label, and notes behind names in the legend."""

    styles: Mapping[str, LineStyle]
    notes: Mapping[str, str] = {}

    def channel(self, look: str, **legend: Any) -> Spec:
        """A "color", "dash" or "shape" per label.

        All panels have one domain, so they share a legend, of short names.
        """
        names = {k: (style.name or k) + self.notes.get(k, "") for k, style in self.styles.items()}
        said = f"({json.dumps(names)}[datum.value] || datum.value)"
        if self.notes:  # one column, as the lines are long; not cut at the usual width
            legend |= {"labelLimit": 0, "columns": 1}
        looks = [getattr(style, look) for style in self.styles.values()]
        scale = {"domain": [*names], "range": [[*x] if look == "dash" else x for x in looks]}
        return category("series", scale=scale, legend={"title": None, "labelExpr": said} | legend)

    def hidden_dashes(self) -> tuple[Spec, Spec]:
        """Dashes per label that the legend does not draw around points, and their transform.

        Channels of one domain share a legend, so this one has a domain of its own.
        """
        channel = self.channel("dash") | {"field": "dashed", "legend": None}
        channel["scale"]["domain"] = [f"line of {label}" for label in self.styles]
        return channel, {"calculate": "'line of ' + datum.series", "as": "dashed"}


class Dataset(NamedTuple):
    """Rows under a name, from which any number of panels draw."""

    name: str
    rows: Sequence[Mapping[str, Any]]

    @property
    def columns(self) -> list[str]:
        """The names of the columns."""
        return list(dict.fromkeys(key for row in self.rows for key in row))

    @property
    def source(self) -> Spec:
        """The reference to the rows in a panel, with the type of each column."""
        parse = {key: "string" if key in _TEXT_COLUMNS else "number" for key in self.columns}
        return {"name": self.name, "format": {"type": "csv", "parse": parse}}


def chart_json(value: Any, **options: Any) -> str:
    """JSON of a chart that every engine can draw: clean text, null for numbers without a value.

    ``options`` are those of `json.dumps`. Control characters stand in JSON as escapes.
    """
    return clean_json(json.dumps(_without_nan(value), ensure_ascii=False, **options))


def _without_nan(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _without_nan(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


# ---- channels and axes -------------------------------------------------------------------
def quantity(field: str, **more: Any) -> Spec:
    """A channel that shows numbers; its title has λ for lam."""
    titled = {"title": symbols(more["title"])} if more.get("title") else {}
    return {"field": field, "type": "quantitative", **more, **titled}


def log_quantity(
    field: str, values: Sequence[float | None] = (), numbers: str = "", **more: Any
) -> Spec:
    """A channel that shows numbers on a logarithmic scale with some room at the ends.

    With ``values``, those along it, it has the `log_axis` of them.
    """
    axis = {"axis": log_axis(values, numbers)} if values else {}
    scale = {"type": "log", "nice": False, "padding": 12}
    return quantity(field, scale=scale, **axis, **more)


def category(field: str, **more: Any) -> Spec:
    """A channel that shows names."""
    return {"field": field, "type": "nominal", **more}


def colors(field: str, looks: Mapping[str, str], **legend: Any) -> Spec:
    """A channel of colours by name, in the order of the legend."""
    scale = {"domain": [*looks], "range": [*looks.values()]}
    return category(field, scale=scale, legend={"title": None} | legend)


def log_axis(values: Sequence[float | None], numbers: str, zoomed: str = "", **more: Any) -> Spec:
    """A logarithmic axis with strong grid lines at decades and labels at few digits.

    ``zoomed`` is a Vega expression; where it holds, all digits have labels.
    """
    known = [value for value in values if value and value > 0] or [1.0]
    decades = math.log10(max(known)) - math.log10(min(known))
    digits = next(list(digits) for most, digits in _DIGITS if decades < most)
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


def moves(name: str, first: bool) -> list[Spec]:
    """Parameters of a panel's first layer; all panels share the legend that the first one hears.

    A click on the legend isolates a method, with Shift several. The mouse pans, Ctrl and the wheel
    zoom: plain scrolling and touch move the page. In a picture they do nothing.
    """
    drag = "[pointerdown[event.pointerType === 'mouse'], window:pointerup] > window:pointermove!"
    select = {"type": "interval", "zoom": "wheel![event.ctrlKey]", "translate": drag}
    pick = {"name": "pick", "select": {"type": "point", "fields": ["series"]}, "bind": "legend"}
    return [{"name": name, "select": select, "bind": "scales"}, *([pick] if first else [])]


# ---- charts ------------------------------------------------------------------------------
def line_panel(data: Dataset, x: Spec, y: Spec, lines: Lines, **mark: Any) -> Spec:
    """A line per series, with a legend of colours and dashes."""
    looks = {"color": lines.channel("color"), "strokeDash": lines.channel("dash")}
    return {
        "data": data.source,
        "mark": {"type": "line", "strokeWidth": 1.8, "clip": True} | mark,
        "encoding": {"x": x, "y": y} | looks,
    }


def arrange(
    panels: Sequence[Spec], data: Sequence[Dataset], columns: int, height: int = 250
) -> Spec | None:
    """Panels in a grid with their data; None if there are no panels."""
    if not panels:
        return None
    size = {"width": {1: 620, 2: 410}.get(columns, 270), "height": height}
    grid = {"concat": [panel | size for panel in panels], "columns": columns, "spacing": 24}
    return _chart(data) | grid


def view(data: Dataset, **parts: Any) -> Spec:
    """A chart of one panel."""
    return _chart([data]) | {"data": data.source} | parts


def _chart(data: Sequence[Dataset]) -> Spec:
    """The rows as CSV by name, which names each column only once, and the look of charts.

    No background, greys that read on light and dark pages, legends below.
    """
    text = {"labelColor": GREY, "titleColor": GREY}
    lines = {"gridColor": GREY, "gridOpacity": 0.3, "domainColor": GREY, "tickColor": GREY}
    titles = {"titleFontWeight": "normal", "titleFontSize": 12, "labelFontSize": 11}
    place = {"orient": "bottom", "direction": "vertical", "columns": 2, "columnPadding": 40}
    return {
        "datasets": {table.name: csv_text(table.rows) for table in data},
        "config": {
            "background": "transparent",
            "font": "Arial, Liberation Sans, Helvetica, sans-serif",
            "view": {"stroke": GREY, "strokeOpacity": 0.35},
            "axis": text | lines | titles,
            "legend": text | place | {"labelFontSize": 12, "labelLimit": 440, "symbolSize": 90},
        },
    }


def short(value: float | None) -> float | None:
    """A number rounded to five digits, enough for a chart; None if no axis can show it."""
    if value is None or not abs(value) <= _LARGEST:
        return None
    return float(f"{value:.5g}")
