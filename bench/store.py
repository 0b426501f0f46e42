"""The store: one SQLite file (write-ahead log) per run folder, written row by row.

Only the process that plans writes to it. Each finished cell is one transaction, so that a run
killed at any moment has lost nothing but the cell in work.
"""

from __future__ import annotations

import sqlite3
from pathlib import Path

import msgspec

from bench.records import SCHEMA, Environment, Plan, Record, Rows, SceneRecord

FILE = "stepbench.sqlite"

_TABLES = """
CREATE TABLE IF NOT EXISTS meta (name TEXT PRIMARY KEY, value BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS environments (id INTEGER PRIMARY KEY, value BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS scenes (
    problem TEXT, t_end REAL, value BLOB NOT NULL, PRIMARY KEY (problem, t_end));
CREATE TABLE IF NOT EXISTS records (
    key TEXT PRIMARY KEY, problem TEXT NOT NULL, integrator TEXT NOT NULL, status TEXT NOT NULL,
    value BLOB NOT NULL, rows BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS samples (
    key TEXT NOT NULL REFERENCES records(key), number INTEGER NOT NULL, seconds REAL NOT NULL,
    PRIMARY KEY (key, number));
"""


class StoreError(RuntimeError):
    """The folder has no readable store, or the store cannot be written."""


class Store:
    """Open the store in a folder.

    Parameters
    ----------
    folder
        The run folder.
    create
        Make the folder and the store if they are not there.

    Raises
    ------
    StoreError
        If there is no store (without ``create``), it cannot be read or written, or it was
        written by another version of the schema.
    """

    def __init__(self, folder: Path, create: bool = False) -> None:
        self.folder = Path(folder)
        path = self.folder / FILE
        if not create and not path.is_file():
            raise StoreError(
                f"{self.folder} holds no stepbench results; run 'stepbench run' first."
            )
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._db = sqlite3.connect(path, isolation_level=None, timeout=30.0)
            self._db.execute("PRAGMA journal_mode=WAL")
            self._db.execute("PRAGMA synchronous=NORMAL")
            self._db.executescript(_TABLES)
            self._db.execute(
                "INSERT OR IGNORE INTO meta VALUES ('schema', ?)", (str(SCHEMA).encode(),)
            )
            found = int(self._value("SELECT value FROM meta WHERE name = 'schema'"))
        except (OSError, sqlite3.Error, ValueError) as error:
            raise StoreError(f"The store {path} cannot be opened: {error}.") from error
        if found != SCHEMA:
            raise StoreError(
                f"The store {path} has schema {found}, this version reads {SCHEMA}; "
                f"start anew with --fresh or another --out."
            )

    def close(self) -> None:
        """Close the file; the write-ahead log is folded in."""
        self._db.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # ---- writing -----------------------------------------------------------------------
    def clear(self) -> None:
        """Forget everything that was measured (``--fresh``)."""
        with self._transaction():
            for table in ("samples", "records", "scenes", "environments"):
                self._db.execute(f"DELETE FROM {table}")

    def save_plan(self, plan: Plan) -> None:
        """Keep the plan that the report follows."""
        self._write("INSERT OR REPLACE INTO meta VALUES ('plan', ?)", msgspec.json.encode(plan))

    def save_environment(self, environment: Environment) -> int:
        """Keep the environment of an invocation; returns its number."""
        self._write("INSERT INTO environments (value) VALUES (?)", msgspec.json.encode(environment))
        return int(self._value("SELECT MAX(id) FROM environments"))

    def save_scene(self, scene: SceneRecord) -> None:
        """Keep a scene's description, reference and drawings."""
        self._write(
            "INSERT OR REPLACE INTO scenes VALUES (?, ?, ?)",
            scene.problem,
            scene.t_end,
            msgspec.json.encode(scene),
        )

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
        value = self._value("SELECT value FROM meta WHERE name = 'plan'")
        return msgspec.json.decode(value, type=Plan) if value else None

    def environments(self) -> dict[int, Environment]:
        """All environments by number."""
        rows = self._db.execute("SELECT id, value FROM environments ORDER BY id")
        return {number: msgspec.json.decode(value, type=Environment) for number, value in rows}

    def scenes(self) -> dict[tuple[str, float], SceneRecord]:
        """All scenes by (problem, t_end)."""
        values = self._db.execute("SELECT value FROM scenes ORDER BY problem, t_end")
        scenes = [msgspec.json.decode(value, type=SceneRecord) for (value,) in values]
        return {(scene.problem, scene.t_end): scene for scene in scenes}

    def records(self) -> dict[str, Record]:
        """All finished cells by key, with their timing samples, in the order of the plan.

        Cells that the plan no longer has come last.
        """
        found = dict(self._db.execute("SELECT key, value FROM records ORDER BY rowid"))
        plan = self.plan()
        planned = [key for study in plan.studies for key in study.cells] if plan else []
        records = {
            key: msgspec.json.decode(found[key], type=Record)
            for key in dict.fromkeys([*planned, *found])
            if key in found
        }
        for key, seconds in self._db.execute(
            "SELECT key, seconds FROM samples ORDER BY key, number"
        ):
            records[key].run_s.append(seconds)
        return records

    def rows(self, key: str) -> Rows:
        """The sampled values of a cell.

        Raises
        ------
        KeyError
            If the cell is not there.
        """
        value = self._value("SELECT rows FROM records WHERE key = ?", key)
        if value is None:
            raise KeyError(key)
        return msgspec.json.decode(value, type=Rows)

    # ---- plumbing ----------------------------------------------------------------------
    def _value(self, sql: str, *parameters: object) -> bytes | None:
        row = self._db.execute(sql, parameters).fetchone()
        return row[0] if row else None

    def _write(self, sql: str, *parameters: object) -> None:
        try:
            self._db.execute(sql, parameters)
        except sqlite3.Error as error:
            raise self._unwritable(error) from error

    def _transaction(self) -> _Transaction:
        return _Transaction(self)

    def _unwritable(self, error: sqlite3.Error) -> StoreError:
        return StoreError(
            f"The store in {self.folder} cannot be written ({error}); free some space or choose "
            f"another --out. What was stored before is intact."
        )


class _Transaction:
    """All or nothing, with the store's own error."""

    def __init__(self, store: Store) -> None:
        self._store = store

    def __enter__(self) -> None:
        try:
            self._store._db.execute("BEGIN IMMEDIATE")
        except sqlite3.Error as error:
            raise self._store._unwritable(error) from error

    def __exit__(self, kind: type | None, error: BaseException | None, _: object) -> None:
        db = self._store._db
        try:
            db.execute("ROLLBACK" if kind else "COMMIT")
        except sqlite3.Error as failure:
            if db.in_transaction:
                db.execute("ROLLBACK")
            raise self._store._unwritable(failure) from failure
        if isinstance(error, sqlite3.Error):
            raise self._store._unwritable(error) from error
