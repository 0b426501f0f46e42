"""stability.html: the stability analysis of integrators as charts, maps and tables."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import vl_convert

from reports.charts.stability import radius_map, stability_curves
from reports.charts.vega_lite import Spec
from reports.pages.templating import html
from reports.text.stability_tables import stability_tables

FILE = "stability.html"


def write_stability_page(found: Sequence[dict[str, Any]], folder: Path) -> Path:
    """Write stability.html into a folder, from the plain values of each integrator's analysis."""
    macro = len(found[0]["pattern"]) > 1
    name = "omega H" if macro else "omega h"
    pattern = "/".join(f"{f:.4g}" for f in found[0]["pattern"])
    maps = [
        (f"{f['integrator']}: spectral radius over {across} and {m['over']}", png_url(chart))
        for f in found
        for m in f["maps"]
        for across in ["omega H" if macro or m["over"] == "step ratio" else "omega h"]
        if (chart := radius_map(m, across))
    ]
    text = html(
        "stability.html.j2",
        system=found[0]["system"],
        pattern=pattern if macro else "",
        tables=stability_tables(found, name),
        charts=[vl_convert.vegalite_to_svg(chart) for chart in stability_curves(found, name)],
        maps=maps,
        steps=found[0]["first_steps"],
    )
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / FILE
    path.write_text(text, encoding="utf-8")
    return path


def png_url(chart: Spec) -> str:
    """A chart as a data URL; thousands of tiles make a small PNG and a large SVG."""
    image = base64.b64encode(vl_convert.vegalite_to_png(chart, scale=1.5)).decode()
    return f"data:image/png;base64,{image}"
