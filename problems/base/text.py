"""Text of users, plugins and libraries made fit for a message: short and clean."""

from __future__ import annotations

import re

#: Most characters of a line of a message, and most lines.
LONGEST_LINE, MOST_LINES = 600, 20

#: Control characters but tab and line feed, marks that turn the direction of writing, lone
#: surrogates, and code points that are no characters: XML and terminals do not take them.
_HIDDEN = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff"
    "\ufffe\uffff]"
)
#: The escape of a control character in JSON, behind an even number of backslashes.
_ESCAPE = re.compile(r"(?<!\\)((?:\\\\)*)\\(?:u00[01].|[bfr])")


def clean(text: str) -> str:
    """Write U+FFFD in the place of each such character, for messages, pages, pictures and files."""
    return _HIDDEN.sub("\N{REPLACEMENT CHARACTER}", text)


def clean_json(text: str) -> str:
    """Return JSON whose texts are clean, of JSON that escapes nothing but what it has to."""
    return clean(_ESCAPE.sub(r"\1\\ufffd", text))


def shortened(text: str) -> str:
    """Make a message short and clean: long lines and many lines lose their middle."""
    lines = clean(text).split("\n")
    if len(lines) > MOST_LINES:
        lines = [*lines[: MOST_LINES - 2], "…", lines[-1]]
    most, tail = LONGEST_LINE, LONGEST_LINE // 3
    return "\n".join(x if len(x) <= most else f"{x[: most - tail - 1]}…{x[-tail:]}" for x in lines)


def said(error: BaseException) -> str:
    """Return what an exception says, on one short line without a full stop at its end."""
    return shortened(" ".join(str(error).split())).rstrip(".") or "no message"


def described(error: BaseException) -> str:
    """Return the class of an exception and what it says: "ValueError: not a number"."""
    return f"{type(error).__name__}: {said(error)}"
