"""Tables as CSV text, for files and for charts."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence


def csv_text(rows: Sequence[Mapping[str, object]], columns: Sequence[str] | None = None) -> str:
    """Write rows as CSV with a header line.

    Parameters
    ----------
    rows
        One mapping per row; a column that a row lacks stays empty.
    columns
        Names of the columns; all names of the rows, in order of first appearance, if None.

    Returns
    -------
    str
        The table, every line ended by a line feed.
    """
    if columns is None:
        columns = list(dict.fromkeys(name for row in rows for name in row))
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return buffer.getvalue()
