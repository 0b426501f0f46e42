"""The sampled rows of a run that a chart shows."""

from __future__ import annotations

from collections.abc import Iterable

from bench.results.quantities import GROUPS
from bench.results.records import Rows

#: Rows of a run in a still picture.
STILL_ROWS = 110
#: A run is drawn until a value exceeds the reference's largest one by this factor.
_OUT_OF_SCALE = 5


def thinned(rows: Rows) -> Rows:
    """At most about ``STILL_ROWS`` rows, evenly chosen, the last among them."""
    stride = -(-len(rows.t) // STILL_ROWS)
    places = [*range(0, len(rows.t) - 1, stride or 1), len(rows.t) - 1] if rows.t else []
    return Rows(
        t=[rows.t[k] for k in places],
        values={name: [table[k] for k in places] for name, table in rows.values.items()},
        notes={name: [column[k] for k in places] for name, column in rows.notes.items()},
    )


def before_divergence(rows: Rows, reference: Rows) -> Rows | None:
    """The first rows, as long as they fit the reference's scale; None for fewer than two.

    The values of a run that diverges would flatten all other lines.
    """
    limits = {
        name: _OUT_OF_SCALE * max((abs(x) for row in values for x in row), default=0.0)
        for name, values in reference.values.items()
    }
    keep = 0
    while keep < len(rows.t) and all(
        abs(x) <= limits[name]
        for name, values in rows.values.items()
        if name in limits
        for x in values[keep]
    ):
        keep += 1
    if keep < 2:
        return None
    return Rows(t=rows.t[:keep], values={name: v[:keep] for name, v in rows.values.items()})


def groups_with_values(samples: Iterable[Rows]) -> list[str]:
    """The groups of variables in which any run has values."""
    present = {name for rows in samples for name, values in rows.values.items() if values}
    return [group for group in GROUPS if group in present]
