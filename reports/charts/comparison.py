"""Charts of a comparison: new over old of every run, sorted."""

from __future__ import annotations

import math
from collections.abc import Sequence

from bench.results.comparison import LEAST_CHANGE, Change, Comparison
from reports.charts import vega_lite as vl

_TITLES = {"error": "errors", "work": "counted work", "time": "times"}
_BETTER, _WORSE = "#1a7f5a", "#c0543c"
#: Ratios beyond this factor are drawn at it.
_FAR = 1e6


def ratio_charts(comparison: Comparison) -> dict[str, vl.Spec]:
    """New over old of every run in both, sorted; a chart per kind of number that changed."""
    made = {kind: _ratios(comparison, kind) for kind in LEAST_CHANGE}
    return {f"ratio-{kind}": chart for kind, chart in made.items() if chart}


def furthest(changes: Sequence[Change], kind: str) -> list[Change]:
    """The change of each run whose ratio is furthest from one; the best run first."""
    by_run: dict[str, Change] = {}
    for change in changes:
        if change.kind == kind and change.ratio is not None:
            known = by_run.get(change.run.key)
            if known is None or abs(_log_ratio(change)) > abs(_log_ratio(known)):
                by_run[change.run.key] = change
    return sorted(by_run.values(), key=_log_ratio)


def _log_ratio(change: Change) -> float:
    """Logarithm of new over old; limited to a factor of ``_FAR``."""
    return math.log(min(max(change.ratio or 1 / _FAR, 1 / _FAR), _FAR))


def _ratios(comparison: Comparison, kind: str) -> vl.Spec | None:
    found = furthest(comparison.changes, kind)
    if not found:
        return None
    count = sum(comparison.judged.values())
    better = sum(_log_ratio(change) < 0 for change in found)
    worse = len(found) - better
    # Runs without a change stand in the middle, at one.
    ranks = [*range(1, better + 1), *range(count - worse + 1, count + 1)]
    points = [
        {
            "rank": rank,
            "ratio": vl.short(math.exp(_log_ratio(change))),
            "worse": int(_log_ratio(change) > 0),
            "comparable": int(change.comparable),
        }
        for rank, change in zip(ranks, found, strict=True)
    ]
    x = vl.quantity(
        "rank",
        title="runs, sorted",
        scale={"domain": [0, count + 1], "nice": False},
        axis={"tickMinStep": 1, "tickCount": 4},
    )
    axis = vl.log_axis([row["ratio"] for row in points] + [1.0], "~g")
    y = vl.log_quantity("ratio", title="new / old", axis=axis)
    same: vl.Spec = {
        "data": {"values": [{"rank": better + 0.5, "end": count - worse + 0.5, "ratio": 1}]},
        "mark": {"type": "rule", "color": vl.GREY, "strokeWidth": 5, "opacity": 0.5},
        "encoding": {"x": x, "x2": {"field": "end"}, "y": y},
    }
    changed: vl.Spec = {
        "data": {"values": points},
        "mark": {"type": "point", "filled": True, "size": 45},
        "encoding": {
            "x": x,
            "y": y,
            "color": {"condition": {"test": "datum.worse", "value": _WORSE}, "value": _BETTER},
            "shape": {
                "condition": {"test": "datum.worse", "value": "triangle-up"},
                "value": "triangle-down",
            },
            "opacity": {"condition": {"test": "datum.comparable", "value": 1}, "value": 0.35},
        },
    }
    title = f"{_TITLES[kind]}, furthest of each run: {worse} worse, {better} better of {count}"
    return {
        "title": {"text": title, "color": vl.GREY, "fontSize": 12, "anchor": "start"},
        "layer": [same, changed],
        "width": 280,
        "height": 200,
        "config": vl.config(),
    }
