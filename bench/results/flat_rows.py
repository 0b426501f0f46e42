"""Records as flat rows, for pandas and spreadsheets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from bench.results.quantities import ASKED, LEVELS, NORM, NORMS, PARTS, VIOLATIONS, whole
from bench.results.records import Environment, Record, median


def flatten(record: Record, environments: Mapping[int, Environment]) -> dict[str, Any]:
    """Return a record as a flat row for pandas: ``error_q_end``, ``work_residuals``, ...

    ``operations`` is the sum of the bill, ``operations_residuals`` ... are its parts. The
    components' errors, ``pattern`` and ``run_s`` are lists; ``environment`` is a name.
    """
    row = msgspec.to_builtins(record)
    machine = environments.get(record.environment)
    row["environment"] = machine.name if machine else None
    row["pattern"] = list(record.pattern)
    for group in ASKED:
        for norm in NORMS:
            row[f"error_{group}_{norm}"] = record.error(group, norm)
            floor = record.reference_error.get(group, {}).get(norm)
            row[f"reference_error_{group}_{norm}"] = floor
            if group in VIOLATIONS:
                continue
            row[f"error_{group}_2norm_{norm}"] = record.error(whole(group), norm)
            each = record.components.get(group, {}).get(norm, [])
            row[f"error_{group}_components_{norm}"] = each
        row[f"error_{group}_{NORM}_later"] = [errors.get(group) for errors in record.later]
    for level in LEVELS:
        row[f"constraint_{level}"] = record.constraint.get(level)
    for name, value in record.work.items():
        row[f"work_{name}"] = value
    row["operations"] = record.cost("operations")
    for part in PARTS:
        row["operations_" + part.replace(" ", "_")] = record.operations.get(part)
    samples = sorted(record.run_s)
    row["run_s_median"] = median(samples)
    row["run_s_min"] = samples[0] if samples else None
    row["run_s_max"] = samples[-1] if samples else None
    for nested in (
        "errors",
        "later",
        "reference_error",
        "components",
        "constraint",
        "work",
        "rounds",
    ):
        del row[nested]
    return row
