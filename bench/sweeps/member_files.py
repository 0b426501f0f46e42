"""Files of the members of an ensemble, written part by part: CSV, JSON or Parquet."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from bench.results.csv_text import csv_export
from bench.sweeps.ensemble import rows_of
from problems.spec import SpecError

Columns = Mapping[str, np.ndarray]


def check_name(path: Path) -> None:
    """Refuse a file that cannot be written, before any work is done for it.

    Raises
    ------
    SpecError
        If the name says no kind of table, or the library for it is missing.
    """
    if path.suffix not in _TEXTS and path.suffix != ".parquet":
        raise SpecError(
            f"{path.name} is no table; give a name that ends in .csv, .json or .parquet."
        )
    if path.suffix == ".parquet":
        _parquet()


def write_members(path: Path, parts: Iterator[Columns]) -> None:
    """Write all members, a flat row each, and put the file in place when it is whole."""
    new = path.with_name(f"{path.name}.new")
    try:
        if path.suffix == ".parquet":
            _write_parquet(new, parts)
        else:
            with new.open("w", encoding="utf-8", newline="\n") as file:
                file.writelines(_TEXTS[path.suffix](parts))
        new.replace(path)
    except BaseException:
        with suppress(OSError):
            new.unlink()
        raise


def json_texts(parts: Iterator[Columns]) -> Iterator[str]:
    """Yield the pieces of a list of rows as JSON."""
    before = "[\n"
    for part in parts:
        yield before + json.dumps(rows_of(part), indent=1, allow_nan=False)[2:-2]
        before = ",\n"
    yield "\n]"


def _csv_texts(parts: Iterator[Columns]) -> Iterator[str]:
    head = True
    for part in parts:
        text = csv_export(rows_of(part))
        yield text if head else text.partition("\n")[2]
        head = False


_TEXTS = {".csv": _csv_texts, ".json": json_texts}


def _write_parquet(path: Path, parts: Iterator[Columns]) -> None:
    arrow, parquet = _parquet()

    def table(part: Columns) -> Any:
        columns = [
            arrow.array(column, mask=~np.isfinite(column) if column.dtype.kind == "f" else None)
            for column in part.values()
        ]
        return arrow.table(columns, names=list(part))

    first = table(next(parts))
    with parquet.ParquetWriter(path, first.schema) as writer:
        writer.write_table(first)
        for part in parts:
            writer.write_table(table(part))


def _parquet() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise SpecError(
            "A file .parquet needs pyarrow; install it by: pip install 'stepbench[parquet]'."
        ) from None
    return pyarrow, pyarrow.parquet
