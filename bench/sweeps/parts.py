"""Members of an ensemble in parts on the disk, many more than memory holds, and files of all.

A part holds the members of a shard, in the format ``npz``: `numpy.load` gives an array for each
column. A part is put in place whole, with a digest at its end, so that those that are there can be
read at any time, and one that has changed is run again. Without a file to write, parts are in the
system's folder for temporary files, which may be memory.
"""

from __future__ import annotations

import io
import json
import shutil
import tempfile
import zipfile
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import numpy as np

from bench.results.csv_text import csv_export
from bench.results.store_file import locked
from bench.sweeps.ensemble import WORK, member_rows, spread
from problems.spec import SpecError
from problems.whole_files import keep, kept

_ABOUT = "ensemble.json"
#: Bytes of the columns that are in memory together; a column is not divided.
_MOST_BYTES = 2**26
#: Columns that are no end values, beside what varies and the counts of work.
_OWN = ("member", "status", "message", "t")

Columns = Mapping[str, np.ndarray]


class TemporaryParts:
    """Parts in a file that has no name, and ends with this process however it ends.

    It is in the system's folder for temporary files: in memory, where this is a tmpfs.
    """

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 - it lasts as long as the parts
        self._places: dict[int, tuple[int, int]] = {}

    def put(self, k: int, columns: Columns) -> None:
        """Keep the part with this number."""
        content = _encoded(columns)
        self._places[k] = self._file.seek(0, io.SEEK_END), len(content)
        self._file.write(content)

    def numbers(self) -> set[int]:
        """Return the numbers of the parts that there are."""
        return set(self._places)

    def opened(self, k: int) -> IO[bytes]:
        """Return a part for `numpy.load`."""
        start, length = self._places[k]
        self._file.seek(start)
        return io.BytesIO(self._file.read(length))


class KeptParts:
    """Parts in a folder, where another call of the same command finds them.

    Methods as of `TemporaryParts`.

    Parameters
    ----------
    folder
        Is made if it is not there. One command writes into it at a time.
    about
        What decides the members, as values of JSON.

    Raises
    ------
    SpecError
        If there are parts of another ensemble.
    StoreError
        If another command writes there.
    """

    def __init__(self, folder: Path, about: dict[str, Any]) -> None:
        self._folder = folder
        folder.mkdir(exist_ok=True)
        self._lock = locked(folder)
        file, text = folder / _ABOUT, json.dumps(about, indent=1).encode()
        if (known := kept(file)) is None:
            self._drop_all()  # nobody knows of which ensemble they are
            keep(file, text)
        elif known != text:
            raise SpecError(
                f"{folder} holds members of another ensemble, of other sources, or of another "
                f"release; give the same command again, or remove this folder."
            )
        self._sound = {k for k in self._found() if kept(self.opened(k)) is not None}

    def put(self, k: int, columns: Columns) -> None:
        keep(self.opened(k), _encoded(columns))
        self._sound.add(k)

    def numbers(self) -> set[int]:
        return set(self._sound)

    def opened(self, k: int) -> Path:
        return self._folder / f"part-{k:06d}.npz"

    def remove(self) -> None:
        """Remove the folder: its members are elsewhere.

        Whoever ends this half-way leaves parts of a known ensemble, or none.
        """
        self._drop_all()
        (self._folder / _ABOUT).unlink()
        shutil.rmtree(self._folder)
        if self._lock:
            self._lock.release()

    def _drop_all(self) -> None:
        for k in [*self._found()]:
            self.opened(k).unlink(missing_ok=True)

    def _found(self) -> Iterator[int]:
        for path in self._folder.glob("part-*.npz"):
            if (number := path.stem.removeprefix("part-")).isdecimal():
                yield int(number)


Parts = KeptParts | TemporaryParts


def read_part(part: Path | IO[bytes]) -> dict[str, np.ndarray]:
    """Return all columns of an opened part."""
    with np.load(part) as columns:
        return dict(columns)


class EnsembleResults:
    """Contents of the parts 0 to ``count - 1`` of an ensemble, a few columns in memory at a time.

    Parameters
    ----------
    parts
        Where they are; the first that has a part gives it.
    count
        Their number.
    varied
        Names of what varies.

    Attributes
    ----------
    statuses
        Number of members by status.
    first
        For each status the number of its first member, and this member's message.
    work
        Counts of work of all members together.
    """

    def __init__(self, parts: tuple[Parts, ...], count: int, varied: Collection[str]) -> None:
        held = [(of, of.numbers()) for of in parts]
        self._of = [next(of for of, numbers in held if k in numbers) for k in range(count)]
        self.statuses: Counter[str] = Counter()
        self.first: dict[str, tuple[int, str]] = {}
        self.work: Counter[str] = Counter()
        ends: dict[str, None] = {}
        for part in self.parts():
            for status in np.unique(part["status"]).tolist():
                where = np.flatnonzero(part["status"] == status)
                self.statuses[status] += len(where)
                one = where[0]
                self.first.setdefault(status, (int(part["member"][one]), str(part["message"][one])))
            for name, column in part.items():
                if name.startswith(WORK):
                    self.work[name.removeprefix(WORK)] += int(column.sum())
                elif name not in (*_OWN, *varied):
                    ends[name] = None
        self._ends = list(ends)

    def parts(self) -> Iterator[dict[str, np.ndarray]]:
        """Yield the columns of each part, in the order of the members."""
        for k, of in enumerate(self._of):
            yield read_part(of.opened(k))

    def summary(self) -> dict[str, dict[str, float]]:
        """Return "min", "median" and "max" of each end value over the members that are ok."""
        good = self.statuses["ok"]
        if not good:
            return {}
        together = max(1, _MOST_BYTES // (8 * good))
        found = {}
        for start in range(0, len(self._ends), together):
            names = self._ends[start : start + together]
            columns = {name: np.empty(good) for name in names}
            filled = 0
            for k, of in enumerate(self._of):
                with np.load(of.opened(k)) as part:
                    ok = part["status"] == "ok"
                    more = np.count_nonzero(ok)
                    for name, column in columns.items():
                        column[filled : filled + more] = part[name][ok]
                filled += more
            found |= {name: spread(column) for name, column in columns.items()}
        return found


def _encoded(columns: Columns) -> bytes:
    """Columns as the content of a file ``npz``, whatever their names."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        for name, column in columns.items():
            with file.open(f"{name}.npy", "w") as entry:
                np.lib.format.write_array(entry, column, allow_pickle=False)
    return buffer.getvalue()


# ---- files for the user ------------------------------------------------------------------
def check_file_name(path: Path) -> None:
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
        yield before + json.dumps(member_rows(part), indent=1, allow_nan=False)[2:-2]
        before = ",\n"
    yield "\n]"


def _csv_texts(parts: Iterator[Columns]) -> Iterator[str]:
    head = True
    for part in parts:
        text = csv_export(member_rows(part))
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
