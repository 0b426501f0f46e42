"""Parts of an ensemble that are kept: never those of another one, and no half files."""

from __future__ import annotations

import errno
import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from test_shards import COUNT, asked, run_all, whole  # noqa: F401 - a fixture

from bench.results.store_file import StoreError
from bench.sweeps import parts
from bench.sweeps.member_files import write_members
from bench.sweeps.parts import KeptParts, TemporaryParts


def part(values):
    return {"member": np.arange(2), "status": np.array(["ok", "ok"]), "q1": np.array(values)}


def test_parts_of_an_unknown_ensemble_are_not_taken(tmp_path):
    kept = KeptParts(tmp_path / "parts", {"seed": 1})
    kept.put(0, part([1.0, 2.0]))
    (tmp_path / "parts" / "ensemble.json").unlink()
    del kept
    assert KeptParts(tmp_path / "parts", {"seed": 2}).numbers() == set()


def test_one_wrong_bit_costs_its_own_part(tmp_path):
    folder = tmp_path / "parts"
    kept = KeptParts(folder, {})
    for k in (0, 1):
        kept.put(k, part([1.0, 2.0]))
    file = kept.opened(0)
    del kept
    good = file.read_bytes()
    for bit in range(0, 8 * len(good), 8 * len(good) // 97):
        wrong = bytearray(good)
        wrong[bit // 8] ^= 1 << bit % 8
        file.write_bytes(wrong)
        assert KeptParts(folder, {}).numbers() == {1}, bit


def test_an_ensemble_that_cannot_be_read_is_made_anew(tmp_path):
    folder = tmp_path / "parts"
    for wrong in (b"", b"{", bytes(1000)):
        kept = KeptParts(folder, {"seed": 1})
        kept.put(0, part([1.0, 2.0]))
        del kept
        assert KeptParts(folder, {"seed": 1}).numbers() == {0}
        (folder / "ensemble.json").write_bytes(wrong)
        assert KeptParts(folder, {"seed": 1}).numbers() == set()


def test_a_removal_that_is_ended_half_way_leaves_no_unknown_parts(tmp_path, monkeypatch):
    folder = tmp_path / "parts"
    kept = KeptParts(folder, {})
    kept.put(0, part([1.0, 2.0]))

    def ended(path):
        assert not list(path.glob("part-*"))
        with pytest.raises(StoreError, match="Another run"):  # nobody writes there meanwhile
            KeptParts(path, {})
        removed(path)

    removed = shutil.rmtree
    monkeypatch.setattr(parts.shutil, "rmtree", ended)
    kept.remove()
    assert not folder.exists()
    KeptParts(folder, {}).remove()


def test_no_half_file_is_left_whatever_ends_the_writing(tmp_path, monkeypatch):
    def stopped(_):
        yield "member"
        raise MemoryError

    monkeypatch.setattr(parts, "_encoded", lambda columns: None)
    with pytest.raises(TypeError):
        KeptParts(tmp_path / "parts", {}).put(0, part([1.0, 2.0]))
    monkeypatch.setattr("bench.sweeps.member_files._TEXTS", {".csv": stopped})
    with pytest.raises(MemoryError):
        write_members(tmp_path / "members.csv", iter(()))
    left = {path.name for path in tmp_path.rglob("*") if path.is_file()}
    assert left <= {"ensemble.json", ".stepbench.lock"}


def test_files_hold_the_same_members(asked, tmp_path):  # noqa: F811
    pytest.importorskip("pyarrow")
    _, results = run_all(asked, TemporaryParts())
    names = [tmp_path / f"members{suffix}" for suffix in (".csv", ".json", ".parquet")]
    for name in names:
        write_members(name, results.parts())
    assert sorted(tmp_path.iterdir()) == sorted(names)
    rows = json.loads(names[1].read_text())
    assert [row["member"] for row in rows] == list(range(COUNT))
    table = pd.read_parquet(names[2])
    assert table["q1"].tolist()[0] == rows[0]["q1"] == pd.read_csv(names[0])["q1"][0]
    for name, column in whole(results).items():
        assert [None if v != v else v for v in column.tolist()] == [row[name] for row in rows]
        shown = table[name].astype(object).where(table[name].notna(), None)
        assert shown.tolist() == [row[name] for row in rows]
    assert names[0].read_text().count("\n") == COUNT + 1


def test_a_full_disk_leaves_no_half_part(asked, tmp_path, monkeypatch):  # noqa: F811
    kept = KeptParts(tmp_path / "parts", {})
    written = Path.write_bytes

    def full(path, content):
        written(path, content[:100])
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space left"):
        run_all(asked, kept)
    assert not list((tmp_path / "parts").glob("*.n*"))
    with pytest.raises(OSError, match="No space left"):
        write_members(tmp_path / "m.csv", _fails())
    assert not list(tmp_path.glob("m.csv*"))


def _fails():
    yield {"member": np.arange(2)}
    raise OSError(errno.ENOSPC, "No space left on device")
