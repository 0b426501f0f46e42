"""The store: one SQLite file (write-ahead log) per run folder, written row by row.

Only the process that plans writes to it. Each finished cell is one transaction, so that a run
killed at any moment has lost nothing but the cell in work.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import msgspec

from bench.results.drift import LongRun
from bench.results.experiments import ExperimentResult
from bench.results.records import Damping, Environment, Plan, Record, Rows, SceneRecord
from bench.results.store_file import (
    FILE,
    INVOCATIONS,
    WAY_OUT,
    add_invocations,
    check_schema,
    locked,
    open_to_read,
    prepare,
    remove,
)
from bench.results.store_file import StoreError as StoreError
from bench.results.stored_values import (
    Unreadable,
    crashed,
    decoded,
    encoded,
    storable,
    storable_or,
    undescribed,
)
from problems.plain_text import clean

if TYPE_CHECKING:
    from filelock import FileLock

T = TypeVar("T")

#: Times in s that a clock can tell.
_TIMES = 1e-12, 1e12

#: Tables that stores of earlier versions may lack.
_LATER = ("experiments", "long_runs", "damping")

#: Most rows that are named in the sentence about those set aside.
_NAMED = 3


class SetAside(NamedTuple):
    """A row that cannot be read: its table, its key, and the reason."""

    table: str
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
        self._path = path = self.folder / FILE
        opened: sqlite3.Connection | None = None
        self._lock: FileLock | None = None
        try:
            if create:
                self.folder.mkdir(parents=True, exist_ok=True)
                self._lock = locked(self.folder)
                if fresh:
                    remove(path)
                opened = sqlite3.connect(path, isolation_level=None, timeout=30.0)
                prepare(opened)
            elif path.is_file():
                opened = open_to_read(path)
            else:
                raise StoreError(
                    f"{self.folder} holds no stepbench results; run 'stepbench run' first."
                )
            check_schema(opened, path)
            if create:
                add_invocations(opened)
        except (OSError, sqlite3.Error, StoreError) as error:
            if opened is not None:
                opened.close()
            if self._lock is not None:
                self._lock.release()
            if isinstance(error, StoreError):
                raise
            raise StoreError(f"The store {path} cannot be opened ({error}); {WAY_OUT}.") from error
        # Text that is no UTF-8 costs its row, not the query.
        opened.text_factory = lambda text: text.decode(errors="replace")
        self._db = opened
        self._spoilt: dict[tuple[str, str], str] = {}

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
        """Keep the plan of a run; reports follow it. Unfit facts of integrators are left out."""
        facts = {name: facts for name, facts in plan.integrators.items() if storable(facts)}
        plan = msgspec.structs.replace(plan, integrators=facts)
        self._put("meta", "plan", self._encoded(plan))

    def save_environment(self, environment: Environment) -> int:
        """Keep the environment of an invocation; returns its number."""
        self._put("environments", None, self._encoded(environment))
        return self._read("SELECT MAX(id) FROM environments")[0][0]

    def save_scene(self, scene: SceneRecord) -> None:
        """Keep a scene's description, reference and drawings; the reason if they are unfit."""
        scene, value = storable_or(scene, lambda error: undescribed(scene, error))
        self._put("scenes", scene.problem, scene.t_end, value)

    def save_experiment(self, found: ExperimentResult) -> None:
        """Keep the result of an experiment of the atlas."""
        self._put("experiments", found.name, self._encoded(found))

    def save_long_run(self, run: LongRun) -> None:
        """Keep a long run, in the place of an earlier one with the same steps."""
        self._put("long_runs", run.key, self._encoded(run))

    def save_damping(self, integrator: str, damping: Damping | None) -> None:
        """Keep the damping of a method by its printed name; None forgets it."""
        if damping is None:
            with self._transaction() as db:
                db.execute("DELETE FROM damping WHERE integrator = ?", (clean(integrator),))
            return
        why = "It cannot be stored: {}.".format
        _, value = storable_or(damping, lambda error: Damping(omega_h=[], message=why(error)))
        self._put("damping", integrator, value)

    def save(self, record: Record, rows: Rows) -> None:
        """Keep a finished cell with its rows, in one transaction; forgets older samples.

        Sampled values that could not be read again are left out; a record that could not is kept
        as that of a crashed run. Its message says so.
        """
        try:
            sampled = encoded(rows)
        except Unreadable as error:
            sampled = encoded(Rows(t=[]))
            said = f"{record.message} Its sampled values cannot be stored: {error}."
            record = msgspec.structs.replace(record, message=said.strip())
        record, value = storable_or(record, lambda error: crashed(record, error))
        names = map(clean, (record.key, record.problem, record.integrator, record.status))
        with self._transaction() as db:
            db.execute("DELETE FROM samples WHERE key = ?", (clean(record.key),))
            row = *names, value, sampled
            db.execute("INSERT OR REPLACE INTO records VALUES (?, ?, ?, ?, ?, ?)", row)

    def add_sample(
        self, key: str, number: int, seconds: float, invocation: int | None = None
    ) -> None:
        """Keep one timing sample of a cell: its round, in an invocation (None: the cell's own)."""
        self._put("samples", key, number, seconds, invocation)

    def forget_spoilt_samples(self) -> None:
        """Forget the timing samples that cannot be read, with all others of their cells.

        Rounds of samples are taken anew as a whole, so that those of several cells stay in step.
        """
        spoilt = {(key,) for key, _, _, seconds in self._samples() if seconds is None}
        with self._transaction() as db:
            db.executemany("DELETE FROM samples WHERE key = ?", spoilt)

    # ---- reading -----------------------------------------------------------------------
    def set_aside(self) -> list[SetAside]:
        """All rows that cannot be read; the other methods pass over them."""
        self._spoilt.clear()
        readers = self.environments, self.scenes, self.experiments, self.long_runs, self.damping
        for read in (self.plan, *readers, self.records, self.keys_with_rows):
            read()
        return [SetAside(*place, reason) for place, reason in self._spoilt.items()]

    def plan(self) -> Plan | None:
        """The plan of the latest run, or None."""
        found = self._read("SELECT value FROM meta WHERE name = 'plan'")
        return self._decoded("plan", "plan", found[0][0], Plan) if found else None

    def environments(self) -> dict[int, Environment]:
        """All environments by number."""
        return self._values("environments", Environment, "id")

    def scenes(self) -> dict[tuple[str, float], SceneRecord]:
        """All scenes by (problem, t_end), in this order."""
        return dict(sorted(self._values("scenes", SceneRecord, "problem", "t_end").items()))

    def experiments(self) -> dict[str, ExperimentResult]:
        """Results of the experiments of the atlas by name, in the order of their numbers."""
        found = self._values("experiments", ExperimentResult, "name")
        return dict(sorted(found.items(), key=lambda pair: pair[1].number))

    def long_runs(self) -> dict[str, LongRun]:
        """Long runs by key, in the order in which they were kept."""
        return self._values("long_runs", LongRun, "key")

    def damping(self) -> dict[str, Damping]:
        """Damping of methods by their printed names."""
        return self._values("damping", Damping, "integrator")

    def records(self) -> dict[str, Record]:
        """All finished cells by key, with their timing samples, in the order of the plan.

        Cells that the plan no longer has come last.
        """
        # Before the records: a run that goes on meanwhile may add samples, but takes no record
        # away, so that every sample read here finds its record below.
        samples = self._samples()
        found = self._values("records", Record, "key")
        plan = self.plan()
        planned = [key for study in plan.studies for key in study.cells] if plan else []
        records = {key: found[key] for key in dict.fromkeys([*planned, *found]) if key in found}
        for record in records.values():
            record.rounds, record.run_s = [], []
        for key, invocation, number, seconds in samples:
            if key in records and seconds is not None:
                record = records[key]
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
        found = self._read("SELECT rows FROM records WHERE key = ?", key)
        if not found:
            raise KeyError(key)
        return self._decoded("rows", key, found[0][0], Rows) or Rows(t=[])

    def keys_with_rows(self) -> set[str]:
        """The keys of the cells whose sampled values can be read."""
        found = self._read("SELECT key, rows FROM records")
        return {key for key, raw in found if self._decoded("rows", str(key), raw, Rows)}

    # ---- parts -------------------------------------------------------------------------
    def _values(self, table: str, kind: type[T], *columns: str) -> dict[Any, T]:
        """The values of a table by their keys; those that cannot be read are noted."""
        if table in _LATER and not self._read("SELECT 1 FROM sqlite_master WHERE name = ?", table):
            return {}
        values = {}
        for *key, raw in self._read(
            f"SELECT {', '.join(columns)}, value FROM {table} ORDER BY rowid"
        ):
            name = ", ".join(map(str, key))
            value = self._decoded(table, name, raw, kind)
            if value is None:
                continue
            # Damping and environments do not hold their keys.
            own = [getattr(value, column, k) for column, k in zip(columns, key, strict=True)]
            if None in key or own != key:
                self._note(table, name, "its key is not that of its value")
            else:
                values[tuple(key) if len(key) > 1 else key[0]] = value
        return values

    def _samples(self) -> list[tuple[str, int | None, int, float | None]]:
        """Key, invocation, number and seconds of the timing samples; None for seconds that cannot
        be read, and where the invocation is not known."""
        samples = []
        invocations = "invocation" if self._read(INVOCATIONS) else "NULL"
        for key, owner, invocation, number, seconds in self._read(
            f"SELECT samples.key, records.key, {invocations}, number, seconds FROM samples "
            "LEFT JOIN records ON records.key = samples.key ORDER BY samples.key, number"
        ):
            known = isinstance(number, int) and isinstance(seconds, float)
            good = known and owner is not None and _TIMES[0] <= seconds <= _TIMES[1]
            if not good:
                reason = f"{str(seconds)[:40]!r} is no time in s" if owner else "it has no record"
                self._note("samples", f"{key}, number {number}", reason)
            samples.append((key, invocation, number, seconds if good else None))
        return samples

    def _decoded(self, table: str, key: str, raw: object, kind: type[T]) -> T | None:
        """A value, or None if it cannot be read, which is noted."""
        try:
            return decoded(raw, kind)
        except Unreadable as error:
            self._note(table, key, str(error))
            return None

    def _encoded(self, value: object) -> bytes:
        """JSON of a value that is the bench's own."""
        try:
            return encoded(value)
        except Unreadable as error:
            name = type(value).__name__
            raise StoreError(f"{name} cannot be stored in {self.folder}: {error}.") from None

    def _note(self, table: str, key: str, reason: str) -> None:
        self._spoilt[table, key] = reason

    def _read(self, sql: str, *parameters: object) -> list[tuple]:
        """All rows of a query."""
        try:
            return self._db.execute(sql, parameters).fetchall()
        except sqlite3.Error as error:
            text = f"The store {self._path} cannot be read ({error}); {WAY_OUT}."
            raise StoreError(text) from error

    def _put(self, table: str, *row: object) -> None:
        """Write a row in the place of that with the same key; texts are made clean."""
        values = [clean(value) if isinstance(value, str) else value for value in row]
        with self._transaction() as db:
            db.execute(
                f"INSERT OR REPLACE INTO {table} VALUES ({', '.join('?' * len(row))})", values
            )

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


def set_aside_text(found: Sequence[SetAside]) -> str:
    """Say how many rows cannot be read, and name a few; empty if all can be."""
    if not found:
        return ""
    named = [f"{row.table} {clean(row.key)[:80]!r} ({row.reason})" for row in found[:_NAMED]]
    more = [f"{len(found) - _NAMED} more"] if len(found) > _NAMED else []
    rows = "1 row" if len(found) == 1 else f"{len(found)} rows"
    return f"{rows} of the store cannot be read and left out: {'; '.join([*named, *more])}."
