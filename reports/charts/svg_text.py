"""Text in an SVG that Python writes: it is measured before it is placed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape, quoteattr

from problems.plain_text import clean

FONTS = "Helvetica, Arial, Liberation Sans, DejaVu Sans, sans-serif"
#: Widths of characters in thousandths of the font's size, as DejaVu Sans has them: the broadest of
#: the fonts, so that the text fits whichever a reader has.
_WIDTHS = {
    c: width
    for width, characters in {
        300: "ijlI'J", 340: " .,:;/|!f·", 400: "rt()[]-\"", 530: "csz_*", 600: "kvxyLTYF?",
        640: "abdeghnopqu0123456789$PE", 700: "ABCKRSVXZαβγλ", 790: "DGHNOQU",
        830: "w=+<>~#≤", 870: "M&", 1000: "mW@%…",
    }.items()
    for c in characters
}  # fmt: skip
_OTHER, _BOLD = 1050, 1.13

#: A word of a text: pieces, each bold or not.
StyledWord = list[tuple[str, bool]]


@dataclass(frozen=True)
class Box:
    """A rectangle in px."""

    x: float
    y: float
    width: float
    height: float


def text_width(text: str, size: float, bold: bool = False) -> float:
    """The most px that a line of text takes."""
    return sum(_WIDTHS.get(c, _OTHER) for c in text) * size / 1000 * (_BOLD if bold else 1.0)


def fitted(text: str, size: float, width: float, bold: bool = False) -> str:
    """The text, or its beginning and "…" if it is too wide."""
    if text_width(text, size, bold) <= width:
        return text
    while text and text_width(f"{text}…", size, bold) > width:
        text = text[:-1]
    return f"{text.rstrip()}…"


def wrapped(words: Iterable[StyledWord], size: float, width: float) -> list[list[StyledWord]]:
    """Words in lines that are at most so wide; a longer word loses its end."""
    lines: list[list[StyledWord]] = []
    left = 0.0
    for word in words:
        taken = sum(text_width(text, size, bold) for text, bold in word)
        if taken > width:
            bold = any(piece[1] for piece in word)
            word = [(fitted("".join(text for text, _ in word), size, width, bold), bold)]
            taken = width
        gap = text_width(" ", size)
        if lines and gap + taken <= left:
            lines[-1].append(word)
            left -= gap + taken
        else:
            lines.append([word])
            left = width - taken
    return lines


def tag(name: str, content: str = "", /, **attributes: object) -> str:
    """An element; ``_`` in a name of an attribute stands for a hyphen."""
    given = ""
    for key, value in attributes.items():
        shown = f"{value:.1f}".removesuffix(".0") if isinstance(value, float) else str(value)
        given += f" {key.replace('_', '-')}={quoteattr(clean(shown))}"
    return f"<{name}{given}>{content}</{name}>" if content else f"<{name}{given}/>"


def text_line(content: str, x: float, y: float, size: float, **attributes: str) -> str:
    """A line of text."""
    return tag("text", xml(content), x=x, y=y, font_size=size, **attributes)


def xml(content: str) -> str:
    """Text of a store, fit for a picture."""
    return escape(clean(content))


def polyline(points: Sequence[tuple[float, float]], **attributes: object) -> str:
    """A line through points."""
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return tag("polyline", points=path, fill="none", **attributes)


def svg(width: int, height: int, title: str, about: str, parts: Iterable[str]) -> str:
    """A picture with a white ground, and its text for screen readers."""
    named = tag("title", xml(title)) + tag("desc", xml(about))
    frame = {
        "xmlns": "http://www.w3.org/2000/svg",
        "width": str(width),
        "height": str(height),
        "viewBox": f"0 0 {width} {height}",
        "role": "img",
        "font_family": FONTS,
        "fill": "#1b2430",
    }
    ground = tag("rect", width=width, height=height, fill="#ffffff")
    return tag("svg", "\n".join(["", named, ground, *parts, ""]), **frame) + "\n"
