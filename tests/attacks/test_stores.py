"""Attacks on stores: a spoilt row costs itself alone.

Every command gives all others, and says what is left out.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import pytest
from stores import METHOD, PLACES, change, content

from bench.results.store import FILE, Store
from bench.running.session import missing_cells

# ---- one spoilt row ----------------------------------------------------------------------
DAMAGES: dict[str, Callable[[bytes], object]] = {
    "not JSON": lambda raw: b"{" + raw,
    "cut": lambda raw: raw[: len(raw) // 2],
    "another type": lambda raw: b"[1]",
    "null": lambda raw: b"null",
    "no fields": lambda raw: b"{}",
    "text for a number": lambda raw: raw.replace(b"1.0", b'"one"').replace(b"0.1", b'"x"'),
    "not UTF-8": lambda raw: raw.replace(b'":', b'\xff\xfe":', 1),
    "empty": lambda raw: b"",
    "zeros": lambda raw: bytes(len(raw)),
    "a number": lambda raw: 7,
    "huge": lambda raw: b"[" * 2_000_000,
    "deep": lambda raw: b'{"x":' * 100_000 + b"1" + b"}" * 100_000,
}


def spoil(folder: Path, kind: str, damage: str) -> None:
    table, column, where = PLACES[kind]
    with closing(sqlite3.connect(folder / FILE)) as db, db:
        (raw,) = db.execute(f"SELECT {column} FROM {table} WHERE {where}").fetchone()
        spoilt = DAMAGES[damage](raw)
        assert spoilt != raw
        db.execute(f"UPDATE {table} SET {column} = ? WHERE {where}", (spoilt,))


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("kind", PLACES)
def test_one_spoilt_row_costs_itself_alone(whole: dict, folder: Path, kind: str, damage: str):
    spoil(folder, kind, damage)
    before, after = whole, content(folder)
    lost = {k: [key for key in before[k] if key not in after[k]] for k in before}
    # The sampled values of a record that cannot be read are not asked for.
    assert {k for k, keys in lost.items() if keys} == {kind} | (
        {"rows"} & {kind, "rows"} if (kind == "records") else set()
    )
    assert len(lost[kind]) == 1
    for k, rows in after.items():
        assert rows == {key: before[k][key] for key in rows}
    with Store(folder) as store:
        assert [row.table for row in store.set_aside()] == [kind]


def told(result, folder: Path) -> None:
    """The command went on and said what is left out."""
    assert result.exit_code == 0, result.output
    assert "Traceback" not in result.output
    assert f"{folder}: 1 row of the store cannot be read and left out" in result.stderr


@pytest.mark.parametrize(
    ("kind", "damage"),
    [
        pytest.param(kind, damage, marks=() if quick else pytest.mark.attack)
        for k, kind in enumerate(PLACES)
        for j, damage in enumerate(DAMAGES)
        for quick in [j == k]
    ],
)
def test_commands_give_all_other_rows(good, folder, tmp_path, stepbench, kind, damage):
    spoil(folder, kind, damage)
    keys = set(content(folder)["records"])
    as_json = stepbench("export", folder, "--json")
    told(as_json, folder)
    assert {row["key"] for row in json.loads(as_json.stdout)} == keys
    as_csv = stepbench("export", folder, "-o", tmp_path / "a.csv")
    told(as_csv, folder)
    compared = stepbench("compare", good, folder, "--json")
    told(compared, folder)
    assert json.loads(compared.stdout)["shared"] == len(keys)
    merged = stepbench("merge", folder, folder, "--out", tmp_path / "all")
    told(merged, folder)
    assert set(content(tmp_path / "all")["records"]) == keys
    figure = stepbench(
        *("figure", folder, "convergence", "--scene", "pendulum", "-o", tmp_path / "a.json")
    )
    told(figure, folder)


@pytest.mark.attack
@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("kind", PLACES)
def test_pages_say_what_is_left_out(folder, stepbench, kind, damage):
    spoil(folder, kind, damage)
    told(stepbench("report", folder), folder)
    for name in ("report.html", "report.md"):
        text = (folder / name).read_text(encoding="utf-8")
        assert text.index("1 row of the store cannot be read") < text.index(
            'id="answer-head"' if name.endswith("html") else "## Answer"
        )


@pytest.mark.parametrize("kind", ["records", "rows"])
def test_a_run_measures_spoilt_cells_anew(folder: Path, kind: str):
    spoil(folder, kind, "cut")
    with Store(folder) as store:
        names = [*store.records(), f"pendulum | {METHOD} | h=0.1"]
        cells = {
            key: SimpleNamespace(key=key, fingerprint=lambda registry: "")
            for key in sorted({*names})
        }
        plan = SimpleNamespace(budget_s=1.0)
        suite = SimpleNamespace(cells=cells, plan=plan, memory_gib=4.0)
        missing = missing_cells(suite, store, None)  # type: ignore[arg-type]
    assert [cell.key for cell in missing] == [f"pendulum | {METHOD} | h=0.1"]


SPOILT_SAMPLES = {
    "text": "INSERT OR REPLACE INTO samples SELECT key, 0, 'soon', NULL FROM records LIMIT 1",
    "negative": "INSERT OR REPLACE INTO samples SELECT key, 0, -1.0, NULL FROM records LIMIT 1",
    "zero": "INSERT OR REPLACE INTO samples SELECT key, 0, 0, NULL FROM records LIMIT 1",
    "infinite": "INSERT OR REPLACE INTO samples SELECT key, 0, 9e999, NULL FROM records LIMIT 1",
    "blob": "INSERT OR REPLACE INTO samples SELECT key, 0, x'ff', NULL FROM records LIMIT 1",
    "number is text": "INSERT INTO samples SELECT key, 'first', 1.0, NULL FROM records LIMIT 1",
    "orphan": "INSERT INTO samples VALUES ('nobody', 0, 1.0, NULL)",
    "orphan of a blob": "INSERT INTO samples VALUES (x'fffe', 0, 1.0, NULL)",
}


@pytest.mark.parametrize("how", SPOILT_SAMPLES)
def test_a_spoilt_sample_costs_itself_alone(whole, folder, stepbench, how):
    change(folder, SPOILT_SAMPLES[how])
    told(stepbench("export", folder, "--json"), folder)
    before, after = whole["records"], content(folder)["records"]
    assert list(after) == list(before)
    lost = sum(len(before[key].run_s) - len(after[key].run_s) for key in before)
    assert lost == (0 if "orphan" in how or how == "number is text" else 1)


SPOILT_KEYS = {
    "null": "UPDATE records SET key = NULL WHERE rowid = 1",
    "blob": "UPDATE records SET key = x'ff00' WHERE rowid = 1",
    "not UTF-8": "UPDATE records SET key = CAST(x'ff61' AS TEXT) WHERE rowid = 1",
    "another": "UPDATE records SET key = 'other' WHERE rowid = 1",
    "control characters": "UPDATE records SET key = 'a' || char(27) || 'b' WHERE rowid = 1",
    "empty": "UPDATE records SET key = '' WHERE rowid = 1",
}


@pytest.mark.parametrize("how", SPOILT_KEYS)
def test_a_spoilt_key_costs_its_row_alone(whole, folder, stepbench, how):
    change(folder, "DELETE FROM samples WHERE key = (SELECT key FROM records WHERE rowid = 1)")
    change(folder, SPOILT_KEYS[how])
    result = stepbench("export", folder, "--json")
    told(result, folder)
    assert len(json.loads(result.stdout)) == len(whole["records"]) - 1
    assert "\x1b" not in result.output


@pytest.mark.parametrize("damage", ["empty file", "half a file", "noise", "no tables", "schema"])
def test_a_file_that_is_no_store_is_one_sentence(folder, stepbench, damage):
    path = folder / FILE
    whole = path.read_bytes()
    if damage == "schema":
        change(folder, "UPDATE meta SET value = x'ff1b' WHERE name = 'schema'")
    elif damage == "no tables":
        change(folder, "DROP TABLE records")
    else:
        damaged = {
            "empty file": b"",
            "half a file": whole[: len(whole) // 3],
            "noise": b"\x1b" * 9999,
        }
        path.write_bytes(damaged[damage])
    for command in (("export", folder), ("compare", folder, folder), ("report", folder)):
        result = stepbench(*command)
        assert result.exit_code == 1
        assert "Traceback" not in result.output
        assert "--fresh" in result.output
        assert "\x1b" not in result.output
