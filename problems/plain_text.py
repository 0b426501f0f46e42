"""Text of users, plugins and libraries made fit for a message: short and clean."""

from __future__ import annotations

import re

#: Most characters of a line of a message, and of a word in it.
LONGEST_LINE, LONGEST_WORD = 600, 200
#: Most lines of a message.
MOST_LINES = 20

#: Control characters but tab and line feed, marks that turn the direction of writing, lone
#: surrogates, as of a path that is not UTF-8, and code points that are no characters. XML allows
#: most of them nowhere, terminals take some as orders, and pages show others as what is not there.
_HIDDEN = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff"
    "\ufffe\uffff]"
)
#: An escape in JSON; the first alternative passes over escaped backslashes.
_ESCAPE = re.compile(rb"\\(?:[^u]|u([0-9a-fA-F]{4}))")
_LONG_WORD = re.compile(rf"\S{{{LONGEST_WORD + 1},}}")


def clean(text: str) -> str:
    """Write U+FFFD in the place of each such character, for messages, pages, pictures and files."""
    return _HIDDEN.sub("\N{REPLACEMENT CHARACTER}", text)


def clean_json(text: bytes) -> bytes:
    """Return JSON whose texts are clean; pairs of surrogates stay.

    Raises
    ------
    UnicodeDecodeError
        If it is not UTF-8.
    """
    if b"\\u" in text:
        text = _ESCAPE.sub(_clean_escape, text)
    return clean(text.decode()).encode() if not text.isascii() or b"\x7f" in text else text


def _clean_escape(found: re.Match[bytes]) -> bytes:
    # Halves of pairs are left: who reads JSON joins two, and refuses one.
    code = int(found[1], 16) if found[1] else 0x20
    hidden = not 0xD800 <= code <= 0xDFFF and clean(chr(code)) != chr(code)
    return b"\\ufffd" if hidden else found[0]


def shortened(text: str) -> str:
    """Make a message short and clean: long words, long lines and many lines lose their middle."""
    lines = clean(text).split("\n")
    if len(lines) > MOST_LINES:
        lines = [*lines[: MOST_LINES - 2], "…", lines[-1]]
    return "\n".join(
        _cut(_LONG_WORD.sub(lambda word: _cut(word[0], LONGEST_WORD), line), LONGEST_LINE)
        for line in lines
    )


def said(error: BaseException) -> str:
    """Return what an exception says, on one short line without a full stop at its end."""
    return shortened(" ".join(str(error).split())).rstrip(".") or "no message"


def described(error: BaseException) -> str:
    """Return the class of an exception and what it says: "ValueError: not a number"."""
    return f"{type(error).__name__}: {said(error)}"


def _cut(text: str, most: int) -> str:
    """Cut the middle out of a text that is too long; most of its beginning stays."""
    if len(text) <= most:
        return text
    tail = most // 3
    return f"{text[: most - tail - 1]}…{text[-tail:]}"
