"""Pictures of a mechanism: at several times, as the frames of an animation, and a little one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from reports.charts.vega_lite import Dataset, Spec, category, quantity, short, view

#: Most times at which a still picture shows a scene.
_GHOSTS = 7
#: Most lines and points per line of a little picture.
_LINES, _POINTS = 40, 60

Line = list[tuple[float, float]]


class _Plane(NamedTuple):
    """The part of the plane that lines need: its middle, its sides, and the extent of the lines.

    A side is at least a third of the other, so that a mass on a line still has a picture.
    """

    x: float
    y: float
    wide: float
    high: float
    extent: float


def _lines(drawing: Mapping[str, Any]) -> list[Line]:
    """The lines of a drawing, without points that no axis can show."""
    known = ([(short(x), short(y)) for x, y in line] for line in drawing["lines"])
    return [[(x, y) for x, y in line if x is not None and y is not None] for line in known]


def _plane(lines: Iterable[Line]) -> _Plane | None:
    points = [point for line in lines for point in line]
    if not points:
        return None
    (x0, x1), (y0, y1) = ((min(c), max(c)) for c in zip(*points, strict=True))
    extent = max(x1 - x0, y1 - y0, 1e-9)
    wide, high = (max(b - a, extent / 3) + 0.1 * extent for a, b in ((x0, x1), (y0, y1)))
    return _Plane((x0 + x1) / 2, (y0 + y1) / 2, wide, high, extent)


def mechanism(drawings: Sequence[Mapping[str, Any]]) -> Spec | None:
    """The mechanism at several times, the last one solid, with the same scale on both axes.

    Of many drawings a few are taken, at equal distances.
    """
    gaps = min(len(drawings), _GHOSTS) - 1
    shown = [_lines(drawings[k * (len(drawings) - 1) // max(gaps, 1)]) for k in range(gaps + 1)]
    plane = _plane(line for lines in shown for line in lines)
    if plane is None:
        return None
    rows, last = [], len(shown) - 1
    for i, lines in enumerate(shown):
        fade = 1.0 if i == last else round(0.12 + 0.28 * (i / max(last, 1)), 2)
        for j, line in enumerate(lines):
            rows += [
                {"line": f"{i}.{j}", "k": k, "x": x, "y": y, "fade": fade}
                for k, (x, y) in enumerate(line)
            ]
    pixels = min(520 / plane.wide, 320 / plane.high)

    def axis(name: str, middle: float, span: float) -> Spec:
        scale = {"domain": [middle - span / 2, middle + span / 2], "nice": False, "zero": False}
        return quantity(name, title=f"{name} in m", scale=scale, axis={"tickCount": 5})

    return view(
        Dataset("drawings", rows),
        mark={"type": "line", "color": "#3b82c4", "strokeWidth": 2.5}
        | dict.fromkeys(("strokeJoin", "strokeCap"), "round"),
        encoding={
            "x": axis("x", plane.x, plane.wide),
            "y": axis("y", plane.y, plane.high),
            "detail": category("line"),
            "order": quantity("k"),
            "opacity": quantity("fade", scale=None, legend=None),
        },
        width=round(plane.wide * pixels),
        height=round(plane.high * pixels),
    )


class Animation(NamedTuple):
    """Frames of an animation, the part of the plane that they need, and the width of a line."""

    view: str
    stroke: str
    frames: list[dict[str, Any]]

    @property
    def still(self) -> str:
        """The last frame as the path of an SVG."""
        lines = self.frames[-1]["lines"]
        return "".join("M" + "L".join(f"{x:g} {y:g}" for x, y in line) for line in lines if line)


def motion(drawings: Sequence[Mapping[str, Any]]) -> Animation | None:
    """The frames of these drawings, y downwards; None if they hold no point."""
    frames = [
        {"t": d["t"], "lines": [[(x, 0.0 - y) for x, y in line] for line in _lines(d)]}
        for d in drawings
    ]
    plane = _plane(line for frame in frames for line in frame["lines"])
    if plane is None:
        return None
    corner = (plane.x - plane.wide / 2, plane.y - plane.high / 2)
    view = " ".join(f"{x:.6g}" for x in (*corner, plane.wide, plane.high))
    return Animation(view, f"{plane.extent / 150:.4g}", frames)


def little_picture(drawings: Sequence[Mapping[str, Any]]) -> list[Line]:
    """The last drawing as lines of whole numbers between 0 and 100, y downwards."""
    lines = [
        line[:: max(1, len(line) // _POINTS)]
        for drawing in drawings[-1:]
        for line in _lines(drawing)[:_LINES]
    ]
    plane = _plane(lines)
    if plane is None:
        return []
    scale = 100 / plane.extent
    return [
        [(round(50 + scale * (x - plane.x)), round(50 - scale * (y - plane.y))) for x, y in line]
        for line in lines
    ]
