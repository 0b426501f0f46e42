"""Columns of numbers as short text, which the scripts of the pages read."""

from __future__ import annotations

import math
from collections.abc import Iterable

#: Columns hold log10 of a value in this range, in 24 bits.
LARGEST = 40.0
_STEPS = (1 << 24) - 1
_ALPHABET = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_"
LETTERS = 4
#: Stands for no number.
NONE = "-" * LETTERS


def column(values: Iterable[float | None]) -> str:
    """Positive numbers as text: four characters each, log10 to 5e-6; ``----`` for none.

    A number stays on its side of the nearest power of ten, which is an accuracy.
    """
    return "".join(map(_four_characters, values))


def _four_characters(value: float | None) -> str:
    if value is None or not 0 < value < math.inf:
        return NONE
    logarithm = min(max(math.log10(value), -LARGEST), LARGEST)
    bits, power = round((logarithm + LARGEST) / (2 * LARGEST) * _STEPS), round(logarithm)
    side = round(bits * 2 * LARGEST - (power + LARGEST) * _STEPS)
    above = value > 10.0**power
    bits = min(bits + (above and side <= 0) - (not above and side > 0), _STEPS)
    text = "".join(_ALPHABET[bits >> shift & 63] for shift in (18, 12, 6, 0))
    return text if text != NONE else "---_"
