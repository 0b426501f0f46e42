"""Tables as CSV text, for files and for charts."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence

#: A text that begins so is run as a formula by a spreadsheet.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def csv_text(rows: Sequence[Mapping[str, object]], columns: Sequence[str] | None = None) -> str:
    """Write rows as CSV with a header line; return the table, every line ended by a line feed.

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
    writer.writerows(rows)
    text = buffer.getvalue()
    # The writer leaves carriage returns without quotes, and readers end a line at them.
    return text.replace("\r", " ")


def csv_export(rows: Sequence[Mapping[str, object]]) -> str:
    """Write rows as CSV for a spreadsheet: none of its texts is a formula.

    A text that would be one gets an apostrophe in front. Numbers stay as they are; those of a list
    are a text with a space in between, "nan" where there is none. Other values with parts are JSON.
    """
    columns = {name: str(_quoted(name)) for row in rows for name in row}
    quoted = [{columns[name]: _quoted(value) for name, value in row.items()} for row in rows]
    return csv_text(quoted, list(columns.values()))


def _quoted(value: object) -> object:
    if isinstance(value, Mapping | list | tuple):
        if isinstance(value, Mapping) or any(isinstance(part, Mapping | str) for part in value):
            return json.dumps(value)
        return " ".join("nan" if number is None else f"{number:.9g}" for number in value)
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value
