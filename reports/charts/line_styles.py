"""Colour, dashes and mark of each integrator: by its printed name alone, the same everywhere.

Colours have a contrast of 3:1 or more against the pages' papers: the first one against the light
and the dark ones, the other one is brighter, for dark pages that can choose.
"""

from __future__ import annotations

import colorsys
import hashlib
import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cache

from reports.names import BUILT_IN, BuiltIn, label_parts, short_names

#: What an option adds: to the number of the dash, and of the mark. Others add by their digest.
_STEPS = {
    ("rho_inf", "0.8"): (0, 0),
    ("rho_inf", "0.0"): (3, 4),
    ("rho_inf", "0.5"): (2, 3),
    ("rho_inf", "0.6"): (4, 12),
    ("rho_inf", "0.9"): (4, 2),
    ("rho_inf", "1.0"): (1, 6),
    ("alpha", "0.1"): (0, 0),
    ("beta", "0.25"): (0, 0),
    ("gamma", "0.5"): (0, 0),
    ("delta_f", "0.375"): (2, 4),
    ("delta_m", "0.125"): (3, 3),
    ("formulation", "index1"): (4, 9),
    ("formulation", "index3"): (2, 8),
    ("formulation", "stabilised_index2"): (0, 7),
    ("gamma", "guarded"): (4, 12),
    ("gamma", "updated"): (4, 8),
    ("linear_solver", "dense"): (3, 8),
    ("max_calls", "10000"): (4, 8),
    ("multipliers_in_error_test", "True"): (5, 7),
    ("newton", "modified"): (0, 14),
    ("pattern", "0.3/0.7"): (7, 5),
    ("stages", "2"): (6, 0),
    ("start", "corrected"): (3, 15),
}
DASHES = ((1, 0), (6, 3), (2, 2), (9, 3, 2, 3), (4, 1), (12, 4), (1, 4), (7, 2, 2, 2, 2, 2))
#: Relative luminances of a colour's shades, for both papers and for dark ones.
_SHADES = (0.17, 0.21, 0.25)
_BRIGHTER = 2.0


def _path(points: Iterable[tuple[float, float]]) -> str:
    return "M" + "L".join(f"{x:.3g},{y:.3g}" for x, y in points) + "Z"


def _star(points: int, inner: float, turn: float = 0.0) -> str:
    """A star; one with ``inner`` = cos(pi/points) is a polygon."""
    corners = (
        (1.0 if k % 2 == 0 else inner, math.pi * (k / points + turn)) for k in range(2 * points)
    )
    return _path((r * math.sin(a), -r * math.cos(a)) for r, a in corners)


_SLIM = ((-0.35, -1), (0.35, -1), (0.35, 1), (-0.35, 1))
_GLASS = ((-1, -1), (1, -1), (-1, 1), (1, 1))
#: After the plain ones: a slim one, stars, a slanted cross, an hour glass; both lying; stars.
MARKS = (
    *("circle", "square", "triangle-up", "diamond"),
    *("cross", "triangle-down", "triangle-right", "triangle-left"),
    *(_path(_SLIM), _star(4, 0.3), _star(4, 0.3, 0.25), _path(_GLASS)),
    *(_path((y, x) for x, y in _GLASS), _path((-y, x) for x, y in _SLIM)),
    *(_star(5, 0.4), _star(3, 0.2)),
)


@dataclass(frozen=True)
class LineStyle:
    """Colour, that for dark pages, dashes, and mark: a name or an SVG path within -1 to 1.

    ``name`` is the short name, which depends on the integrators beside it.
    """

    color: str
    dark: str
    dash: tuple[float, ...]
    shape: str
    name: str = field(default="", compare=False, repr=False)


@cache
def style_of(label: str) -> LineStyle:
    """The style of an integrator by its printed name."""
    digest = _digest(label)
    name, given, pattern = label_parts(label)
    options = [*given.items(), *([("pattern", pattern)] if pattern else [])]
    own = _digest(name)
    other = BuiltIn(name, own % 360, own // 360, 0 if options else digest)
    _, hue, mark, dash = BUILT_IN.get(name, other)
    for option in options:
        more = _STEPS.get(option, (_digest(str(option)) % 7 + 1, _digest(str(option)) // 7))
        dash, mark = dash + more[0], mark + more[1]
    if options:  # variants of a method stay near each other
        hue += digest % 17 - 8
    shade = _SHADES[digest // 17 % len(_SHADES)]
    return LineStyle(
        color=_color(hue, shade),
        dark=_color(hue, _BRIGHTER * shade),
        dash=DASHES[dash % len(DASHES)],
        shape=MARKS[mark % len(MARKS)],
    )


def line_styles(labels: Iterable[str]) -> dict[str, LineStyle]:
    """The styles of these integrators, in their order."""
    return {label: replace(style_of(label), name=n) for label, n in short_names(labels).items()}


def _digest(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4])


# ---- colours -----------------------------------------------------------------------------
def luminance(color: str) -> float:
    """Relative luminance of a colour #rrggbb, from 0 to 1 (WCAG 2)."""
    parts = [int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return sum(w * c for w, c in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


def _color(hue: float, light: float) -> str:
    """The colour of a hue with a relative luminance: lightness is found by halving."""
    low, high, color = 0.0, 1.0, ""
    for _ in range(12):
        middle = (low + high) / 2
        rgb = colorsys.hls_to_rgb(hue % 360 / 360, middle, 0.72)
        color = "#" + "".join(f"{round(c * 255):02x}" for c in rgb)
        low, high = (middle, high) if luminance(color) < light else (low, middle)
    return color
