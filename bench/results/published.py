"""Published digits of a scene beside computed ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import msgspec
from msgspec import Meta

from bench.results.table import Table


class Digits(msgspec.Struct, kw_only=True):
    """Published values of a quantity at the time ``t`` in s, and computed ones, in their units.

    ``tolerance`` is the difference up to which the published ones hold.
    """

    quantity: Annotated[str, Meta(max_length=1000)]
    t: float
    published: list[float]
    computed: list[float]
    tolerance: Annotated[float, Meta(ge=0)]

    @property
    def difference(self) -> float:
        """Largest difference of an entry."""
        pairs = zip(self.published, self.computed, strict=True)
        return max((abs(a - b) for a, b in pairs), default=0.0)


def published_table(digits: Sequence[Digits]) -> Table | None:
    """A row for each value; None if there are none."""
    rows = [
        [
            f"{one.t:g}",
            f"{one.quantity} {k}",
            *(f"{value:.13g}" for value in (stated, computed)),
            f"{computed - stated:.1e}",
            f"{one.tolerance:.0e}",
        ]
        for one in digits
        for k, (stated, computed) in enumerate(zip(one.published, one.computed, strict=True), 1)
    ]
    head = ["t [s]", "component", "published", "computed", "difference", "they hold to"]
    return Table("Published digits", head, rows) if rows else None
