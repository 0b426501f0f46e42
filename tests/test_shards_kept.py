"""Parts of an ensemble that are kept: never those of another one, and no half files."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from bench.results.store_file import StoreError
from bench.sweeps import parts
from bench.sweeps.member_files import write_members
from bench.sweeps.parts import KeptParts


def part(values):
    return {"member": np.arange(2), "status": np.array(["ok", "ok"]), "q1": np.array(values)}


def test_parts_of_an_unknown_ensemble_are_not_taken(tmp_path):
    kept = KeptParts(tmp_path / "parts", {"seed": 1})
    kept.put(0, part([1.0, 2.0]))
    (tmp_path / "parts" / "ensemble.json").unlink()
    del kept
    assert KeptParts(tmp_path / "parts", {"seed": 2}).numbers() == set()


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

    monkeypatch.setattr(parts, "_encoded", lambda columns: "no bytes")
    with pytest.raises(TypeError):
        KeptParts(tmp_path / "parts", {}).put(0, part([1.0, 2.0]))
    monkeypatch.setattr("bench.sweeps.member_files._TEXTS", {".csv": stopped})
    with pytest.raises(MemoryError):
        write_members(tmp_path / "members.csv", iter(()))
    assert not list(tmp_path.glob("**/*.new"))
