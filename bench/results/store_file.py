"""The file of a store: its lock, opening it to read, and values as JSON."""

from __future__ import annotations

import errno
import json
import sqlite3
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import msgspec

from problems.plain_text import clean, clean_json

if TYPE_CHECKING:
    from filelock import FileLock

T = TypeVar("T")

FILE = "stepbench.sqlite"
WAY_OUT = "start again with --fresh or another --out"
#: Locked by whoever writes; the system takes the lock away from a process that ends in any way.
#: Not the database itself, whose own locks SQLite would lose when another file object is closed.
_LOCK = ".stepbench.lock"
#: Most characters of a reason.
_LONGEST = 200


class StoreError(RuntimeError):
    """The folder has no readable store, or the store cannot be written."""


class Unreadable(ValueError):
    """A value that is not what the store holds; the message says why."""


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


def opened_to_read(path: Path) -> sqlite3.Connection:
    """Open a file that must not change, also in a folder that cannot be written."""
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


def decoded(raw: bytes, kind: type[T]) -> T:
    """Read a value.

    Raises
    ------
    Unreadable
        If it is not of this kind.
    """
    try:
        return msgspec.json.decode(raw, type=kind)
    except (msgspec.DecodeError, UnicodeError, TypeError, RecursionError) as error:
        raise Unreadable(clean(str(error))[:_LONGEST]) from None


def encoded(value: object) -> bytes:
    """Write a value, with clean text, so that it can be read again.

    Raises
    ------
    Unreadable
        If it could not be read.
    """
    try:
        raw = msgspec.json.encode(value)
    except UnicodeEncodeError:  # half a surrogate pair, as of a path that is not UTF-8
        raw = clean(json.dumps(msgspec.to_builtins(value), ensure_ascii=False)).encode()
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise Unreadable(clean(str(error))[:_LONGEST]) from None
    raw = clean_json(raw)
    decoded(raw, type(value))
    return raw
