"""Pictures of a mechanism at several times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from reports.charts.vega_lite import Dataset, Spec, category, config, datasets, quantity, short

#: Most times at which a still picture shows a scene.
_GHOSTS = 7


def mechanism(drawings: Sequence[Mapping[str, Any]]) -> Spec | None:
    """The mechanism at several times, the last one solid, with the same scale on both axes.

    Of many drawings a few are taken, at equal distances.
    """
    gaps = min(len(drawings), _GHOSTS) - 1
    drawings = [drawings[k * (len(drawings) - 1) // max(gaps, 1)] for k in range(gaps + 1)]
    rows, last = [], len(drawings) - 1
    for i, picture in enumerate(drawings):
        fade = 1.0 if i == last else 0.12 + 0.28 * (i / max(last, 1))
        for j, line in enumerate(picture["lines"]):
            rows += [
                {"line": f"{i}.{j}", "k": k, "x": short(x), "y": short(y), "fade": round(fade, 2)}
                for k, (x, y) in enumerate(line)
                if short(x) is not None and short(y) is not None
            ]
    if not rows:
        return None
    (x0, x1), (y0, y1) = ((min(r[c] for r in rows), max(r[c] for r in rows)) for c in "xy")
    extent = max(x1 - x0, y1 - y0, 1e-9)
    # At least a third of the other side, so that a mass on a line still has a picture.
    wide, high = (max(b - a, extent / 3) + 0.1 * extent for a, b in ((x0, x1), (y0, y1)))
    pixels = min(520 / wide, 320 / high)

    def axis(name: str, low: float, high: float, span: float) -> Spec:
        middle = (low + high) / 2
        scale = {"domain": [middle - span / 2, middle + span / 2], "nice": False, "zero": False}
        return quantity(name, title=f"{name} in m", scale=scale, axis={"tickCount": 5})

    data = Dataset("drawings", rows)
    return {
        "datasets": datasets([data]),
        "data": data.source,
        "mark": {
            "type": "line",
            "color": "#3b82c4",
            "strokeWidth": 2.5,
            "strokeJoin": "round",
            "strokeCap": "round",
        },
        "encoding": {
            "x": axis("x", x0, x1, wide),
            "y": axis("y", y0, y1, high),
            "detail": category("line"),
            "order": quantity("k"),
            "opacity": quantity("fade", scale=None, legend=None),
        },
        "width": round(wide * pixels),
        "height": round(high * pixels),
        "config": config(),
    }
