"""Which rows of a run a picture shows."""

from __future__ import annotations

from collections.abc import Iterable

from bench.results.quantities import GROUPS
from bench.results.records import Rows

#: Rows of a run that a still picture shows.
STILL_ROWS = 110


def thinned(rows: Rows) -> Rows:
    """As many rows as a picture can show, the last among them."""
    stride = -(-len(rows.t) // STILL_ROWS)
    places = [*range(0, len(rows.t) - 1, stride or 1), len(rows.t) - 1] if rows.t else []
    return Rows(
        t=[rows.t[k] for k in places],
        values={name: [table[k] for k in places] for name, table in rows.values.items()},
        notes={name: [column[k] for k in places] for name, column in rows.notes.items()},
    )


def within(rows: Rows, reference: Rows) -> Rows | None:
    """The rows before a run leaves all proportion, so that it does not flatten the others."""
    limits = {
        name: 5 * max((abs(x) for row in values for x in row), default=0.0)
        for name, values in reference.values.items()
    }
    keep = 0
    while keep < len(rows.t) and all(
        abs(x) <= limits.get(name, 0.0)
        for name, values in rows.values.items()
        if name in limits
        for x in values[keep]
    ):
        keep += 1
    if keep < 2:
        return None
    return Rows(t=rows.t[:keep], values={name: v[:keep] for name, v in rows.values.items()})


def sampled(tables_of_rows: Iterable[Rows]) -> list[str]:
    """The groups of which any of them has values."""
    present = {name for rows in tables_of_rows for name, values in rows.values.items() if values}
    return [group for group in GROUPS if group in present]
