"""The store: one SQLite file (write-ahead log) per run folder, written row by row.

Only the process that plans writes to it. Each finished cell is one transaction, so that a run
killed at any moment has lost nothing but the cell in work.
"""

from __future__ import annotations

import errno
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from bench.results.experiments import ExperimentResult
from bench.results.records import SCHEMA, Damping, Environment, Plan, Record, Rows, SceneRecord

if TYPE_CHECKING:
    from filelock import FileLock

FILE = "stepbench.sqlite"
#: Locked by whoever writes; the system takes the lock away from a process that ends in any way.
#: Not the database itself, whose own locks SQLite would lose when another file object is closed.
_LOCK = ".stepbench.lock"

_TABLES = """
CREATE TABLE IF NOT EXISTS meta (name TEXT PRIMARY KEY, value BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS environments (id INTEGER PRIMARY KEY, value BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS scenes (
    problem TEXT, t_end REAL, value BLOB NOT NULL, PRIMARY KEY (problem, t_end));
CREATE TABLE IF NOT EXISTS records (
    key TEXT PRIMARY KEY, problem TEXT NOT NULL, integrator TEXT NOT NULL, status TEXT NOT NULL,
    value BLOB NOT NULL, rows BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS damping (integrator TEXT PRIMARY KEY, value BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS experiments (name TEXT PRIMARY KEY, value BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS samples (
    key TEXT NOT NULL REFERENCES records(key), number INTEGER NOT NULL, seconds REAL NOT NULL,
    PRIMARY KEY (key, number));
"""

_WAY_OUT = "start again with --fresh or another --out"
#: Errors of msgspec for damaged values: not JSON, another form, not UTF-8, or not bytes at all
#: (SQLite keeps any type in any column).
_DAMAGED = (msgspec.DecodeError, UnicodeDecodeError, TypeError)


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
        self._path = path = self.folder / FILE
        opened: sqlite3.Connection | None = None
        self._lock: FileLock | None = None
        try:
            if create:
                self.folder.mkdir(parents=True, exist_ok=True)
                self._lock = _locked(self.folder)
                if fresh:
                    _remove(path)
                opened = sqlite3.connect(path, isolation_level=None, timeout=30.0)
                _prepare(opened)
            elif path.is_file():
                opened = _open_to_read(path)
            else:
                raise StoreError(
                    f"{self.folder} holds no stepbench results; run 'stepbench run' first."
                )
            _check_schema(opened, path)
        except (OSError, sqlite3.Error, StoreError) as error:
            if opened is not None:
                opened.close()
            if self._lock is not None:
                self._lock.release()
            if isinstance(error, StoreError):
                raise
            raise StoreError(f"The store {path} cannot be opened ({error}); {_WAY_OUT}.") from error
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
    def save_plan(self, plan: Plan) -> None:
        """Keep the plan of a run; reports follow it."""
        self._write("INSERT OR REPLACE INTO meta VALUES ('plan', ?)", msgspec.json.encode(plan))

    def save_environment(self, environment: Environment) -> int:
        """Keep the environment of an invocation; returns its number."""
        self._write("INSERT INTO environments (value) VALUES (?)", msgspec.json.encode(environment))
        return self._read("SELECT MAX(id) FROM environments")[0][0]

    def save_scene(self, scene: SceneRecord) -> None:
        """Keep a scene's description, reference and drawings."""
        self._write(
            "INSERT OR REPLACE INTO scenes VALUES (?, ?, ?)",
            scene.problem,
            scene.t_end,
            msgspec.json.encode(scene),
        )

    def save_experiment(self, found: ExperimentResult) -> None:
        """Keep the result of an experiment of the atlas."""
        self._write(
            "INSERT OR REPLACE INTO experiments VALUES (?, ?)",
            found.name,
            msgspec.json.encode(found),
        )

    def save_damping(self, integrator: str, damping: Damping | None) -> None:
        """Keep the damping of a method by its printed name; None forgets it."""
        if damping is None:
            self._write("DELETE FROM damping WHERE integrator = ?", integrator)
        else:
            value = msgspec.json.encode(damping)
            self._write("INSERT OR REPLACE INTO damping VALUES (?, ?)", integrator, value)

    def save(self, record: Record, rows: Rows) -> None:
        """Keep a finished cell with its rows, in one transaction; forgets older samples."""
        with self._transaction():
            self._db.execute("DELETE FROM samples WHERE key = ?", (record.key,))
            self._db.execute(
                "INSERT OR REPLACE INTO records VALUES (?, ?, ?, ?, ?, ?)",
                (
                    record.key,
                    record.problem,
                    record.integrator,
                    record.status,
                    msgspec.json.encode(record),
                    msgspec.json.encode(rows),
                ),
            )

    def add_sample(self, key: str, number: int, seconds: float) -> None:
        """Keep one timing sample of a cell."""
        self._write("INSERT OR REPLACE INTO samples VALUES (?, ?, ?)", key, number, seconds)

    # ---- reading -----------------------------------------------------------------------
    def plan(self) -> Plan | None:
        """The plan of the latest run, or None."""
        found = self._read("SELECT value FROM meta WHERE name = 'plan'", kind=Plan)
        return found[0][0] if found else None

    def environments(self) -> dict[int, Environment]:
        """All environments by number."""
        return dict(self._read("SELECT id, value FROM environments ORDER BY id", kind=Environment))

    def scenes(self) -> dict[tuple[str, float], SceneRecord]:
        """All scenes by (problem, t_end)."""
        found = self._read("SELECT value FROM scenes ORDER BY problem, t_end", kind=SceneRecord)
        return {(scene.problem, scene.t_end): scene for (scene,) in found}

    def experiments(self) -> dict[str, ExperimentResult]:
        """Results of the experiments of the atlas by name, in the order of their numbers."""
        if not self._has_table("experiments"):
            return {}
        found = self._read("SELECT name, value FROM experiments", kind=ExperimentResult)
        return dict(sorted(found, key=lambda row: row[1].number))

    def damping(self) -> dict[str, Damping]:
        """Damping of methods by their printed names."""
        if not self._has_table("damping"):
            return {}
        return dict(self._read("SELECT integrator, value FROM damping", kind=Damping))

    def records(self) -> dict[str, Record]:
        """All finished cells by key, with their timing samples, in the order of the plan.

        Cells that the plan no longer has come last.
        """
        # Before the records: a run that goes on meanwhile may add samples, but takes no record
        # away, so that every sample read here finds its record below.
        samples = self._read(
            "SELECT samples.key, records.key, seconds FROM samples "
            "LEFT JOIN records ON records.key = samples.key ORDER BY samples.key, number"
        )
        found = dict(self._read("SELECT key, value FROM records ORDER BY rowid", kind=Record))
        plan = self.plan()
        planned = [key for study in plan.studies for key in study.cells] if plan else []
        records = {key: found[key] for key in dict.fromkeys([*planned, *found]) if key in found}
        for key, owner, seconds in samples:
            if owner is None:
                raise self._unreadable(f"a timing sample of {key} has no record")
            records[owner].run_s.append(seconds)
        return records

    def rows(self, key: str) -> Rows:
        """The sampled values of a cell.

        Raises
        ------
        KeyError
            If the cell is not there.
        """
        found = self._read("SELECT rows FROM records WHERE key = ?", key, kind=Rows)
        if not found:
            raise KeyError(key)
        return found[0][0]

    # ---- parts -------------------------------------------------------------------------
    def _has_table(self, name: str) -> bool:
        """Whether there is a table; stores of earlier versions may lack some."""
        return bool(self._read("SELECT 1 FROM sqlite_master WHERE name = ?", name))

    def _read(self, sql: str, *parameters: object, kind: type | None = None) -> list[tuple]:
        """All rows of a query; their last column is decoded if its ``kind`` is given."""
        try:
            rows = self._db.execute(sql, parameters).fetchall()
            if kind is None:
                return rows
            return [(*row[:-1], msgspec.json.decode(row[-1], type=kind)) for row in rows]
        except (sqlite3.Error, *_DAMAGED) as error:
            raise self._unreadable(error) from error

    def _write(self, sql: str, *parameters: object) -> None:
        try:
            self._db.execute(sql, parameters)
        except sqlite3.Error as error:
            raise self._unwritable(error) from error

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        """All or nothing, with the store's own error."""
        try:
            self._db.execute("BEGIN IMMEDIATE")
            yield
            self._db.execute("COMMIT")
        except BaseException as error:
            if self._db.in_transaction:
                self._db.execute("ROLLBACK")
            if isinstance(error, sqlite3.Error):
                raise self._unwritable(error) from error
            raise

    def _unreadable(self, reason: object) -> StoreError:
        return StoreError(f"The store {self._path} cannot be read ({reason}); {_WAY_OUT}.")

    def _unwritable(self, error: sqlite3.Error) -> StoreError:
        return StoreError(
            f"The store in {self.folder} cannot be written ({error}); free some space or choose "
            f"another --out. Earlier results are intact."
        )


def _locked(folder: Path) -> FileLock | None:
    """The lock of a folder, taken; None where the file system has no locks."""
    from filelock import FileLock, Timeout  # not needed to read, and slow to import

    lock = FileLock(folder / _LOCK)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise StoreError(
            f"Another run is writing into {folder}; wait for its end, or give another --out."
        ) from None
    except OSError as error:
        if error.errno in (errno.ENOLCK, errno.EOPNOTSUPP):
            return None
        raise
    return lock


def _remove(path: Path) -> None:
    # The file goes last: a log left behind without its file would meet the new one.
    for suffix in ("-wal", "-shm", ""):
        path.with_name(path.name + suffix).unlink(missing_ok=True)


def _prepare(db: sqlite3.Connection) -> None:
    db.execute("PRAGMA journal_mode=WAL")
    db.execute("PRAGMA synchronous=NORMAL")
    # One transaction, so that a store that has tables also has its schema.
    db.executescript(
        f"BEGIN IMMEDIATE; {_TABLES} "
        f"INSERT OR IGNORE INTO meta VALUES ('schema', CAST('{SCHEMA}' AS BLOB)); COMMIT;"
    )


def _open_to_read(path: Path) -> sqlite3.Connection:
    uri = f"{path.absolute().as_uri()}?mode=ro"
    db = sqlite3.connect(uri, uri=True, isolation_level=None, timeout=30.0)
    try:
        db.execute("SELECT 1 FROM sqlite_master")  # the file is opened by the first query
        return db
    except sqlite3.Error as error:
        db.close()
        log = path.with_name(path.name + "-wal")
        # In a folder that cannot be written there is no place for the log's index. Nobody
        # writes there either, so the file stands still, but rows still in a log would be lost.
        refused = error.sqlite_errorcode & 0xFF in (
            sqlite3.SQLITE_CANTOPEN,
            sqlite3.SQLITE_READONLY,
        )
        if not refused or (log.exists() and log.stat().st_size):
            raise
    return sqlite3.connect(f"{uri}&immutable=1", uri=True, isolation_level=None)


def _check_schema(db: sqlite3.Connection, path: Path) -> None:
    has_meta = db.execute("SELECT 1 FROM sqlite_master WHERE name = 'meta'").fetchone()
    row = has_meta and db.execute("SELECT value FROM meta WHERE name = 'schema'").fetchone()
    if not row:
        raise StoreError(f"{path} is no stepbench store (it has no schema); {_WAY_OUT}.")
    # Compared as text: a damaged version may be no number.
    found = row[0].decode(errors="replace") if isinstance(row[0], bytes) else str(row[0])
    if found != str(SCHEMA):
        raise StoreError(
            f"The store {path} has schema {found}, this version reads {SCHEMA}; {_WAY_OUT}."
        )
