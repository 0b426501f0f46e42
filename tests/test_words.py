"""Words: phrases, suites, titles, counts of runs, and runs that are not supported."""

from __future__ import annotations

import json
from importlib.metadata import entry_points

import pytest
from planted import plant, planted

from bench.results.folders import merge
from bench.results.records import Plan, endings
from bench.results.store import Store
from bench.running.inventory import Inventory
from bench.running.plan import make_suite
from bench.running.profiles import read_profile, suite_titles
from reports.pages.report import read_report
from reports.questions import Ref, listed, plain

GROUPS = {"q": (1.0, 2), "v": (1.0, 2), "a": (1.0, 2), "lam": (1.0, 2)}


def ended(status: str, h: float = 0.1, integrator: str = "good"):
    errors, message = (GROUPS, "") if status == "ok" else ({}, "Because.")
    return planted("pendulum", integrator, errors, h=h, status=status, message=message)


def test_runs_that_are_not_supported_are_no_failures():
    runs = [*map(ended, ["ok", "ok", "unsupported", "diverged"])]
    assert endings(runs) == "2 ok, 1 not supported, 1 failed with a reason"
    assert endings(runs[:2]) == "2 ok, 0 failed with a reason"
    cut = [*runs, ended("interrupted")]
    assert endings(cut) == f"{endings(runs)}, 1 interrupted"


def test_an_order_of_unsupported_runs_alone_is_one_sentence(refused, monkeypatch, tmp_path):
    def run_suite(suite, registry, out, *more):
        Store(out, create=True).close()
        return [ended("unsupported", h) for h in (0.1, 0.05, 0.025)], []

    monkeypatch.setattr("bench.commands.suite.run_suite", run_suite)
    said = refused("order", "pendulum", "newmark", "--out", tmp_path)
    assert said == "Error: No order was measured. All end with unsupported: Because."


def test_a_part_of_a_suite_is_titled_by_what_was_run(tmp_path):
    name, profile = read_profile("quick")
    registry = Inventory()
    assert make_suite(name, profile, registry).plan.title == profile.title
    part = make_suite(name, profile, registry, ["pendulum"], ["newmark"]).plan
    assert part.title == ""
    runs = [ended("ok"), ended("ok", 0.05), ended("ok", 0.05, "other")]
    assert part.heading(runs) == "quick: 1 scene, 2 integrators"
    assert part.heading([]) == "quick"
    folder = plant(tmp_path / "store", runs, plan=False)
    with Store(folder, create=True) as store:
        store.keep(part)
    report = read_report(folder)
    assert report.title == "quick: 1 scene, 2 integrators"
    assert "3 reached the end, 0 failed with a reason" in report.stored.state


def test_a_method_of_one_s_own_comes_beside_the_suite():
    name, profile = read_profile("quick")
    registry = Inventory()
    whole = make_suite(name, profile, registry)
    plan = make_suite(name, profile, registry, mine="wbz").plan
    assert (plan.mine, plan.title) == ("wbz[rho_inf=0.8]", whole.plan.title)
    assert set(plan.integrators) == {*whole.plan.integrators, plan.mine}
    assert sum(plan.mine in key for study in plan.studies for key in study.cells) == 12
    alone = make_suite(name, profile, registry, ["pendulum"], ["ida"], mine="wbz").plan
    assert {text.partition("[")[0] for text in alone.integrators} == {"ida", "wbz"}
    there = make_suite(name, profile, registry, mine="generalized_alpha[rho_inf=0.8]").plan
    assert set(there.integrators) == set(whole.plan.integrators)


def test_merged_stores_keep_the_method_of_one_s_own(tmp_path):
    for name, mine, title in (("one", "", "One"), ("two", "good", "")):
        folder = plant(tmp_path / name, [ended("ok")], plan=False)
        with Store(folder, create=True) as store:
            store.keep(Plan(name=name, title=title, samples=1, budget_s=1.0, studies=[], mine=mine))
    merge([tmp_path / "one", tmp_path / "two"], tmp_path / "all")
    with Store(tmp_path / "all") as store:
        plan = store.plan()
    assert plan is not None
    assert (plan.mine, plan.name, plan.title) == ("good", "one + two", "")


@pytest.fixture
def narrow(monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")


def test_the_list_has_a_line_for_each_and_details_of_one(stepbench, narrow):
    registry = Inventory()
    lines = stepbench("list").stdout.splitlines()
    for name in (*registry.problems, *registry.integrators, *suite_titles()):
        assert sum(line.split()[:1] == [name] for line in lines) == 1, name
    assert (
        len(lines) == sum(map(len, (registry.problems, registry.integrators, suite_titles()))) + 4
    )
    only = stepbench("list", "scenes").stdout
    assert "pendulum" in only
    assert "newmark" not in only
    text = " ".join(stepbench("list", "pendulum", "generalized_alpha").stdout.split())
    for words in (
        "Released at rest at angle th0 from the downward vertical",
        "th0 1.5708 from 1e-06 to 3.14159 amplitude: angle at rest at t=0 in rad",
        "start consistent consistent, corrected consistent: aux = a at t0",
        "beta none from 0 to 3",
    ):
        assert words in text
    suite = " ".join(stepbench("list", "quick").stdout.split())
    assert "6 timings per run, at most 60 s" in suite
    assert "Pendulum: IDA on raw index 3" in suite
    wrong = stepbench("list", "pendulm")
    assert wrong.exit_code == 1
    assert "did you mean 'pendulum'" in wrong.stderr


def test_the_json_of_the_list_is_complete(stepbench):
    listed = json.loads(stepbench("list", "--json").stdout)
    for kind in ("problems", "integrators"):
        names = {entry.name for entry in entry_points(group=f"stepbench.{kind}")}
        assert {row["name"] for row in listed[kind]} == names
    assert {row["name"] for row in listed["suites"]} >= {"quick", "full", "methods"}
    (row,) = json.loads(stepbench("list", "pendulum", "--json").stdout)["problems"]
    assert row in listed["problems"]
    assert row["description"][0].startswith("Released at rest")
    assert [option["name"] for option in row["options"]][:3] == ["m", "length", "g"]
    (suite,) = json.loads(stepbench("list", "quick", "--json").stdout)["suites"]
    assert suite["study"][1]["problems"] == ["pendulum"]


def test_mine_is_run_reported_and_told(stepbench, monkeypatch, tmp_path):
    asked = []

    def run_suite(suite, registry, out, *more):
        asked.append(suite.plan.mine)
        return [ended("ok")], ["1 run: 1 ok"]

    def card(folder, integrator):
        return [f"{integrator or 'All'} wins in {folder.name}."]

    monkeypatch.setattr("bench.commands.suite.run_suite", run_suite)
    monkeypatch.setattr("bench.commands.suite.write_reports", lambda folder: None)
    monkeypatch.setattr("reports.verdicts.method_card", card)
    result = stepbench("run", "--mine", "wbz", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert asked == ["wbz[rho_inf=0.8]"]
    mine, then, every, counts = result.stdout.splitlines()
    assert (mine, every) == ("wbz[rho_inf=0.8] wins in out.", "All wins in out.")
    assert then.startswith(f"Next: stepbench report {tmp_path / 'out'} --open ")
    assert counts == "1 run: 1 ok"
    assert stepbench("run", "--out", tmp_path / "out").stdout.startswith("All wins in out.\nNext: ")
    for name in ("", "wbzz"):
        wrong = stepbench("run", "--mine", name)
        assert wrong.exit_code == 1
        assert wrong.stderr.startswith("Error: ")


def test_parts_become_text():
    sentence = ["On ", *listed([[Ref("scene", k, k.upper())] for k in "abcd"]), "."]
    assert plain(sentence) == "On A, B, C and 1 more."
