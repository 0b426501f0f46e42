"""The picture of an outcome map: a pixel per run, ticks and colours of the legend."""

from __future__ import annotations

import base64
import math
import struct
import zlib
from collections.abc import Mapping
from typing import Any

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
ROUND_OFF = -16.0
#: Decades of error over which the colours of inaccurate runs change.
_DECADES_BEYOND = 2.0


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
