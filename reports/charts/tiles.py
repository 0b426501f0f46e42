"""Maps over two numbers: tiles of one state, as few as neighbours of the same state allow."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

from reports.charts import vega_lite as vl

#: Most values along a side that are drawn.
MOST = 250


@dataclass(frozen=True)
class Side:
    """A side of a map: its title, its values at equal distances, and whether in their logarithm."""

    name: str
    values: Sequence[float]
    log: bool

    @property
    def every(self) -> int:
        """One of so many values is drawn."""
        return -(-len(self.values) // MOST)

    @property
    def places(self) -> range:
        """The places of the values that are drawn."""
        return range(0, len(self.values), self.every)

    def edge(self, k: int, way: int) -> float | None:
        """The end of the tile of a value below it (-1) or above it (1)."""
        first, last = (math.log10(v) if self.log else v for v in (self.values[0], self.values[-1]))
        half = way * self.every * (last - first) / (len(self.values) - 1) / 2
        return vl.short(self.values[k] * 10**half if self.log else self.values[k] + half)

    def channel(self, field: str) -> vl.Spec:
        """The channel of Vega-Lite."""
        scale = {"type": "log" if self.log else "linear", "nice": False, "zero": False}
        axis = vl.log_axis(self.values, "~g") if self.log else {}
        return vl.quantity(field, title=self.name, scale=scale, axis=axis)


def tile_chart(
    x: Side, y: Side, state: Callable[[int, int], str], looks: Mapping[str, str], title: str = ""
) -> vl.Spec:
    """A tile for each stretch, from the middle before its first point to that behind its last.

    ``state(k, i)`` is that of the k-th value of y and the i-th of x, ``looks`` the colours of
    states in the order of the legend, which ``title`` heads.
    """
    rows = []
    for k in y.places:
        for words, own in groupby(x.places, lambda i, k=k: state(k, i)):
            first, *more = own
            ends = {"left": x.edge(first, -1), "right": x.edge((more or [first])[-1], 1)}
            rows.append(ends | {"low": y.edge(k, -1), "high": y.edge(k, 1), "state": words})
    shown = {row["state"] for row in rows}
    used = {words: color for words, color in looks.items() if words in shown}
    scale = {"domain": [*used], "range": [*used.values()]}
    legend = {"title": title or None, "orient": "right", "columns": 1}
    data = vl.Dataset("map", rows)
    return {
        "datasets": vl.datasets([data]),
        "data": data.source,
        "mark": {"type": "rect", "clip": True},
        "encoding": {
            "x": x.channel("left"),
            "x2": {"field": "right"},
            "y": y.channel("low"),
            "y2": {"field": "high"},
            "color": vl.category("state", scale=scale, legend=legend),
        },
        "width": 620,
        "height": 420,
        "config": vl.config(),
    }
