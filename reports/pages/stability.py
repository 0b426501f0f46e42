"""stability.html: the stability analysis of integrators as charts, maps and tables."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from problems.whole_files import put
from reports.charts.rendering import Picture, pictures
from reports.charts.stability import radius_map, stability_curves
from reports.pages.templating import html
from reports.text.stability_tables import stability_tables

FILE = "stability.html"


def write_stability_page(found: Sequence[dict[str, Any]], folder: Path) -> Path:
    """Write stability.html into a folder, from the plain values of each integrator's analysis."""
    macro = len(found[0]["pattern"]) > 1
    name = "omega H" if macro else "omega h"
    pattern = "/".join(f"{f:.4g}" for f in found[0]["pattern"])
    maps = {
        f"{f['integrator']}: spectral radius over {across} and {m['over']}": chart
        for f in found
        for m in f["maps"]
        for across in ["omega H" if macro or m["over"] == "step ratio" else "omega h"]
        if (chart := radius_map(m, across))
    }
    curves = {str(k): chart for k, chart in enumerate(stability_curves(found, name))}
    text = html(
        "stability.html.j2",
        system=found[0]["system"],
        pattern=pattern if macro else "",
        tables=stability_tables(found, name),
        charts=[drawn.svg for drawn in pictures(curves).values()],
        # Thousands of tiles make a small PNG and a large SVG.
        maps=[(n, png_url(drawn)) for n, drawn in pictures(maps, "png", scale=1.5).items()],
        steps=found[0]["first_steps"],
    )
    folder.mkdir(parents=True, exist_ok=True)
    put(folder / FILE, text)
    return folder / FILE


def png_url(drawn: Picture) -> str:
    """A picture as a data URL; empty if there is none."""
    return f"data:image/png;base64,{base64.b64encode(drawn.content).decode()}" * bool(drawn.content)
