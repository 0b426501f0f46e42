"""Single figures for print: size, fonts, line widths, and the formats of the files."""

from __future__ import annotations

import re

from problems.spec import SpecError
from reports.charts.rendering import picture
from reports.charts.vega_lite import Spec, chart_json

#: Width of a column in points (88 mm), and height of the panel without its legend.
_WIDTH, _HEIGHT = 250, 165
_PNG_PER_INCH = 300
FORMATS = (".svg", ".png", ".pdf", ".json")
_SCHEMA = "https://vega.github.io/schema/vega-lite/v6.json"
_THIN: dict[str, Spec] = {
    "line": {"strokeWidth": 0.9},
    "point": {"size": 24},
    "rule": {"strokeWidth": 0.5},
    "text": {"fontSize": 7, "dx": -3, "dy": -3},
}


def on_paper(chart: Spec) -> Spec:
    """The only panel of a chart, as wide as a column; its lines and points get thinner."""
    (panel,) = chart["concat"]
    for layer in panel["layer"]:
        layer["encoding"].get("y", {}).get("axis", {}).pop("minExtent", None)
        mark = layer["mark"]
        # A broad line behind the others stays broader.
        mark |= {"strokeWidth": 3} if mark.get("strokeWidth", 0) > 3 else _THIN[mark["type"]]
        for channel in ("color", "strokeDash"):
            if (layer["encoding"].get(channel, {}).get("legend") or {}).get("symbolSize"):
                layer["encoding"][channel]["legend"]["symbolSize"] = 160
    return panel | {
        "$schema": _SCHEMA,
        "datasets": chart["datasets"],
        "width": _WIDTH,
        "height": _HEIGHT,
        "autosize": {"type": "fit-x", "contains": "padding"},
        "padding": 2,
        "config": _config(),
    }


def _config() -> Spec:
    """Black on white, thin axes without a grid, 8 points of text."""
    text = {"labelFontSize": 8, "titleFontSize": 8, "titleFontWeight": "normal"}
    colors = {"tickColor": "black", "labelColor": "black", "titleColor": "black"}
    sizes = {"tickWidth": 0.5, "tickSize": 3, "titlePadding": 4}
    place = {"orient": "bottom", "direction": "vertical", "columns": 1, "offset": 6}
    symbols = {"rowPadding": 1, "symbolSize": 30, "symbolStrokeWidth": 0.9}
    return {
        "background": "white",
        "font": "Helvetica, Arial, Liberation Sans, sans-serif",
        "view": {"stroke": "black", "strokeWidth": 0.5},
        "axis": text | colors | sizes | {"grid": False, "domain": False},
        "legend": text | place | symbols | {"labelLimit": _WIDTH - 30},
    }


def file_content(figure: Spec, suffix: str) -> bytes:
    """Return the content of a figure's file; ``suffix`` is one of `FORMATS`.

    Raises
    ------
    SpecError
        If the figure cannot be drawn.
    """
    if suffix == ".json":
        return f"{chart_json(figure, indent=1)}\n".encode()
    options = {"ppi": _PNG_PER_INCH} if suffix == ".png" else {}
    drawn = picture(figure, suffix[1:], **options)
    if drawn.reason:
        raise SpecError(drawn.sentence)
    if suffix != ".svg":
        return drawn.content
    # A pixel of the drawing is a point on paper, as it is in the PDF.
    return re.sub(rb'(?<= )(width|height)="([\d.]+)"', rb'\1="\2pt"', drawn.content, count=2)
