"""The store: one SQLite file per run folder.

All results are rows of one table: kind (the name of a record's class), key, and the value as
compressed JSON. A new study needs no other table. Only the process that plans writes. Each finished
cell, and each timing sample, is one transaction, so that a run killed at any moment has lost
nothing but the work in hand.
"""

from __future__ import annotations

import sqlite3
import zlib
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from bench.results.records import SCHEMA, Environment, Plan, Record, Rows, SceneRecord
from bench.results.studies import ExperimentResult, LongRun
from bench.results.timings import by_round

T = TypeVar("T")

FILE = "stepbench.sqlite"
#: Locked by whoever writes; the system takes the lock away from a process that ends in any way.
#: Not the database itself, whose own locks SQLite would lose when another file object is closed.
_LOCK = ".stepbench.lock"
_WAY_OUT = "start again with --fresh or another --out."
_TABLES = f"""
BEGIN IMMEDIATE;
CREATE TABLE results (kind TEXT, key TEXT, value BLOB NOT NULL, PRIMARY KEY (kind, key));
PRAGMA user_version = {SCHEMA};
COMMIT;
"""
_KEEP = "INSERT OR REPLACE INTO results VALUES (?, ?, ?)"
#: The last of all keys, or of those that begin with the same text.
_LAST = "\U0010ffff"
#: Keys of values that are kept by themselves.
_KEYS = {
    Plan: lambda plan: "plan",
    Environment: lambda machine: str(machine.number),
    SceneRecord: lambda scene: f"{scene.problem} | {scene.t_end!r}",
    ExperimentResult: lambda found: found.name,
    LongRun: lambda run: run.key,
}
#: What a file, its rows, or a value that no JSON can hold may raise.
_ERRORS = (
    *(OSError, sqlite3.Error, zlib.error, msgspec.MsgspecError),
    *(ValueError, TypeError, OverflowError),
)
#: Significant digits of sampled values, which charts show with fewer. Sampled values are most of a
#: store, and their last digits are noise, which no compression makes smaller.
_DIGITS = 8


class StoreError(RuntimeError):
    """The folder has no readable store, or the store cannot be written."""


class Store(ExitStack):
    """Open the store in a folder; ``close`` or the end of a ``with`` closes its file.

    Parameters
    ----------
    folder
        The run folder.
    create
        Open for writing, and make the folder and the store if they are not there. Without it
        the store is only read, and nothing in the folder changes.
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
        super().__init__()
        self.folder = Path(folder)
        self._path = self.folder / FILE
        if not create and not self._path.is_file():
            raise StoreError(
                f"{self.folder} holds no stepbench results; run 'stepbench run' first."
            )
        with ExitStack() as opened:
            with self._errors(f"The store {self._path} cannot be opened"):
                if create:
                    self._lock(opened)
                if fresh:
                    # The file goes last: a log left without its file would meet the new one.
                    for suffix in ("-wal", "-shm", "-journal", ""):
                        self._path.with_name(FILE + suffix).unlink(missing_ok=True)
                uri = f"{self._path.absolute().as_uri()}?mode={'rwc' if create else 'ro'}"
                self._db = sqlite3.connect(uri, uri=True, isolation_level=None, timeout=30.0)
                opened.callback(self._db.close)
                if create:
                    self._db.execute("PRAGMA journal_mode=WAL")
                    opened.callback(self._fold_log)
                    self._db.execute("PRAGMA synchronous=NORMAL")
                    if not self._db.execute("SELECT 1 FROM sqlite_master").fetchone():
                        self._db.executescript(_TABLES)
                (version,) = self._db.execute("PRAGMA user_version").fetchone()
            if version != SCHEMA:
                raise StoreError(
                    f"{self._path} is no stepbench store of this version (its schema is {version}, "
                    f"not {SCHEMA}); {_WAY_OUT}"
                )
            self.enter_context(opened.pop_all())

    # ---- writing -----------------------------------------------------------------------
    def keep(self, value: Any) -> None:
        """Keep an environment, a plan, a scene or the result of a study, in the place of an earlier
        one of its kind and key; raise StoreError if it could not be read again."""
        self._put([(_KEYS[type(value)](value), value)])

    def save(self, record: Record, rows: Rows) -> None:
        """Keep a finished cell, in one transaction.

        Of the runs of a method that differ in nothing but the size of their steps or tolerances,
        the rows of one are kept, which pages draw: the finest that reached the end, if any did.
        """
        first = f"{record.problem} | {record.integrator} | "
        beside = [
            other
            for other in self.values(Record, first, first + _LAST).values()
            if (other.t_end, other.pattern) == (record.t_end, record.pattern)
        ]
        own = [other for other in beside if other.fingerprint == record.fingerprint]
        if finest := all(_rank(other) <= _rank(record) for other in own if other.key != record.key):
            rows = Rows(t=_short(rows.t), values=_short(rows.values), notes=_short(rows.notes))
        forgotten = [record.key, *(other.key for other in beside if finest)]
        self._put([(record.key, rows)] * finest + [(record.key, record)], forgotten)

    def add_sample(
        self, key: str, number: int, seconds: float, invocation: int | None = None
    ) -> None:
        """Keep one timing sample of a cell: its round, in an invocation (None: the cell's own)."""
        record = self.values(Record, key, key)[key]
        place = record.environment if invocation is None else invocation, number
        taken = by_round(record) | {place: seconds}
        record.rounds = sorted(taken, key=lambda place: place[1])
        record.run_s = [taken[place] for place in record.rounds]
        self._put([(key, record)])

    # ---- reading -----------------------------------------------------------------------
    def values(self, kind: type[T], first: str = "", last: str = _LAST) -> dict[str, T]:
        """Return the values of a kind with keys from ``first`` to ``last``, in the order in which
        they were kept."""
        select = "SELECT key, value FROM results WHERE kind = ? AND key BETWEEN ? AND ?"
        with self._errors(f"A {kind.__name__} in the store {self._path} cannot be read"):
            rows = self._db.execute(f"{select} ORDER BY rowid", (kind.__name__, first, last))
            return {k: msgspec.json.decode(zlib.decompress(raw), type=kind) for k, raw in rows}

    def plan(self) -> Plan | None:
        """The plan of the latest run, or None."""
        return self.values(Plan).get("plan")

    def environments(self) -> dict[int, Environment]:
        """All environments by number, the latest last."""
        return {int(number): value for number, value in self.values(Environment).items()}

    def scenes(self) -> dict[tuple[str, float], SceneRecord]:
        """All scenes by (problem, t_end), in this order."""
        found = {(s.problem, s.t_end): s for s in self.values(SceneRecord).values()}
        return dict(sorted(found.items()))

    def experiments(self) -> dict[str, ExperimentResult]:
        """Results of the experiments of the atlas by name, in the order of their numbers."""
        found = self.values(ExperimentResult)
        return dict(sorted(found.items(), key=lambda pair: pair[1].number))

    def records(self) -> dict[str, Record]:
        """All finished cells by key, in the order of the plan; others come last."""
        found, plan = self.values(Record), self.plan()
        planned = [key for study in plan.studies for key in study.cells] if plan else []
        return {key: found[key] for key in dict.fromkeys([*planned, *found]) if key in found}

    def rows(self, key: str) -> Rows:
        """The sampled values of a cell, if they are kept."""
        return self.values(Rows, key, key).get(key) or Rows(t=[])

    # ---- parts -------------------------------------------------------------------------
    def _lock(self, opened: ExitStack) -> None:
        """Make the folder, and lock it."""
        from filelock import FileLock, Timeout  # not needed to read, and slow to import

        self.folder.mkdir(parents=True, exist_ok=True)
        try:
            opened.enter_context(FileLock(self.folder / _LOCK, timeout=0))
        except Timeout:
            raise StoreError(
                f"Another run is writing into {self.folder}; wait for its end, or give another "
                f"--out."
            ) from None

    def _fold_log(self) -> None:
        """Leave one file that can be read where nothing can be written, unless somebody reads."""
        with suppress(sqlite3.Error):
            self._db.execute("PRAGMA busy_timeout=0")
            self._db.execute("PRAGMA journal_mode=DELETE")

    def _put(self, values: Iterable[tuple[str, Any]], forgotten: Iterable[str] = ()) -> None:
        """Keep values by key; forget the rows of some cells."""
        words = "Earlier results are intact."
        with self._errors(f"A result cannot be stored in {self.folder}", words):
            kept = []
            for key, value in values:
                text = msgspec.json.encode(value)
                msgspec.json.decode(text, type=type(value))  # it has to be read again
                kept.append((type(value).__name__, key, zlib.compress(text, 9)))
        advice = "free some space or choose another --out. Earlier results are intact."
        with self._errors(f"The store in {self.folder} cannot be written", advice), self._db as db:
            db.execute("BEGIN IMMEDIATE")
            delete = "DELETE FROM results WHERE kind = 'Rows' AND key = ?"
            db.executemany(delete, [(key,) for key in forgotten])
            db.executemany(_KEEP, kept)

    @contextmanager
    def _errors(self, words: str, advice: str = _WAY_OUT) -> Iterator[None]:
        """Tell every error in a sentence."""
        try:
            yield
        except _ERRORS as error:
            raise StoreError(f"{words} ({error}); {advice}") from error


def _rank(record: Record) -> tuple[bool, float]:
    """Order runs: those that reached the end last, and from coarse to fine."""
    return record.status == "ok", -record.size


def _short(values: Any) -> Any:
    """Sampled values with `_DIGITS` significant digits."""
    if isinstance(values, dict):
        return {name: _short(own) for name, own in values.items()}
    if isinstance(values, list):
        return [_short(own) for own in values]
    return float(f"{values:.{_DIGITS}g}") if isinstance(values, float) else values
