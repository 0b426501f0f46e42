"""The chart of a summary card as SVG: standings over many scenes, or panels of a few."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from bench.results.quantities import COSTS, NORM
from reports.charts.line_styles import style_of
from reports.charts.svg_text import Box, fitted, polyline, tag, text_line, text_width
from reports.names import scene_name
from reports.questions.answers import Answer, SceneAnswer, Standing
from reports.questions.sentences import Words
from reports.series import Series

#: Most scenes that are shown as panels, and most rows of standings.
MOST_PANELS, _MOST_ROWS = 6, 8
_GREY, _LINE = "#5a6675", "#c9d0d9"
#: Looks of the parts of a bar: fill opacity.
_LOOKS = {"cheapest alone": 1.0, "tied for cheapest": 0.55, "reaches it": 0.22, "tried": 0.0}
#: Mark of the person's own integrator.
_MINE = "► "
#: Errors outside of this range are drawn at its ends.
_LEAST, _MOST = 1e-16, 1e2


def card_chart(
    found: Answer,
    scenes: Mapping[str, Sequence[Series]],
    words: Words,
    box: Box,
    mine: str = "",
) -> list[str]:
    """Panels of error against cost for up to six scenes, standings for more.

    The integrator ``mine`` is always there and marked.
    """
    if len(found.scenes) > MOST_PANELS:
        return standings(found, words, box, mine)
    return panels(found, scenes, words, box, mine)


# ---- standings ---------------------------------------------------------------------------
def standings(found: Answer, words: Words, box: Box, mine: str) -> list[str]:
    """A bar per method: scenes on which it is first, reaches the accuracy, was tried."""
    rows, rest = found.standings[:_MOST_ROWS], found.standings[_MOST_ROWS:]
    if own := [row for row in rest if row.label == mine]:
        rows[-1:] = own
    most = max(row.tried for row in rows)
    height = (box.height - 30) / _MOST_ROWS
    parts = []
    for k, row in enumerate(rows):
        place = Box(box.x, box.y + k * height, box.width, height)
        name = _MINE * (row.label == mine) + words.names[row.label]
        parts += _row(row, name, box.width / most, place, "" if k else " scenes")
    x, y = box.x, box.y + box.height
    for name, opacity in _LOOKS.items():
        parts.append(_bar(x, y - 12, 14, 12, _GREY, opacity))
        parts.append(text_line(name, x + 20, y - 1, 14, fill=_GREY))
        x += 20 + text_width(name, 14) + 12
    if more := len(found.standings) - len(rows):
        parts.append(
            text_line(f"{more} more", box.x + box.width, y - 1, 14, fill=_GREY, text_anchor="end")
        )
    return parts


def _row(row: Standing, name: str, unit: float, place: Box, scenes: str) -> list[str]:
    first = row.alone + row.tied
    said = f"first on {first}{scenes}, reaches {row.reached} of {row.tried}"
    right = place.x + place.width
    room = place.width - text_width(said, 15) - 16
    color, y = style_of(row.label).color, place.y + 24
    counts = (row.tried, row.reached, first, row.alone)
    return [
        text_line(fitted(name, 17, room, bold=True), place.x, place.y + 17, 17, font_weight="bold"),
        text_line(said, right, place.y + 17, 15, fill=_GREY, text_anchor="end"),
        *(
            _bar(place.x, y, count * unit, 14, color, opacity)
            for count, opacity in zip(counts, reversed(_LOOKS.values()), strict=True)
            if count
        ),
    ]


def _bar(x: float, y: float, width: float, height: float, color: str, opacity: float) -> str:
    edge = {"stroke": color, "stroke_opacity": 0.6} if not opacity else {}
    look = {"fill": color, "fill_opacity": str(opacity)}
    return tag("rect", x=x, y=y, width=width, height=height, rx=2, **look, **edge)


# ---- panels ------------------------------------------------------------------------------
def panels(
    found: Answer, scenes: Mapping[str, Sequence[Series]], words: Words, box: Box, mine: str
) -> list[str]:
    """Error against cost of each scene, the cheapest methods named above it."""
    count = len(found.scenes)
    columns = 1 if count <= 2 else 2
    rows = math.ceil(count / columns)
    gap, foot = 28.0, 26.0
    width = (box.width - gap * (columns - 1)) / columns
    height = (box.height - foot) / rows
    parts = []
    for k, (name, own) in enumerate(found.scenes.items()):
        # The last one has its row for itself if no other is left.
        wide = box.width if k == count - 1 and k % columns == 0 else width
        place = Box(
            box.x + k % columns * (width + gap), box.y + k // columns * height, wide, height
        )
        parts += _panel(found, name, own, scenes[name], words, place, mine)
    group, cost = found.question.quantity, COSTS[found.question.cost].title
    y, room = box.y + box.height - 1, box.width
    if mine:
        legend = fitted(f"{_MINE}{words.names[mine]}", 14, room / 2, bold=True)
        look = {"fill": style_of(mine).color, "font_weight": "bold", "text_anchor": "end"}
        parts.append(text_line(legend, box.x + box.width, y, 14, **look))
        room -= text_width(legend, 14, bold=True) + 12
    said = fitted(f"error in {group} against {cost}", 14, room)
    return [*parts, text_line(said, box.x, y, 14, fill=_GREY)]


def _panel(
    found: Answer,
    name: str,
    own: SceneAnswer,
    series: Sequence[Series],
    words: Words,
    place: Box,
    mine: str,
) -> list[str]:
    group, cost, target = found.question.group, found.question.cost, found.question.target
    lines = {
        s.label: [
            (c, _drawn(e))
            for r in s.ok
            if (c := r.cost(cost)) and (e := r.error(group, NORM)) is not None
        ]
        for s in series
    }
    points = [point for line in lines.values() for point in line]
    inner = Box(place.x + 44, place.y + 26, place.width - 56, place.height - 52)
    x_of = _scale([c for c, _ in points], inner.x, inner.width)
    errors = [*(e for _, e in points), target]
    y_of = _scale(errors, inner.y + inner.height, -inner.height)
    bottom, right = inner.y + inner.height, inner.x + inner.width
    asked = y_of(target)
    first = own.winners
    winners = ", ".join(words.names[k] for k in first) if own.reached else "not reached"
    title = fitted(scene_name(name), 15, 0.5 * place.width)
    room = place.width - text_width(title, 15) - 12
    color = style_of(first[0]).color if first else _GREY
    parts = [
        text_line(title, place.x, place.y + 15, 15),
        text_line(
            fitted(winners, 15, room, bold=True), place.x + place.width, place.y + 15, 15,
            fill=color, font_weight="bold", text_anchor="end",
        ),
        polyline([(inner.x, inner.y), (inner.x, bottom), (right, bottom)], stroke=_LINE),
        polyline(
            [(inner.x, asked), (right, asked)], stroke="#1b2430", stroke_dasharray="5 4"
        ),
        text_line(found.question.accuracy, inner.x - 5, asked + 4, 12, text_anchor="end"),
    ]  # fmt: skip
    for at in _ends(errors):
        if inner.y <= y_of(at) <= bottom and abs(y_of(at) - asked) > 13:
            look = {"fill": _GREY, "text_anchor": "end"}
            parts.append(text_line(_power(at), inner.x - 5, y_of(at) + 4, 12, **look))
    for at in _ends([c for c, _ in points]):
        look = {"fill": _GREY, "text_anchor": "middle"}
        parts.append(text_line(_power(at), x_of(at), bottom + 15, 12, **look))
    broad = {*first, mine}
    for label in sorted(lines, key=lambda k: k in broad):  # above the others
        best, style = label in broad, style_of(label)
        drawn = [(x_of(c), y_of(e)) for c, e in lines[label]]
        look = {"stroke_width": 3 if best else 1.5, "stroke_opacity": "1" if best else "0.55"}
        if style.dash[1]:
            look["stroke_dasharray"] = " ".join(map(str, style.dash))
        parts.append(polyline(drawn, stroke=style.color, **look))
    for label in first:
        entry = own.entries[label]
        if entry.run and entry.value and (error := entry.run.error(group, NORM)) is not None:
            at = (x_of(entry.value), y_of(_drawn(error)))
            parts.append(tag("circle", cx=at[0], cy=at[1], r=5, fill=style_of(label).color))
    return parts


def _drawn(error: float) -> float:
    return min(max(error, _LEAST), _MOST)


def _power(value: float) -> str:
    """A number with one digit: 1e-4, 1, 3e6."""
    digit, _, power = f"{value:.0e}".partition("e")
    return f"{digit}e{int(power)}" if int(power) else digit


def _ends(values: Sequence[float]) -> list[float]:
    """The first and the last power of ten within the values, or the least of them."""
    if not values:
        return []
    low, high = math.ceil(math.log10(min(values))), math.floor(math.log10(max(values)))
    return sorted({10.0**low, 10.0**high}) if low <= high else [min(values)]


def _scale(values: Sequence[float], start: float, length: float) -> Callable[[float], float]:
    """Places of positive numbers on a logarithmic axis that holds them all."""
    low, high = (math.log10(f(values)) if values else 0.0 for f in (min, max))
    extent = max(high - low, 0.1)
    return lambda value: start + length * (0.03 + 0.94 * (math.log10(value) - low) / extent)
