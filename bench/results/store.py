"""The store: one SQLite file (write-ahead log) per run folder.

All results are rows of one table: kind (the name of a record's class), key, and the value as
compressed JSON. A new study needs no other table. Timing samples, which come one by one, have one
of their own. Only the process that plans writes. Each finished cell is one transaction, so that a
run killed at any moment has lost nothing but the cell in work.
"""

from __future__ import annotations

import os
import sqlite3
import zlib
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from bench.results.records import SCHEMA, Environment, Plan, Record, Rows, SceneRecord
from bench.results.studies import ExperimentResult, LongRun

T = TypeVar("T")

FILE = "stepbench.sqlite"
#: Locked by whoever writes; the system takes the lock away from a process that ends in any way.
#: Not the database itself, whose own locks SQLite would lose when another file object is closed.
_LOCK = ".stepbench.lock"
_WAY_OUT = "start again with --fresh or another --out"
_TABLES = f"""
BEGIN IMMEDIATE;
CREATE TABLE results (kind TEXT, key TEXT, value BLOB NOT NULL, PRIMARY KEY (kind, key));
CREATE TABLE samples (key TEXT, number INTEGER, seconds REAL NOT NULL, invocation INTEGER,
    PRIMARY KEY (key, number));
PRAGMA user_version = {SCHEMA};
COMMIT;
"""
#: Keys of values that hold their own.
_KEYS = {
    Plan: lambda plan: "plan",
    SceneRecord: lambda scene: f"{scene.problem} | {scene.t_end!r}",
    ExperimentResult: lambda found: found.name,
    LongRun: lambda run: run.key,
}
#: Significant digits of sampled values, which charts show with fewer. Sampled values are most of a
#: store, and their last digits are noise, which no compression makes smaller.
_DIGITS = 8


class StoreError(RuntimeError):
    """The folder has no readable store, or the store cannot be written."""


class Store:
    """Open the store in a folder.

    Parameters
    ----------
    folder
        The run folder.
    create
        Open for writing, and make the folder and the store if they are not there. Without it
        the store is only read: neither tables nor settings of the file are touched.
    fresh
        With ``create``: begin with an empty store, whatever is there now, be it damaged or of
        another schema.

    Raises
    ------
    StoreError
        If there is no store (without ``create``), it cannot be read or written, or it was
        written by another version of the schema; with ``create``, if somebody else writes to it.
    """

    def __init__(self, folder: Path, create: bool = False, fresh: bool = False) -> None:
        self.folder = Path(folder)
        self._path = self.folder / FILE
        with ExitStack() as opened:
            try:
                self._db = self._writing(opened, fresh) if create else self._reading()
                opened.callback(self._db.close)
                (version,) = self._db.execute("PRAGMA user_version").fetchone()
            except (OSError, sqlite3.Error) as error:
                raise StoreError(
                    f"The store {self._path} cannot be opened ({error}); {_WAY_OUT}."
                ) from error
            if version != SCHEMA:
                raise StoreError(
                    f"{self._path} is no stepbench store of this version (its schema is {version}, "
                    f"not {SCHEMA}); {_WAY_OUT}."
                )
            self._opened = opened.pop_all()

    def close(self) -> None:
        """Close the file; the write-ahead log is folded in."""
        self._opened.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # ---- writing -----------------------------------------------------------------------
    def keep(self, value: Any, key: str | None = None) -> None:
        """Keep a value, in the place of an earlier one of its kind and key.

        Parameters
        ----------
        value
            A plan, the description of a scene, a result of a study.
        key
            Its key, if it does not hold one.

        Raises
        ------
        StoreError
            If it could not be read again.
        """
        self._put([(_KEYS[type(value)](value) if key is None else key, value)])

    def take(self, other: Store, kinds: Iterable[type]) -> None:
        """Keep all that another store has of some kinds."""
        for kind in kinds:
            self._put(other.values(kind).items())

    def save_environment(self, environment: Environment) -> int:
        """Keep the environment of an invocation; returns its number."""
        number = max(self.environments(), default=0) + 1
        self.keep(environment, str(number))
        return number

    def save(self, record: Record, rows: Rows) -> None:
        """Keep a finished cell with its rows, in one transaction; forgets older samples."""
        rows = Rows(t=_short(rows.t), values=_short(rows.values), notes=_short(rows.notes))
        self._put([(record.key, rows), (record.key, record)], forget_samples=record.key)

    def add_sample(
        self, key: str, number: int, seconds: float, invocation: int | None = None
    ) -> None:
        """Keep one timing sample of a cell: its round, in an invocation (None: the cell's own)."""
        with self._transaction() as db:
            row = key, number, seconds, invocation
            db.execute("INSERT OR REPLACE INTO samples VALUES (?, ?, ?, ?)", row)

    # ---- reading -----------------------------------------------------------------------
    def values(self, kind: type[T], key: str | None = None) -> dict[str, T]:
        """Return the values of a kind by key, in the order in which they were kept.

        Parameters
        ----------
        kind
            Their class.
        key
            The key of the only one that is asked for.
        """
        read = f"SELECT key, value FROM results WHERE kind = ?{' AND key = ?' if key else ''}"
        rows = self._read(f"{read} ORDER BY rowid", kind.__name__, *([key] if key else []))
        try:
            return {key: _decoded(raw, kind) for key, raw in rows}
        except ValueError as error:
            text = f"A {kind.__name__} in the store {self._path} cannot be read ({error})"
            raise StoreError(f"{text}; {_WAY_OUT}.") from error

    def plan(self) -> Plan | None:
        """The plan of the latest run, or None."""
        return self.values(Plan).get("plan")

    def environments(self) -> dict[int, Environment]:
        """All environments by number."""
        return {int(number): value for number, value in self.values(Environment).items()}

    def scenes(self) -> dict[tuple[str, float], SceneRecord]:
        """All scenes by (problem, t_end), in this order."""
        found = {(s.problem, s.t_end): s for s in self.values(SceneRecord).values()}
        return dict(sorted(found.items()))

    def experiments(self) -> dict[str, ExperimentResult]:
        """Results of the experiments of the atlas by name, in the order of their numbers."""
        found = self.values(ExperimentResult)
        return dict(sorted(found.items(), key=lambda pair: pair[1].number))

    def long_runs(self) -> dict[str, LongRun]:
        """Long runs by key, in the order in which they were kept."""
        return self.values(LongRun)

    def records(self) -> dict[str, Record]:
        """All finished cells by key, with their timing samples, in the order of the plan.

        Cells that the plan no longer has come last.
        """
        # Before the records: a run that goes on meanwhile may add samples, but takes no record
        # away, so that every sample read here finds its record below.
        samples = self._read("SELECT * FROM samples ORDER BY key, number")
        found, plan = self.values(Record), self.plan()
        planned = [key for study in plan.studies for key in study.cells] if plan else []
        records = {key: found[key] for key in dict.fromkeys([*planned, *found]) if key in found}
        for record in records.values():
            record.rounds, record.run_s = [], []
        for key, number, seconds, invocation in samples:
            if record := records.get(key):
                taken_by = record.environment if invocation is None else invocation
                record.rounds.append((taken_by, number))
                record.run_s.append(seconds)
        return records

    def rows(self, key: str) -> Rows:
        """The sampled values of a cell.

        Raises
        ------
        KeyError
            If the cell is not there.
        """
        return self.values(Rows, key)[key]

    # ---- parts -------------------------------------------------------------------------
    def _writing(self, opened: ExitStack, fresh: bool) -> sqlite3.Connection:
        """Open the file, made if it is not there, and lock the folder."""
        from filelock import FileLock, Timeout  # not needed to read, and slow to import

        self.folder.mkdir(parents=True, exist_ok=True)
        try:
            opened.enter_context(FileLock(self.folder / _LOCK, timeout=0))
        except Timeout:
            raise StoreError(
                f"Another run is writing into {self.folder}; wait for its end, or give another "
                f"--out."
            ) from None
        if fresh:
            # The file goes last: a log left without its file would meet the new one.
            for suffix in ("-wal", "-shm", ""):
                self._path.with_name(FILE + suffix).unlink(missing_ok=True)
        db = sqlite3.connect(self._path, isolation_level=None, timeout=30.0)
        try:
            db.execute("PRAGMA journal_mode=WAL")
            db.execute("PRAGMA synchronous=NORMAL")
            if not db.execute("SELECT 1 FROM sqlite_master").fetchone():
                db.executescript(_TABLES)
        except sqlite3.Error:
            db.close()
            raise
        return db

    def _reading(self) -> sqlite3.Connection:
        """Open a file that must not change, also in a folder that cannot be written."""
        if not self._path.is_file():
            raise StoreError(
                f"{self.folder} holds no stepbench results; run 'stepbench run' first."
            )
        log = self._path.with_name(FILE + "-wal")
        # In a folder that cannot be written there is no place for the log's index. Nobody writes
        # there either, so the file stands still, but rows still in a log would be lost.
        logged = log.exists() and log.stat().st_size > 0
        as_user = os.access in os.supports_effective_ids
        written = os.access(self.folder, os.W_OK, effective_ids=as_user)
        still = "" if written or logged else "&immutable=1"
        uri = f"{self._path.absolute().as_uri()}?mode=ro{still}"
        return sqlite3.connect(uri, uri=True, isolation_level=None, timeout=30.0)

    def _put(self, values: Iterable[tuple[str, Any]], forget_samples: str | None = None) -> None:
        try:
            rows = [(type(value).__name__, key, _encoded(value)) for key, value in values]
        except ValueError as error:
            raise StoreError(f"A result cannot be stored in {self.folder}: {error}.") from error
        with self._transaction() as db:
            db.execute("DELETE FROM samples WHERE key = ?", (forget_samples,))
            db.executemany("INSERT OR REPLACE INTO results VALUES (?, ?, ?)", rows)

    def _read(self, sql: str, *parameters: object) -> list[tuple]:
        """All rows of a query."""
        try:
            return self._db.execute(sql, parameters).fetchall()
        except sqlite3.Error as error:
            text = f"The store {self._path} cannot be read ({error}); {_WAY_OUT}."
            raise StoreError(text) from error

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """All or nothing, with the store's own error."""
        try:
            with self._db:
                self._db.execute("BEGIN IMMEDIATE")
                yield self._db
        except sqlite3.Error as error:
            raise StoreError(
                f"The store in {self.folder} cannot be written ({error}); free some space or "
                "choose another --out. Earlier results are intact."
            ) from error


def _encoded(value: Any) -> bytes:
    """Write a value; ValueError if it could not be read again."""
    try:
        raw = zlib.compress(msgspec.json.encode(value), 9)
    except (TypeError, OverflowError) as error:
        raise ValueError(str(error)) from error
    _decoded(raw, type(value))
    return raw


def _decoded(raw: bytes, kind: type[T]) -> T:
    """Read a value; ValueError if it is not of this kind."""
    try:
        return msgspec.json.decode(zlib.decompress(raw), type=kind)
    except (zlib.error, msgspec.DecodeError, TypeError) as error:
        raise ValueError(str(error)) from error


def _short(values: Any) -> Any:
    """Sampled values with `_DIGITS` significant digits."""
    if isinstance(values, dict):
        return {name: _short(own) for name, own in values.items()}
    if isinstance(values, list):
        return [_short(own) for own in values]
    return float(f"{values:.{_DIGITS}g}") if isinstance(values, float) else values
