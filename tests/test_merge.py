"""Merging results of several folders."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from planted import MACHINE, STEPS, edited, everything, plant, planted
from small_stores import filled

from bench.results.folders import merge
from bench.results.records import Record
from bench.results.store import FILE, Store

FREE = {"q": (1.0, 2), "a": (3.0, 2)}


@pytest.fixture
def old(tmp_path: Path) -> Path:
    return plant(tmp_path / "old", everything())


def elsewhere(folder: Path, runs: list[Record], cpu: str, **more: object) -> Path:
    """Results of another machine; their store has that of all tests, too."""
    machine = msgspec.structs.replace(MACHINE, cpu=cpu)
    for record in runs:
        record.environment = machine.number
    plant(folder, runs, **more)
    with Store(folder, create=True) as store:
        store.keep(machine)
    return folder


def test_merged_results_keep_their_machine_samples_rows_and_scenes(tmp_path, stepbench):
    runs = [
        [planted(scene, "m", FREE, h=h) for h in STEPS] for scene in ("spring_mass", "pendulum")
    ]
    folders = [elsewhere(tmp_path / cpu, own, cpu) for cpu, own in zip("AB", runs, strict=True)]
    with Store(folders[1], create=True) as store:  # the machine of all tests takes a sample there
        store.add_sample(runs[1][0].key, 7, 1e-3, MACHINE.number)
    out = tmp_path / "deep" / "both"
    result = stepbench("merge", *folders, "--out", out)
    assert result.exit_code == 0, result.output
    assert [file.name for file in out.iterdir()] == [FILE]
    with Store(out) as store:
        environments, merged = store.environments(), store.records()
        assert set(store.scenes()) == {("spring_mass", 1.0), ("pendulum", 1.0)}
        assert [s.problem for s in store.plan().studies] == ["spring_mass", "pendulum"]
        for folder in folders:
            with Store(folder) as origin:
                for key, record in origin.records().items():
                    assert environments[merged[key].environment].cpu == folder.name
                    assert merged[key] == record
                    assert store.rows(key) == origin.rows(key)
    assert len(merged) == 2 * len(STEPS)
    assert merged[runs[1][0].key].rounds[-1] == (MACHINE.number, 7)
    # The invocation that both stores begin with is one; those of the machines are apart.
    assert sorted(e.cpu for e in environments.values()) == ["A", "B", "Model 1"]


def test_of_a_run_or_a_scene_in_two_folders_that_of_the_last_one_is_kept(tmp_path):
    folders = []
    for n in range(3):
        run = planted("pendulum", "m", FREE, h=0.1, work={"steps": n})
        run.status = "interrupted" if n == 2 else "ok"
        folders.append(plant(tmp_path / str(n), [run], samples=2 - n))
        with Store(folders[-1], create=True) as store:
            (scene,) = store.scenes().values()
            store.keep(msgspec.structs.replace(scene, title=str(n)))
    # What was interrupted gives way, in whatever order.
    for place, order, kept in (("out", folders, 1), ("back", folders[::-1], 0)):
        assert merge(order, tmp_path / place) == (1, 1)
        with Store(tmp_path / place) as store:
            (record,), (scene,) = store.records().values(), store.scenes().values()
        assert (record.work, record.status) == ({"steps": kept}, "ok")
        assert (len(record.run_s), scene.title) == (2 - kept, "0" if place == "back" else "2")


def test_plans_become_one_with_the_most_samples_and_the_largest_budget(tmp_path):
    runs = [planted("pendulum", name, FREE, h=0.1) for name in ("one", "two", "three")]
    folders = [plant(tmp_path / "1", runs[:2]), plant(tmp_path / "2", runs[1:])]
    for folder, most in zip(folders, (3, 9), strict=True):
        with Store(folder, create=True) as store:
            store.keep(msgspec.structs.replace(store.plan(), samples=most, budget_s=10.0 * most))
    bare = [plant(tmp_path / r.integrator, [r], plan=False) for r in runs[:2]]
    for given, planned in ((folders, True), (bare, False)):
        merge(given, out := tmp_path / f"out {planned}")
        with Store(out) as store:
            plan = store.plan()
            assert len(store.records()) == 2 + planned
        assert (plan is not None) == planned
        if plan:
            assert (plan.samples, plan.budget_s, len(plan.studies)) == (9, 90.0, 1)
            assert plan.studies[0].cells == [r.key for r in runs]


def test_merging_with_oneself_changes_nothing_and_all_kinds_are_merged(old, tmp_path):
    merge([old, old], tmp_path / "out")
    with Store(old) as one, Store(tmp_path / "out") as two:
        for kind in ("plan", "scenes", "records", "environments"):
            assert getattr(one, kind)() == getattr(two, kind)()
    merge([old, filled(tmp_path / "one_of_each")], tmp_path / "all")
    with Store(tmp_path / "all") as store, Store(tmp_path / "one_of_each") as origin:
        for kind in ("long_runs", "experiments"):
            assert (found := getattr(origin, kind)())
            assert found.items() <= getattr(store, kind)().items()


def test_merge_refuses_and_leaves_everything_as_it_is(old, tmp_path, refused):
    bad = edited(old, "bad", lambda record: None)
    with Store(bad, create=True) as store:
        store._db.execute("DROP TABLE results")
    before = (old / FILE).read_bytes()
    for arguments, words in (
        ([old, "--out", tmp_path / "x"], "two folders or more"),
        ([old, old, "--out", old], f"{old} holds results already"),
        ([old, tmp_path / "none", "--out", tmp_path / "x"], "holds no stepbench results"),
        ([old, bad, "--out", tmp_path / "x"], "cannot be read"),
    ):
        assert words in refused("merge", *arguments)
    assert (old / FILE).read_bytes() == before
    assert not (tmp_path / "x").exists()
