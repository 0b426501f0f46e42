"""Drawings of a scene as the frames of an animation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from reports.charts.vega_lite import short


@dataclass
class Motion:
    """Frames, the part of the plane that they need, and the width of a line."""

    view: str
    stroke: str
    frames: list[dict[str, Any]]

    @property
    def still(self) -> str:
        """The last frame as the path of an SVG."""
        lines = self.frames[-1]["lines"]
        return "".join("M" + "L".join(f"{x:g} {y:g}" for x, y in line) for line in lines if line)


def motion(drawings: Sequence[Mapping[str, Any]]) -> Motion | None:
    """The frames of these drawings, y downwards; None if they hold no point."""
    frames = [{"t": d["t"], "lines": [*map(_points, d["lines"])]} for d in drawings]
    points = [p for frame in frames for line in frame["lines"] for p in line]
    if not points:
        return None
    (x0, x1), (y0, y1) = ((min(c), max(c)) for c in zip(*points, strict=True))
    extent = max(x1 - x0, y1 - y0) or 1.0
    wide, high = (max(b - a, extent / 3) + 0.1 * extent for a, b in ((x0, x1), (y0, y1)))
    corner = ((x0 + x1 - wide) / 2, (y0 + y1 - high) / 2)
    return Motion(
        " ".join(f"{x:.6g}" for x in (*corner, wide, high)), f"{extent / 150:.4g}", frames
    )


def _points(line: Sequence[Sequence[float | None]]) -> list[list[float]]:
    known = ((short(x), short(y)) for x, y in line)
    return [[x, 0.0 - y] for x, y in known if x is not None and y is not None]
