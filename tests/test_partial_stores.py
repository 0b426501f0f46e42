"""Reports of stores that lack something, and results of several folders merged."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import pytest
from chromium import each, visit
from planted import (
    MACHINE,
    STEPS,
    Document,
    edited,
    everything,
    plant,
    planted,
    some,
    whole_markdown,
    whole_report,
)
from small_stores import filled

from bench.results.folders import merge
from bench.results.records import Record, Rows, Study
from bench.results.store import FILE, Store
from bench.running.measure import stored_rows
from reports.pages.html_report import write_html_report
from reports.pages.markdown_report import write_markdown_report
from reports.pages.report import read_report


def failed_only() -> list[Record]:
    return [r for r in everything() if r.status != "ok"]


def test_a_partial_store_shows_what_is_there_and_says_what_is_missing(tmp_path: Path) -> None:
    for k, (records, how, said) in enumerate(
        [
            ([], {"plan": False}, "The store holds no finished run."),
            (some(), {"plan": False}, "The store holds no plan"),
            (failed_only(), {}, "No run reached the end"),
            (some(), {"samples": 0}, "Without timing samples: 5 of 5 runs that reached the end."),
        ]
    ):
        folder = plant(tmp_path / str(k), records, **how)
        assert any(sentence.startswith(said) for sentence in read_report(folder).missing), said
        if "samples" not in how:
            write_html_report(folder)
            page, ok = Document(whole_report(folder)), [r for r in records if r.status == "ok"]
            assert said in page.words
            assert said in whole_markdown(write_markdown_report(folder).parent)
            failed = [r.message for r in records if r not in ok]
            tables = [
                rows for name, rows in page.tables if name == "Runs that did not reach the end"
            ]
            assert [row[-1] for rows in tables[:1] for row in rows[1:]] == failed
            drawn = any(name.endswith("convergence-max") for name in page.charts)
            assert drawn == bool(ok)


def test_cells_that_are_not_measured_yet_are_counted(tmp_path: Path) -> None:
    plant(tmp_path, some())
    with Store(tmp_path, create=True) as store:
        plan = store.plan()
        first, *others = plan.studies
        more = msgspec.structs.replace(first, cells=[*first.cells, "later 1", "later 2"])
        new = Study(title="To come", problem="arm", t_end=2.0, figures=["trajectory"], cells=["l3"])
        store.keep(msgspec.structs.replace(plan, studies=[more, *others, new]))
    text = whole_markdown(write_markdown_report(tmp_path).parent)
    assert "3 of 10 planned runs are not measured yet." in text
    assert "The scene arm (t\\_end=2 s) has no description" in text


def test_a_run_that_left_no_finite_numbers_still_makes_a_page(tmp_path: Path) -> None:
    wild = planted("pendulum", "wild", {"q": (1.0, 2)}, h=0.1)
    wild.errors["q"] = dict.fromkeys(("end", "max", "rms", "settled"))
    plant(tmp_path, [wild])
    with Store(tmp_path, create=True) as store:
        store.save(wild, stored_rows({"t": [0.0, 0.1], "q": [[1.0, 0.0], [math.inf, math.nan]]}))
        assert store.rows(wild.key) == Rows(t=[0.0], values={"q": [[1.0, 0.0]]})
    text = whole_markdown(write_markdown_report(tmp_path).parent)
    assert "Some errors of runs that reached the end are not finite" in text


def test_a_page_shows_measured_scenes_alone_and_no_script_complains(browser, tmp_path):
    for k, records in enumerate(([], failed_only(), some())):
        folder = plant(tmp_path / str(k), records)
        with Store(folder, create=True) as store:
            plan = store.plan()
            new = Study(title="New", problem="arm", t_end=2.0, figures=["trajectory"], cells=["3"])
            store.keep(msgspec.structs.replace(plan, studies=[*plan.studies, new]))
        write_html_report(folder)
        visit(browser, folder / "report" / "scene-arm.html")
        assert "No run of this scene is measured yet." in browser.page_source
        visit(browser, folder / "report.html")
        ok = any(r.status == "ok" for r in records)
        assert len(each(browser, ".question", "1")) == ok
        titles = each(browser, ".panel h3", "node.title")
        assert titles == (["spring_mass", "pendulum"] if ok else [])
        headings = each(browser, "nav div", "node.textContent.trim().split(/\\s*\\n\\s*/)")
        assert ["Not measured yet", "arm"] in headings


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
            own = {"name": str(most), "mine": "two" if most == 9 else ""}
            own |= {"samples": most, "budget_s": 10.0 * most}
            store.keep(msgspec.structs.replace(store.plan(), **own))
    bare = [plant(tmp_path / r.integrator, [r], plan=False) for r in runs[:2]]
    for given, planned in ((folders, True), (bare, False)):
        merge(given, out := tmp_path / f"out {planned}")
        with Store(out) as store:
            plan = store.plan()
            assert len(store.records()) == 2 + planned
        assert (plan is not None) == planned
        if plan:
            assert (plan.samples, plan.budget_s, len(plan.studies)) == (9, 90.0, 1)
            assert (plan.mine, plan.name) == ("two", "3 + 9")
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
