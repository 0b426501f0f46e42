"""Comma-separated values: of records and for charts."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence


def csv_text(rows: Sequence[Mapping[str, object]], columns: Sequence[str] | None = None) -> str:
    """Write rows as CSV with a header line; return the table, every line ended by a line feed.

    The numbers of a list are a text with a space in between, "nan" where there is none. Other
    values with parts are JSON.

    Parameters
    ----------
    rows
        One mapping per row; a column that a row lacks stays empty.
    columns
        Names of the columns; all names of the rows, in order of first appearance, if None.
    """
    if columns is None:
        columns = list(dict.fromkeys(name for row in rows for name in row))
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _plain(value) for name, value in row.items()} for row in rows)
    text = buffer.getvalue()
    # The writer leaves carriage returns without quotes, and readers end a line at them.
    return text.replace("\r", " ")


def _plain(value: object) -> object:
    if not isinstance(value, Mapping | list | tuple):
        return value
    if isinstance(value, Mapping) or any(isinstance(part, Mapping | str) for part in value):
        return json.dumps(value)
    return " ".join("nan" if number is None else f"{number:.9g}" for number in value)
