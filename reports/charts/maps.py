"""Maps: spectral radii over two numbers, and an integrator's state on scenes at accuracies."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import groupby, pairwise
from typing import Any, NamedTuple

from reports.charts import vega_lite as vl
from reports.formatting import number
from reports.names import scene_name
from reports.ranking import Answer
from reports.wrong import Wrong

#: Looks of an integrator's states on a scene: title and colour.
_LOOKS = {
    "alone": ("cheapest alone", "#1a7f5a"),
    "tied": ("tied for the cheapest", "#7fc4a3"),
    "dearer": ("dearer, by this factor", "#d9c26a"),
    "single": ("reached, with none to compare", "#8fb3d9"),
    "unknown": ("reached, cost not measured", "#8fb3d9"),
    "far": ("not reached", "#80808030"),
    "failed": ("no run reaches the end", "#c0543c"),
    "wrong": ("runs silently wrong", "#8e2a6b"),
    "warned": ("runs wrong with a warning", "#ad7c9e"),
}
#: Colours of maps up to these radii, and above: green ones are stable, red ones grow.
_BORDERS = (0.25, 0.5, 0.75, 0.9, 0.99, 1 + 1e-9, 1.001, 1.1, 2.0)
_COLORS = ("#0b3d2e", "#14603f", "#2b8a57", "#62b37d", "#a5d6ae", "#dcefe0", "#fde0d2",
           "#f9a582", "#e5553f", "#8f1020")  # fmt: skip
_STATES = [
    f"to {_BORDERS[0]:g}",
    *(f"{low:.4g} to {high:.4g}" for low, high in pairwise(_BORDERS)),
    f"above {_BORDERS[-1]:g}",
]


class _Side(NamedTuple):
    """A side of a map: its title, its values at equal distances, and whether in their logarithm."""

    name: str
    values: Sequence[float]
    log: bool

    def edge(self, k: int, way: int) -> float | None:
        """The end of the tile of a value below it (-1) or above it (1)."""
        first, last = (math.log10(v) if self.log else v for v in (self.values[0], self.values[-1]))
        half = way * (last - first) / (len(self.values) - 1) / 2
        return vl.short(self.values[k] * 10**half if self.log else self.values[k] + half)

    def channel(self, field: str) -> vl.Spec:
        """The channel of Vega-Lite."""
        scale = {"type": "log" if self.log else "linear", "nice": False, "zero": False}
        axis = vl.log_axis(self.values, "~g") if self.log else {}
        return vl.quantity(field, title=self.name, scale=scale, axis=axis)


def radius_map(m: dict[str, Any], name: str) -> vl.Spec | None:
    """Spectral radii over omega h and another number; None of a single row.

    A tile for each stretch of one colour, as few as neighbours allow: from the middle before its
    first point to that behind its last.
    """
    values = [row["value"] for row in m["rows"]]
    if len(values) < 2:
        return None

    def state(radius: float | None) -> str:
        return _STATES[sum(radius > border for border in _BORDERS) if radius is not None else -1]

    # Ratios are spaced evenly in their logarithm, options in themselves.
    x, y = _Side(name, m["omega_h"], log=True), _Side(m["over"], values, m["over"] == "step ratio")
    rows = []
    for k, row in enumerate(m["rows"]):
        states = [*map(state, row["radii"])]
        for words, own in groupby(range(len(states)), states.__getitem__):
            first, *more = own
            ends = {"left": x.edge(first, -1), "right": x.edge((more or [first])[-1], 1)}
            rows.append(ends | {"low": y.edge(k, -1), "high": y.edge(k, 1), "state": words})
    looks = dict(zip(_STATES, _COLORS, strict=True))
    return vl.view(
        vl.Dataset("map", rows),
        mark={"type": "rect", "clip": True},
        encoding={
            "x": x.channel("left"),
            "x2": {"field": "right"},
            "y": y.channel("low"),
            "y2": {"field": "high"},
            "color": _colors(rows, looks, title="spectral radius", orient="right", columns=1),
        },
        width=410,
        height=250,
    )


def method_strip(label: str, found: Sequence[Answer], wrong: Sequence[Wrong]) -> vl.Spec | None:
    """Wins, ties, losses and failures of an integrator: a row per scene, a column per accuracy.

    The last columns count the runs that are ``wrong``, which has all scenes, without and with a
    warning.
    """
    rows = []
    for answer in found:
        for scene, own in answer.scenes.items():
            if entry := own.entries.get(label):
                state = own.place(label)
                ratio = number(float(f"{entry.ratio:.2g}")) if state == "dearer" else ""
                row = {"scene": scene_name(scene), "target": answer.question.accuracy}
                rows.append(row | {"state": _LOOKS[state][0], "text": ratio})
    if not rows:
        return None
    for w in wrong:
        for kind, count in ("wrong", w.silent), ("warned", w.warned):
            cell = {"scene": scene_name(w.scene), "target": kind, "state": _LOOKS[kind][0]}
            rows += [cell | {"text": f"{count} of {w.judged}"}] * (count > 0)
    order = [*(answer.question.accuracy for answer in found), "wrong", "warned"]
    place = {
        "x": vl.category("target", title=None, sort=order, axis={"labelAngle": 0, "orient": "top"}),
        "y": vl.category("scene", title=None, sort=[scene_name(w.scene) for w in wrong]),
    }
    ink = {"condition": {"test": "datum.target === 'wrong'", "value": "#fff"}, "value": "#1b2430"}
    cells = {
        "mark": {"type": "rect", "stroke": "#80808060"},
        "encoding": place | {"color": _colors(rows, dict(_LOOKS.values()))},
    }
    texts = {
        "mark": {"type": "text", "fontSize": 11},
        "encoding": place | {"text": vl.category("text"), "color": ink},
        "transform": [{"filter": "datum.text"}],
    }
    steps = {"width": {"step": 50}, "height": {"step": 22}}
    return vl.view(vl.Dataset("strip", rows), layer=[cells, texts], **steps)


def _colors(rows: Sequence[vl.Spec], looks: Mapping[str, str], **legend: object) -> vl.Spec:
    """The colours of the states that are there."""
    shown = {row["state"] for row in rows}
    return vl.colors("state", {k: color for k, color in looks.items() if k in shown}, **legend)
