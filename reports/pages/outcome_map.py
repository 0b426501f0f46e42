"""map.html: an interactive picture of where a method works over two numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from problems.whole_files import put
from reports.charts.outcome_map import ROUND_OFF, axis_ticks, legend_color, map_image
from reports.formatting import number
from reports.pages.templating import html
from reports.text.outcome_map_table import OUTCOME_NAMES, outcome_table

FILE = "map.html"


def write_map_page(found: Mapping[str, Any], folder: Path) -> Path:
    """Write map.html into a folder, from the plain values of a `bench.sweeps.outcome_map.Map`."""
    known = [e for row in found["log10_error"] for e in row if e is not None]
    threshold = math.log10(found["threshold"])
    best = max(min([*known, threshold - 1]), ROUND_OFF)
    names = list(OUTCOME_NAMES)
    legend = [
        (OUTCOME_NAMES[name], count, legend_color(name), found["reasons"].get(name, ""))
        for name, count in found["counts"].items()
    ]
    text = html(
        "map.html.j2",
        found=found,
        image=map_image(found, best, threshold),
        ticks=[axis_ticks(found[side]) for side in ("x", "y")],
        legend=legend,
        best=number(10**best),
        words=outcome_table(found),
        data={
            "words": [OUTCOME_NAMES[name] for name in names],
            "x": [found["x"]["name"], found["x"]["values"]],
            "y": [found["y"]["name"], found["y"]["values"]],
            "outcome": ["".join(str(names.index(o)) for o in row) for row in found["outcome"]],
            "error": [
                [None if e is None else round(e, 2) for e in r] for r in found["log10_error"]
            ],
        },
    )
    folder.mkdir(parents=True, exist_ok=True)
    put(folder / FILE, text)
    return folder / FILE
