"""map.html: an interactive picture of where a method works over two numbers."""

from __future__ import annotations

import base64
import math
import struct
import zlib
from collections.abc import Mapping
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

from bench.results.table import Table
from reports.formatting import number
from reports.pages.page import Link, Page, write_page

#: Words of each outcome; a page numbers the outcomes in this order.
OUTCOME_NAMES = {
    "ok": "ok",
    "inaccurate": "inaccurate",
    "newton_failed": "Newton failed",
    "step_too_small": "step too small",
    "budget_exceeded": "out of steps",
    "diverged": "diverged",
    "not_run": "not run",
    "no_reference": "no reference",
}
#: Rows of the table, and stretches of one outcome in each.
_LINES, _STRETCHES = 9, 8
Color = tuple[int, int, int]
#: Colours from the most accurate run to the threshold, and from there to a hundred times it.
_OK: tuple[Color, Color] = (8, 62, 120), (178, 226, 190)
_INACCURATE: tuple[Color, Color] = (255, 226, 140), (235, 120, 20)
_PLAIN: dict[str, Color] = {
    "newton_failed": (122, 60, 160),
    "step_too_small": (200, 90, 170),
    "budget_exceeded": (110, 100, 90),
    "diverged": (160, 16, 28),
    "not_run": (150, 150, 150),
    "no_reference": (190, 190, 190),
}
#: Logarithm of the smallest error that has a colour of its own.
_ROUND_OFF = -16.0
#: Decades of error over which the colours of inaccurate runs change.
_DECADES_BEYOND = 2.0


def write_map_page(found: Mapping[str, Any], folder: Path) -> Path:
    """Write map.html into a folder, from the plain values of a `bench.sweeps.outcome_map.Map`."""
    known = [e for row in found["log10_error"] for e in row if e is not None]
    threshold = math.log10(found["threshold"])
    best = max(min([*known, threshold - 1]), _ROUND_OFF)
    names = list(OUTCOME_NAMES)
    legend = [
        (OUTCOME_NAMES[name], count, legend_color(name), found["reasons"].get(name, ""))
        for name, count in found["counts"].items()
    ]
    values = {
        "found": found,
        "image": map_image(found, best, threshold),
        "ticks": [axis_ticks(found[side]) for side in ("x", "y")],
        "legend": legend,
        "best": number(10**best),
        "words": outcome_table(found),
        "data": {
            "words": [OUTCOME_NAMES[name] for name in names],
            "x": [found["x"]["name"], found["x"]["values"]],
            "y": [found["y"]["name"], found["y"]["values"]],
            "outcome": ["".join(str(names.index(o)) for o in row) for row in found["outcome"]],
            "error": [
                [None if e is None else round(e, 2) for e in r] for r in found["log10_error"]
            ],
        },
    }
    page = Page("map.html", "map", f"{found['integrator']} on {found['problem']}", values=values)
    links = [Link("#picture", "Map"), Link("#words", "In words")]
    return write_page(page, folder, links, ("tables.js", "map.js"))


# ---- the picture -------------------------------------------------------------------------
def map_image(found: Mapping[str, Any], best: float, threshold: float) -> str:
    """A pixel per point as a data URL; the first row of the map is at the bottom."""
    lines = [
        b"\0" + b"".join(bytes(_color(o, e, best, threshold)) for o, e in zip(*row, strict=True))
        for row in zip(found["outcome"], found["log10_error"], strict=True)
    ]
    size = struct.pack(">IIBBBBB", len(found["x"]["values"]), len(lines), 8, 2, 0, 0, 0)
    pixels = zlib.compress(b"".join(reversed(lines)), 9)
    chunks = b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in ((b"IHDR", size), (b"IDAT", pixels), (b"IEND", b""))
    )
    return "data:image/png;base64," + base64.b64encode(b"\x89PNG\r\n\x1a\n" + chunks).decode()


def _color(outcome: str, error: float | None, best: float, threshold: float) -> Color:
    if outcome in _PLAIN:
        return _PLAIN[outcome]
    if outcome == "ok":
        # An error of zero has no logarithm.
        return blend(_OK, 0.0 if error is None else (error - best) / (threshold - best))
    return blend(_INACCURATE, 1.0 if error is None else (error - threshold) / _DECADES_BEYOND)


def blend(ends: tuple[Color, Color], part: float) -> Color:
    part = min(1.0, max(0.0, part))
    r, g, b = (round(a + part * (z - a)) for a, z in zip(*ends, strict=True))
    return r, g, b


def legend_color(outcome: str) -> str:
    ramp = {"ok": _OK, "inaccurate": _INACCURATE}.get(outcome)
    if ramp:
        return f"linear-gradient(to right, rgb{ramp[0]}, rgb{ramp[1]})"
    return f"rgb{_PLAIN[outcome]}"


def axis_ticks(side: Mapping[str, Any]) -> list[tuple[float, str]]:
    """Round values along an axis: pairs (place from 0 to 1, text)."""
    values, count = side["values"], len(side["values"])
    place = math.log10 if side["log"] else float
    low, high = place(values[0]), place(values[-1])
    if side["log"]:
        digits = (1, 2, 5) if high - low < 2.5 else (1,)
        powers = range(math.floor(low), math.ceil(high) + 1)
        every = -(-len(powers) // 10)
        candidates = [d * 10.0**p for p in powers[::every] for d in digits]
    else:
        step = 10.0 ** math.floor(math.log10(high - low))
        step = next(s * step for s in (0.1, 0.2, 0.5, 1) if (high - low) / (s * step) <= 10)
        first = math.ceil(low / step - 1e-9)
        candidates = [k * step for k in range(first, first + 12)]
    room = 1e-9 * (high - low)
    inside = [v for v in candidates if low - room <= place(v) <= high + room]
    # A point is a pixel wide: the first and the last value are in the middle of theirs.
    return [
        ((0.5 + (count - 1) * (place(v) - low) / (high - low)) / count, f"{round(v, 12):g}")
        for v in inside
    ]


# ---- in words ----------------------------------------------------------------------------
def outcome_table(found: Mapping[str, Any]) -> Table:
    """The outcomes along the first axis, at some values of the second."""
    x, y = found["x"], found["y"]
    last = len(y["values"]) - 1
    lines = sorted({round(k * last / (_LINES - 1)) for k in range(_LINES)})
    rows = []
    for k in lines:
        stretches = []
        pairs = zip(found["outcome"][k], x["values"], strict=True)
        for outcome, stretch in groupby(pairs, key=itemgetter(0)):
            values = [value for _, value in stretch]
            ends = f"{values[0]:.4g}" + (f" to {values[-1]:.4g}" if len(values) > 1 else "")
            stretches.append(f"{OUTCOME_NAMES[outcome]} {ends}")
        more = ["..."] if len(stretches) > _STRETCHES else []
        rows.append([f"{y['values'][k]:.4g}", "; ".join(stretches[:_STRETCHES] + more)])
    return Table("In words", [y["name"], f"along {x['name']}"], rows)
