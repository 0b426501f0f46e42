"""Answers of shards: what is stored, what is run again, and what is about something else."""

from __future__ import annotations

import errno
import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from test_shards import (  # noqa: F401 - a fixture
    COUNT,
    KILLED,
    REGISTRY,
    Here,
    Quiet,
    asked,
    run_all,
    whole,
)

from bench.commands import sweeps as command
from bench.plugins import fingerprint
from bench.plugins.facts import Sources
from bench.results.store_file import StoreError
from bench.running.cluster import ClusterRunner
from bench.running.worker import Worker
from bench.sweeps import batch, jobs, parts, variation
from bench.sweeps.ensemble import member_rows
from bench.sweeps.parts import KeptParts, TemporaryParts, write_members
from bench.sweeps.shards import ShardRun
from bench.sweeps.variation import Quantity, Range
from problems.runtime import jax
from problems.spec import SpecError


class Changed(Here):
    """A runner whose shard of the middle has another answer."""

    def __init__(self, change):
        super().__init__()
        self.change = change

    def run(self, groups):
        for task, answer in super().run(groups):
            middle = task.job is jobs.shard_job and task.arguments[1] == 13
            yield task, self.change(answer) if middle else answer


def test_a_shard_whose_budget_did_not_last_is_run_again(asked, tmp_path, monkeypatch):  # noqa: F811
    monkeypatch.setattr(batch, "_MOST_LANES", {"cpu": 8})  # blocks of 8 of the 13 members
    short = replace(asked, budget=0.0)
    kept = KeptParts(tmp_path / "parts", {})
    run, results = run_all(short, kept)
    assert (kept.numbers(), run.lost.numbers()) == (set(), {0, 1, 2})
    assert results.statuses["budget_exceeded"] == 40 - 3 * 8
    assert "raise the budget" in results.first["budget_exceeded"][1]
    run, results = run_all(asked, kept)
    assert (kept.numbers(), run.lost.numbers()) == ({0, 1, 2}, set())
    assert "budget_exceeded" not in results.statuses


def test_a_member_that_used_up_its_own_steps_is_finished(asked):  # noqa: F811
    def of_its_own(answer):
        return replace(
            answer, status=["budget_exceeded"] * 13, message=["It took all of its max_steps."] * 13
        )

    run, results = run_all(asked, TemporaryParts(), Changed(of_its_own))
    assert run.lost.numbers() == set()
    assert results.statuses["budget_exceeded"] == 13


@pytest.mark.parametrize(
    "change",
    [
        lambda answer: replace(answer, vary=answer.vary | {"k": answer.vary["k"] * (1 + 1e-8)}),
        lambda answer: replace(answer, vary=dict(reversed(answer.vary.items()))),
        lambda answer: replace(answer, vary={"k": answer.vary["k"], "b": answer.vary["h"]}),
        lambda answer: replace(answer, vary=answer.vary | {"k": np.array(["1"] * 13)}),
        lambda answer: replace(answer, values=answer.values | {"q1": np.array(1.0)}),
        lambda answer: replace(answer, values=answer.values | {"q1": np.zeros(12)}),
        lambda answer: replace(answer, values=answer.values | {"p1": answer.values["q1"]}),
        lambda answer: replace(answer, values=dict(reversed(answer.values.items()))),
    ],
)
def test_answers_about_something_else_are_lost(asked, change):  # noqa: F811
    run, results = run_all(asked, TemporaryParts(), Changed(change))
    assert run.lost.numbers() == {1}
    assert results.first["crashed"] == (13, "Its answer is about something else than it was asked.")
    assert len(whole(results)["member"]) == 40


def test_shards_come_in_groups_and_again_alone(asked):  # noqa: F811
    runner = Here([KILLED, None, KILLED])
    run = ShardRun(runner, asked, Sources(), Quiet())
    run.complete(runner, store := TemporaryParts(), 1, 2)
    assert runner.sizes == [[1], [2, 1], [1, 1]]
    assert store.numbers() == {0, 1, 2}


@pytest.mark.parametrize(("count", "together"), [(1, 1), (15, 1), (16, 2), (1000, 16)])
def test_a_cluster_gets_groups_that_all_its_threads_share(count, together):
    pair = SimpleNamespace(_client=SimpleNamespace(nthreads=lambda: {"a": 1, "b": 1}))
    assert ClusterRunner.together(pair, count) == together


def test_jobs_are_of_this_machine_and_a_gpu_has_one(asked, monkeypatch):  # noqa: F811
    with pytest.raises(SpecError, match="leave it out with --cluster"):
        command.solve_ensemble(Sources(), asked, "", 2, "tcp://127.0.0.1:1", None, False)
    assert [command.processes(jobs, 10_000) for jobs in (None, 1, 3)] == [2, 1, 3]
    monkeypatch.setenv("JAX_PLATFORMS", "cuda")
    assert [command.processes(jobs, 10_000) for jobs in (None, 1, 3)] == [1, 1, 3]


def test_a_worker_may_round_the_draw_differently(asked):  # noqa: F811
    def rounded(answer):
        return replace(answer, vary=answer.vary | {"k": np.nextafter(answer.vary["k"], 2.0)})

    assert run_all(asked, TemporaryParts(), Changed(rounded))[0].lost.numbers() == set()


def test_the_code_of_ensembles_decides_the_members(asked, monkeypatch):  # noqa: F811
    run, _ = run_all(asked, TemporaryParts())
    before, read = run.about, fingerprint._source

    def edited(file):
        found = read(file)
        return found._replace(digest="edited") if file.samefile(variation.__file__) else found

    fingerprint.fingerprint.cache_clear()
    monkeypatch.setattr(fingerprint, "_source", edited)
    after = run.about
    fingerprint.fingerprint.cache_clear()
    assert {name for name in before if before[name] != after[name]} == {"code"}


def test_seeds_and_places_have_different_draws():
    of = Range(Quantity("k", "scene", "k"), 0.0, 1.0)
    assert (of.draw(5, 1, 0, 9) != of.draw(5 + 2**32, 0, 0, 9)).all()


def test_what_is_not_finite_is_no_value(tmp_path):
    columns = {"member": np.arange(3), "q1": np.array([1.5, np.inf, np.nan])}
    wanted = [{"member": 0, "q1": 1.5}, {"member": 1, "q1": None}, {"member": 2, "q1": None}]
    assert member_rows(columns) == wanted
    names = [tmp_path / f"members{suffix}" for suffix in (".csv", ".json", ".parquet")]
    pytest.importorskip("pyarrow")
    for name in names:
        write_members(name, iter([columns]))
    assert json.loads(names[1].read_text()) == wanted
    for table in (pd.read_csv(names[0]), pd.read_parquet(names[2])):
        assert table["q1"].isna().tolist() == [False, True, True]


def test_jax_computes_with_64_bits_or_the_ensemble_is_refused(asked, monkeypatch):  # noqa: F811
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(SpecError, match="32-bit floats"):
            jobs.plan_job(Worker(REGISTRY), asked)
    finally:
        jax.config.update("jax_enable_x64", True)

    def fails():
        raise RuntimeError

    monkeypatch.setattr(jax, "default_backend", fails)
    monkeypatch.setattr(jobs, "check_runtime", lambda: "")
    with pytest.raises(SpecError, match="JAX does not start"):
        jobs.plan_job(Worker(REGISTRY), asked)


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
    monkeypatch.setattr("bench.sweeps.parts._TEXTS", {".csv": stopped})
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
