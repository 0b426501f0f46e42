"""Text of unknown origin made fit for terminals, pages and pictures."""

from __future__ import annotations

import re

#: Control characters but tab and line breaks, signs that turn the direction of text around, halves
#: of surrogate pairs, and code points that are no characters. XML allows most of them nowhere,
#: terminals take some as orders, and a page shows others as text that was never written.
_UNFIT = re.compile(
    r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069"
    r"\ud800-\udfff\ufffe\uffff]"
)
#: What stands in the place of such a character.
_INSTEAD = "\ufffd"
#: An escape in JSON; the first alternative passes over escaped backslashes.
_ESCAPE = re.compile(rb"\\(?:[^u]|u([0-9a-fA-F]{4}))")


def clean(text: str) -> str:
    """Return the text with U+FFFD in the place of each character that does harm."""
    return _UNFIT.sub(_INSTEAD, text)


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
    digits = found[1]
    # Halves of pairs are left: msgspec joins two, and refuses one.
    if not digits or 0xD800 <= int(digits, 16) <= 0xDFFF or clean(chr(int(digits, 16))) != _INSTEAD:
        return found[0]
    return b"\\ufffd"
