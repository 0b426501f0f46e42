"""The file of a store: its tables, its lock, opening it for writing and for reading alone."""

from __future__ import annotations

import errno
import sqlite3
from pathlib import Path
from typing import TYPE_CHECKING

from bench.results.records import SCHEMA
from problems.plain_text import clean

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
CREATE TABLE IF NOT EXISTS long_runs (key TEXT PRIMARY KEY, value BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS samples (
    key TEXT NOT NULL REFERENCES records(key), number INTEGER NOT NULL, seconds REAL NOT NULL,
    invocation INTEGER, PRIMARY KEY (key, number));
"""

#: Finds the column of the invocation, which samples of earlier versions lack.
INVOCATIONS = "SELECT 1 FROM pragma_table_info('samples') WHERE name = 'invocation'"

WAY_OUT = "start again with --fresh or another --out"


class StoreError(RuntimeError):
    """The folder has no readable store, or the store cannot be written."""


def locked(folder: Path) -> FileLock | None:
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


def remove(path: Path) -> None:
    # The file goes last: a log left behind without its file would meet the new one.
    for suffix in ("-wal", "-shm", ""):
        path.with_name(path.name + suffix).unlink(missing_ok=True)


def prepare(db: sqlite3.Connection) -> None:
    db.execute("PRAGMA journal_mode=WAL")
    db.execute("PRAGMA synchronous=NORMAL")
    # One transaction, so that a store that has tables also has its schema.
    db.executescript(
        f"BEGIN IMMEDIATE; {_TABLES} "
        f"INSERT OR IGNORE INTO meta VALUES ('schema', CAST('{SCHEMA}' AS BLOB)); COMMIT;"
    )


def add_invocations(db: sqlite3.Connection) -> None:
    """Give samples of an earlier version the column of their invocation, which is not known."""
    if not db.execute(INVOCATIONS).fetchone():
        db.execute("ALTER TABLE samples ADD COLUMN invocation INTEGER")


def open_to_read(path: Path) -> sqlite3.Connection:
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


def check_schema(db: sqlite3.Connection, path: Path) -> None:
    has_meta = db.execute("SELECT 1 FROM sqlite_master WHERE name = 'meta'").fetchone()
    row = has_meta and db.execute("SELECT value FROM meta WHERE name = 'schema'").fetchone()
    if not row:
        raise StoreError(f"{path} is no stepbench store (it has no schema); {WAY_OUT}.")
    # Compared as text: a damaged version may be no number.
    found = clean(row[0].decode(errors="replace") if isinstance(row[0], bytes) else str(row[0]))
    if found != str(SCHEMA):
        raise StoreError(
            f"The store {path} has schema {found}, this version reads {SCHEMA}; {WAY_OUT}."
        )
