"""Colour, dashes and point shape of each line, on a page and on paper."""

from __future__ import annotations

import colorsys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from reports.series import Series

# One hue per family, in degrees; all read on white and on near-black.
_HUES = (212, 24, 150, 285, 345, 180, 45, 100)
_DASHES = ((1, 0), (6, 3), (2, 2), (9, 3, 2, 3), (4, 1), (12, 4))
_SHAPES = ("circle", "square", "triangle-up", "diamond", "cross", "triangle-down")
# Dark enough for print, told apart without colour by shape and dashes.
_PAPER_COLORS = [
    "#000000",
    "#0072b2",
    "#b34700",
    "#00735a",
    "#9c4f7d",
    "#5c5c5c",
    "#2a5078",
    "#8a6d00",
]
_PAPER_SHAPES = (*_SHAPES, "triangle-right", "triangle-left")
_PAPER_DASHES = (*((1, 0), (5, 2), (2, 1.5), (7, 2, 1.5, 2)), *((9, 3), (1, 1), (4, 1, 1, 1, 1, 1)))


@dataclass(frozen=True)
class LineStyle:
    """Colour, dashes and point shape of a line."""

    color: str
    dash: tuple[float, ...]
    shape: str


def line_styles(members: Iterable[tuple[str, str]]) -> dict[str, LineStyle]:
    """A style for each (label, family): a hue per family; shade, dash and shape per member."""
    families: dict[str, list[str]] = {}
    for label, family in dict.fromkeys(members):
        families.setdefault(family, []).append(label)
    styles = {}
    for f, labels in enumerate(families.values()):
        for m, label in enumerate(labels):
            # Shade and a little of the hue vary: members stay apart and families together.
            span = min(1.0, (len(labels) - 1) / 4)
            place = span * (m / (len(labels) - 1) - 0.5) if span else 0.0
            hue = (_HUES[f % len(_HUES)] + 56 * place) % 360
            light = 0.48 + (0.14 if m % 2 else -0.1) * span
            red, green, blue = colorsys.hls_to_rgb(hue / 360, light, 0.68)
            color = f"#{round(red * 255):02x}{round(green * 255):02x}{round(blue * 255):02x}"
            dash, shape = _DASHES[m % len(_DASHES)], _SHAPES[(m + f) % len(_SHAPES)]
            styles[label] = LineStyle(color, dash, shape)
    return styles


def styles_of(series: Iterable[Series], styles: Mapping[str, LineStyle]) -> dict[str, LineStyle]:
    """The styles of these series only, in their order."""
    return {s.label: styles[s.label] for s in series}


def paper_line_styles(labels: Iterable[str]) -> dict[str, LineStyle]:
    """A style per label; shape and dashes alone tell the lines apart."""
    return {
        label: LineStyle(
            _PAPER_COLORS[i % len(_PAPER_COLORS)],
            _PAPER_DASHES[i % len(_PAPER_DASHES)],
            _PAPER_SHAPES[i % len(_PAPER_SHAPES)],
        )
        for i, label in enumerate(labels)
    }
