"""A table of text: a terminal, an HTML page and a Markdown page each write it in their way."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

#: The sign for "no value".
NO_VALUE = "–"  # noqa: RUF001
#: A number as pages and commands write it, with a mark of doubt or a sign for no number.
_NUMBER = re.compile(
    rf"([-+]?[\d.]+(e[-+]?\d+)?( [mb]illion)?|none|{NO_VALUE})( \*)?|-|not (counted|determined)|"
)

_WHOLE = re.compile(r"[-+]?\d+(?=[.e ])")


def whole(cell: str) -> int:
    """How many characters of a cell stand before the point of its number, all if it has none."""
    found = _WHOLE.match(cell)
    return found.end() if found else len(cell)


def number(value: float | None) -> str:
    """Three significant digits, plain where that is short; a dash for no value."""
    if value is None or not math.isfinite(value):
        return NO_VALUE
    if value == 0 or 1e-3 <= abs(value) < 1e6:
        rounded = float(f"{value:.3g}")
        return f"{rounded:.0f}" if abs(rounded) >= 100 else f"{rounded:.3g}"
    return short_exponent(f"{value:.3g}")


def short_exponent(text: str) -> str:
    """A number with an exponent as people write it: 1e-5, 1e6."""
    return re.sub(r"e([-+])0*", lambda found: f"e{found[1].strip('+')}", text)


def formatted(value: float | None, form: str, nothing: str = NO_VALUE) -> str:
    """A number as the format specification ``form`` writes it; ``nothing`` for None."""
    return nothing if value is None else format(value, form)


@dataclass
class Table:
    """Cells as plain text; ``best`` are (row, column) to stress, ``code`` columns hold names.

    ``ids`` are the anchors of the rows; ``links`` are the anchors of the records behind the cell
    (row, column).
    """

    caption: str
    head: list[str]
    rows: list[list[str]]
    best: set[tuple[int, int]] = field(default_factory=set)
    code: tuple[int, ...] = (0,)
    note: str = ""
    ids: list[str] = field(default_factory=list)
    links: dict[tuple[int, int], list[str]] = field(default_factory=dict)

    @property
    def numbers(self) -> set[int]:
        """The columns of which every cell is a number, or a sign for none."""
        columns = enumerate(zip(*self.rows, strict=True))
        return {j for j, cells in columns if any(cells) and all(map(_NUMBER.fullmatch, cells))}

    @property
    def tails(self) -> list[int]:
        """For each column the most characters from the point of a number on; else 0."""
        return [
            max(len(row[j]) - whole(row[j]) for row in self.rows) if j in self.numbers else 0
            for j in range(len(self.head))
        ]

    @classmethod
    def from_dicts(cls, caption: str, rows: Sequence[Mapping[str, str]], **more: Any) -> Table:
        """A table from rows by column; all have the same columns, there is at least one."""
        return cls(caption, list(rows[0]), [list(row.values()) for row in rows], **more)
