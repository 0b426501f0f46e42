"""Records as rows: flat ones for pandas, a table of published digits, and rows as CSV."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from bench.results.quantities import ASKED, LEVELS, NORM, NORMS, PARTS, VIOLATIONS, whole
from bench.results.records import Digits, Environment, Record
from bench.results.table import Table

#: Fields of a record that have columns of their own, a number each.
_NESTED = "errors", "later", "reference_error", "components", "constraint", "work", "rounds"


def flatten(record: Record, environments: Mapping[int, Environment]) -> dict[str, Any]:
    """Return a record as a flat row for pandas: ``error_q_end``, ``work_residuals``, ...

    ``operations`` is the sum of the bill, ``operations_residuals`` ... are its parts. The
    components' errors, ``pattern`` and ``run_s`` are lists; ``environment`` is a name.
    """
    row = msgspec.to_builtins(record)
    row = {name: value for name, value in row.items() if name not in _NESTED}
    machine = environments.get(record.environment)
    row |= {"environment": machine.name if machine else None, "pattern": list(record.pattern)}
    for group in ASKED:
        for norm in NORMS:
            row[f"error_{group}_{norm}"] = record.error(group, norm)
            floor = record.reference_error.get(group, {}).get(norm)
            row[f"reference_error_{group}_{norm}"] = floor
            if group not in VIOLATIONS:
                row[f"error_{group}_2norm_{norm}"] = record.error(whole(group), norm)
                each = record.components.get(group, {}).get(norm, [])
                row[f"error_{group}_components_{norm}"] = each
        row[f"error_{group}_{NORM}_later"] = [errors.get(group) for errors in record.later]
    row |= {f"constraint_{level}": record.constraint.get(level) for level in LEVELS}
    row |= {f"work_{name}": value for name, value in record.work.items()}
    bill = {f"operations_{part}".replace(" ", "_"): record.operations.get(part) for part in PARTS}
    ends = {f"run_s_{end.__name__}": end(record.run_s, default=None) for end in (min, max)}
    row |= {"operations": record.cost("operations")} | bill
    return row | {"run_s_median": record.seconds} | ends


def published_table(digits: Sequence[Digits]) -> Table | None:
    """A row for each value; None if there are none."""
    rows = [
        [f"{one.t:g}", f"{one.quantity} {k}", f"{stated:.13g}", f"{computed:.13g}",
         f"{computed - stated:.1e}", f"{one.tolerance:.0e}"]
        for one in digits
        for k, (stated, computed) in enumerate(zip(one.published, one.computed, strict=True), 1)
    ]  # fmt: skip
    head = ["t [s]", "component", "published", "computed", "difference", "they hold to"]
    return Table("Published digits", head, rows) if rows else None


def csv_text(rows: Sequence[Mapping[str, object]]) -> str:
    """Write rows as CSV with a header line; return the table, every line ended by a line feed.

    The numbers of a list are a text with a space in between, "nan" where there is none. Other
    values with parts are JSON. Columns are all names of the rows, in order of first appearance; one
    that a row lacks stays empty.
    """
    columns = list(dict.fromkeys(name for row in rows for name in row))
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _plain(value) for name, value in row.items()} for row in rows)
    # The writer leaves carriage returns without quotes, and readers end a line at them.
    return buffer.getvalue().replace("\r", " ")


def _plain(value: object) -> object:
    if not isinstance(value, Mapping | list | tuple):
        return value
    if isinstance(value, Mapping) or any(isinstance(part, Mapping | str) for part in value):
        return json.dumps(value)
    return " ".join("nan" if number is None else f"{number:.9g}" for number in value)
