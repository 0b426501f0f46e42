"""map.html: where a method works over two numbers, as a picture, counts and words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from bench.results.table import Table
from reports.charts import vega_lite as vl
from reports.formatting import number
from reports.pages.captioned_charts import CaptionedCharts
from reports.pages.chapter import Chapter, Section, write_chapter

#: Colours of ok runs, by decades of the error from the threshold down, and of inaccurate ones up.
_OK = ("#b2e2be", "#7cc3b0", "#4fa3a8", "#2f81a0", "#1c5f90", "#083e78")
_INACCURATE = ("#ffe28c", "#eb7814")
#: Words and colour of each other outcome.
_OTHERS = {
    "newton_failed": ("Newton failed", "#7a3ca0"),
    "step_too_small": ("step too small", "#c85aaa"),
    "budget_exceeded": ("out of steps", "#6e645a"),
    "diverged": ("diverged", "#a0101c"),
    "not_run": ("not run", "#969696"),
    "no_reference": ("no reference", "#bebebe"),
}
#: Most values along a side that are drawn; rows of the table, and stretches in each.
_MOST, _LINES, _STRETCHES = 250, 9, 8


class Stretch(NamedTuple):
    """Neighbouring points of a row with one outcome: places of the first and the last value."""

    words: str
    first: int
    last: int


def write_map_page(found: Mapping[str, Any], folder: Path) -> Path:
    """Write map.html into a folder, from the plain values of `bench.sweeps.outcome_map`."""
    x, y = found["x"], found["y"]
    about = (
        f"{len(x['values'])} × {len(y['values'])} runs to t = {found['t_end']:g} s over "  # noqa: RUF001
        f"{x['name']} and {y['name']}, as one program: prepared in {found['compile_s']:.2g} s, run "
        f"in {found['run_s']:.2g} s. A run is ok up to a relative error {found['error']} of "
        f"{found['threshold']:g}, and inaccurate beyond."
    )
    if "h" in (x["name"], y["name"]):
        about += " A step that does not divide the interval is shortened to one that does."
    if found["error"].endswith(":end"):
        about += " An error at the end alone may be small by chance, where it changes its sign."
    counts = []
    for outcome, count in found["counts"].items():
        words = _OTHERS[outcome][0] if outcome in _OTHERS else outcome
        why = found["reasons"].get(outcome, "")
        counts.append(f"{words}: {count}{f'; {why}' if why else ''}")
    caption = f"Outcome of each run; of more than {_MOST} values along a side some are left out."
    parts = [CaptionedCharts(caption, {"map": map_chart(found)}), outcome_table(found)]
    section = Section("picture", "Outcome of each run", parts, sentences=counts)
    title = f"{found['integrator']} on {found['problem']}"
    return write_chapter(Chapter("map.html", title, about, about, [section]), folder)


def _words(outcome: str, error: float | None, threshold: float) -> str:
    """The outcome of a run with log10 of its error; an error of zero has no logarithm."""
    if outcome in _OTHERS:
        return _OTHERS[outcome][0]
    if outcome == "ok":
        decades = math.inf if error is None else threshold - error
        k = int(min(max(decades, 0.0), len(_OK) - 1))
        return f"ok, error up to {number(10 ** (threshold - k))}"
    near = error is not None and error <= threshold + 1
    return f"inaccurate, error {'up to' if near else 'above'} {number(10 ** (threshold + 1))}"


def _stretches(found: Mapping[str, Any], k: int, every: int = 1) -> Iterator[Stretch]:
    """The stretches of a row, of every so many of its points."""
    threshold, places = math.log10(found["threshold"]), range(0, len(found["x"]["values"]), every)
    outcomes, errors = found["outcome"][k], found["log10_error"][k]
    for words, own in groupby(places, lambda i: _words(outcomes[i], errors[i], threshold)):
        first, *more = own
        yield Stretch(words, first, more[-1] if more else first)


def map_chart(found: Mapping[str, Any]) -> vl.Spec:
    """A tile for each stretch, from the middle before its first point to that behind its last."""
    x, y = (_Side(found[name]) for name in "xy")
    rows = [
        {
            "left": vl.short(x.edge(s.first, -1)),
            "right": vl.short(x.edge(s.last, 1)),
            "low": vl.short(y.edge(k, -1)),
            "high": vl.short(y.edge(k, 1)),
            "state": s.words,
        }
        for k in range(0, len(y.values), y.every)
        for s in _stretches(found, k, x.every)
    ]
    threshold = math.log10(found["threshold"])
    looks = {_words("ok", threshold - k, threshold): color for k, color in enumerate(_OK)}
    far = (threshold + 1, None)
    looks |= {_words("inaccurate", e, threshold): c for e, c in zip(far, _INACCURATE, strict=True)}
    looks |= dict(_OTHERS.values())
    used = {row["state"] for row in rows}
    looks = {words: color for words, color in looks.items() if words in used}
    scale = {"domain": [*looks], "range": [*looks.values()]}
    data = vl.Dataset("map", rows)
    return {
        "datasets": vl.datasets([data]),
        "data": data.source,
        "mark": {"type": "rect"},
        "encoding": {
            "x": vl.quantity("left", title=x.name, scale=x.scale, axis=x.axis),
            "x2": {"field": "right"},
            "y": vl.quantity("low", title=y.name, scale=y.scale, axis=y.axis),
            "y2": {"field": "high"},
            "color": vl.category("state", scale=scale, legend={"title": None, "orient": "right"}),
        },
        "width": 620,
        "height": 420,
        "config": vl.config(),
    }


class _Side:
    """A side of the map: its values, and where the tile of a value ends."""

    def __init__(self, side: Mapping[str, Any]) -> None:
        self.name, self.values, self.log = side["name"], side["values"], side["log"]
        self.every = -(-len(self.values) // _MOST)
        first, last = (math.log10(v) if self.log else v for v in (self.values[0], self.values[-1]))
        self.half = self.every * (last - first) / (len(self.values) - 1) / 2

    def edge(self, k: int, way: int) -> float:
        """The end of the tile of a value below it (-1) or above it (1)."""
        value = self.values[k]
        return value * 10 ** (way * self.half) if self.log else value + way * self.half

    @property
    def scale(self) -> vl.Spec:
        """The scale in Vega-Lite."""
        return {"type": "log" if self.log else "linear", "nice": False, "zero": False}

    @property
    def axis(self) -> vl.Spec:
        """The axis in Vega-Lite."""
        return vl.log_axis(self.values, "~g") if self.log else {}


def outcome_table(found: Mapping[str, Any]) -> Table:
    """The outcomes along the first axis, at some values of the second."""
    x, y = found["x"], found["y"]
    last = len(y["values"]) - 1
    rows = []
    for k in sorted({round(k * last / (_LINES - 1)) for k in range(_LINES)}):
        told = []
        for words, own in groupby(_stretches(found, k), lambda s: s.words.partition(",")[0]):
            first, *more = own
            ends = dict.fromkeys((first.first, (more or [first])[-1].last))
            told.append(f"{words} " + " to ".join(f"{x['values'][i]:.4g}" for i in ends))
        more = ["..."] if len(told) > _STRETCHES else []
        rows.append([f"{y['values'][k]:.4g}", "; ".join(told[:_STRETCHES] + more)])
    return Table("In words", [y["name"], f"along {x['name']}"], rows)
