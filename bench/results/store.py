"""The store: one SQLite file (write-ahead log) per run folder.

All results are rows of one table: kind (the name of a record's class), key, and the value as JSON.
A new study needs no other table. Timing samples, which come one by one, have one of their own. Only
the process that plans writes. Each finished cell is one transaction, so that a run killed at any
moment has lost nothing but the cell in work.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import msgspec

from bench.results.drift import LongRun
from bench.results.experiments import ExperimentResult
from bench.results.records import SCHEMA, Damping, Environment, Plan, Record, Rows, SceneRecord
from bench.results.store_file import (
    FILE,
    WAY_OUT,
    StoreError,
    Unreadable,
    decoded,
    encoded,
    locked,
    opened_to_read,
)
from problems.plain_text import clean

if TYPE_CHECKING:
    from filelock import FileLock

T = TypeVar("T")

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
    Record: lambda record: record.key,
    SceneRecord: lambda scene: f"{scene.problem} | {scene.t_end!r}",
    ExperimentResult: lambda found: found.name,
    LongRun: lambda run: run.key,
}
#: Most rows that are named in the sentence on those left out.
_NAMED = 3


class SetAside(NamedTuple):
    """A row that cannot be read: its kind, its key, and the reason."""

    kind: str
    key: str
    reason: str


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
        self._lock: FileLock | None = None
        self._spoilt: dict[tuple[str, str], str] = {}
        opened: sqlite3.Connection | None = None
        try:
            if create:
                self.folder.mkdir(parents=True, exist_ok=True)
                self._lock = locked(self.folder)
                if fresh:
                    # The file goes last: a log left without its file would meet the new one.
                    for suffix in ("-wal", "-shm", ""):
                        self._path.with_name(FILE + suffix).unlink(missing_ok=True)
                opened = sqlite3.connect(self._path, isolation_level=None, timeout=30.0)
                opened.execute("PRAGMA journal_mode=WAL")
                opened.execute("PRAGMA synchronous=NORMAL")
                if not opened.execute("SELECT 1 FROM sqlite_master").fetchone():
                    opened.executescript(_TABLES)
            elif self._path.is_file():
                opened = opened_to_read(self._path)
            else:
                raise StoreError(
                    f"{self.folder} holds no stepbench results; run 'stepbench run' first."
                )
            (version,) = opened.execute("PRAGMA user_version").fetchone()
            if version != SCHEMA:
                raise StoreError(
                    f"{self._path} is no stepbench store of this version (its schema is {version}, "
                    f"not {SCHEMA}); {WAY_OUT}."
                )
        except (OSError, sqlite3.Error, StoreError) as error:
            if opened is not None:
                opened.close()
            if self._lock is not None:
                self._lock.release()
            if isinstance(error, StoreError):
                raise
            raise StoreError(
                f"The store {self._path} cannot be opened ({error}); {WAY_OUT}."
            ) from error
        self._db = opened

    def close(self) -> None:
        """Close the file; the write-ahead log is folded in."""
        self._db.close()
        if self._lock is not None:
            self._lock.release()

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
        """
        with self._transaction():
            self._put(value, _KEYS[type(value)](value) if key is None else key)

    def forget(self, kind: type, key: str) -> None:
        """Forget the value of a kind and a key, if there is one."""
        with self._transaction() as db:
            db.execute("DELETE FROM results WHERE kind = ? AND key = ?", (kind.__name__, key))

    def take(self, other: Store, kinds: Iterable[type]) -> None:
        """Keep all that another store has of some kinds."""
        names = [kind.__name__ for kind in kinds]
        marks = ", ".join("?" * len(names))
        rows = other._read(
            f"SELECT kind, key, value FROM results WHERE kind IN ({marks}) ORDER BY rowid", *names
        )
        with self._transaction() as db:
            db.executemany("INSERT OR REPLACE INTO results VALUES (?, ?, ?)", rows)

    def save_environment(self, environment: Environment) -> int:
        """Keep the environment of an invocation; returns its number."""
        number = max(self.environments(), default=0) + 1
        self.keep(environment, str(number))
        return number

    def save(self, record: Record, rows: Rows) -> None:
        """Keep a finished cell with its rows, in one transaction; forgets older samples."""
        with self._transaction() as db:
            db.execute("DELETE FROM samples WHERE key = ?", (clean(record.key),))
            if self._put(rows, record.key) is not rows:
                said = f"{record.message} Its sampled values cannot be stored."
                record = msgspec.structs.replace(record, message=said.strip())
            self._put(record, record.key)

    def add_sample(
        self, key: str, number: int, seconds: float, invocation: int | None = None
    ) -> None:
        """Keep one timing sample of a cell: its round, in an invocation (None: the cell's own)."""
        with self._transaction() as db:
            row = clean(key), number, seconds, invocation
            db.execute("INSERT OR REPLACE INTO samples VALUES (?, ?, ?, ?)", row)

    # ---- reading -----------------------------------------------------------------------
    def values(self, kind: type[T]) -> dict[str, T]:
        """The values of a kind by key, in the order in which they were kept.

        Those that cannot be read are left out, and noted for `set_aside`.
        """
        read = "SELECT key, value FROM results WHERE kind = ? ORDER BY rowid"
        found = {}
        for key, raw in self._read(read, kind.__name__):
            with suppress(Unreadable):
                found[key] = self._decoded(key, raw, kind)
        return found

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

    def damping(self) -> dict[str, Damping]:
        """Damping of methods by their printed names."""
        return self.values(Damping)

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
        """The sampled values of a cell; none if they cannot be read.

        Raises
        ------
        KeyError
            If the cell is not there.
        """
        read = "SELECT value FROM results WHERE kind = 'Rows' AND key = ?"
        for (raw,) in self._read(read, key):
            with suppress(Unreadable):
                return self._decoded(key, raw, Rows)
            return Rows(t=[])
        raise KeyError(key)

    def set_aside(self) -> list[SetAside]:
        """All rows that cannot be read; the other methods pass over them."""
        self._spoilt.clear()
        for kind in (*_KEYS, Environment, Damping, Rows):
            self.values(kind)
        return [SetAside(*place, reason) for place, reason in self._spoilt.items()]

    # ---- parts -------------------------------------------------------------------------
    def _put(self, value: Any, key: str) -> Any:
        """Write a value, or that in its place if it could not be read again; returns which."""
        try:
            raw = encoded(value)
        except Unreadable as error:
            if (value := _instead(value, error)) is None:
                text = f"The result {key!r} cannot be stored in {self.folder}: {error}."
                raise StoreError(text) from None
            raw = encoded(value)
        row = type(value).__name__, clean(key), raw
        self._db.execute("INSERT OR REPLACE INTO results VALUES (?, ?, ?)", row)
        return value

    def _decoded(self, key: str, raw: Any, kind: type[T]) -> T:
        """A value; one that cannot be read is noted."""
        try:
            return decoded(raw, kind)
        except Unreadable as error:
            self._spoilt[kind.__name__, key] = str(error)
            raise

    def _read(self, sql: str, *parameters: object) -> list[tuple]:
        """All rows of a query."""
        try:
            return self._db.execute(sql, parameters).fetchall()
        except sqlite3.Error as error:
            text = f"The store {self._path} cannot be read ({error}); {WAY_OUT}."
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


def _instead(value: Any, reason: Unreadable) -> Any:
    """The value in the place of one that could not be read: whose it is, and the reason."""
    why = f"cannot be stored: {reason}."
    if isinstance(value, Record):
        names = ("key", "problem", "integrator", "controls", "h", "pattern", "rtol", "atol", "t0")
        names += ("t_end", "environment", "budget_s", "family", "formulation", "fingerprint")
        kept = {name: getattr(value, name) for name in names}
        return Record(**kept, status="crashed", message=f"The result {why}")
    if isinstance(value, SceneRecord):
        about = {name: getattr(value, name) for name in ("problem", "t_end", "t0", "fingerprint")}
        return SceneRecord(**about, description=f"The description of this scene {why}")
    if isinstance(value, Damping):
        return Damping(omega_h=[], message=f"It {why}")
    return Rows(t=[]) if isinstance(value, Rows) else None


def set_aside_text(found: Sequence[SetAside]) -> str:
    """Say how many rows cannot be read, and name a few; empty if all can be."""
    if not found:
        return ""
    named = [f"{row.kind} {clean(row.key)[:80]!r} ({row.reason})" for row in found[:_NAMED]]
    more = [f"{len(found) - _NAMED} more"] if len(found) > _NAMED else []
    rows = "1 row" if len(found) == 1 else f"{len(found)} rows"
    return f"{rows} of the store cannot be read and left out: {'; '.join([*named, *more])}."
