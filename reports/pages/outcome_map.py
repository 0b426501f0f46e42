"""map.html: where a method works over two numbers, as a picture, counts and words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from reports.charts import vega_lite as vl
from reports.charts.maps import MOST, Side, tile_chart
from reports.formatting import number
from reports.pages.chapter import Chapter, Figure, Section, write_chapter

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
    caption = f"Outcome of each run; of more than {MOST} values along a side some are left out."
    picture = Figure(caption, {"map": map_chart(found)})
    section = Section("Outcome of each run", [counts, picture], "picture")
    title = f"{found['integrator']} on {found['problem']}"
    return write_chapter(Chapter("map.html", title, about, [section]), folder)


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


def _state(found: Mapping[str, Any], k: int, i: int) -> str:
    threshold = math.log10(found["threshold"])
    return _words(found["outcome"][k][i], found["log10_error"][k][i], threshold)


def map_chart(found: Mapping[str, Any]) -> vl.Spec:
    """A tile for each stretch of runs with one outcome."""
    x, y = (Side(**found[name]) for name in "xy")
    threshold = math.log10(found["threshold"])
    looks = {_words("ok", threshold - k, threshold): color for k, color in enumerate(_OK)}
    far = (threshold + 1, None)
    looks |= {_words("inaccurate", e, threshold): c for e, c in zip(far, _INACCURATE, strict=True)}
    return tile_chart(x, y, lambda k, i: _state(found, k, i), looks | dict(_OTHERS.values()))
