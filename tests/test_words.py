"""Words of the command line: suites, titles, counts of runs, and runs that are not supported."""

from __future__ import annotations

import json

import pytest
from planted import plant, planted

from bench.results.merge import merge
from bench.results.records import Plan, Rows, endings
from bench.results.store import Store
from bench.running.inventory import Inventory
from bench.running.plan import make_suite
from bench.running.profiles import built_in_profiles, read_profile, suite_titles
from reports.pages.report import read_report

GROUPS = {"q": (1.0, 2), "v": (1.0, 2), "a": (1.0, 2), "lam": (1.0, 2)}


def ended(status: str, h: float = 0.1, integrator: str = "good"):
    errors = GROUPS if status == "ok" else {}
    return planted("pendulum", integrator, errors, h=h, status=status, message="Because.")


def test_the_help_of_run_names_every_suite_with_its_title(stepbench):
    text = " ".join(stepbench("run", "--help").output.split())
    assert "[OPTIONS] [SUITE]" in text
    assert len(suite_titles()) == len(built_in_profiles()) == 5
    for name, title in suite_titles().items():
        assert f"{name} {title}" in text


def test_runs_that_are_not_supported_are_no_failures():
    runs = [*map(ended, ["ok", "ok", "unsupported", "diverged"])]
    assert endings(runs) == "2 ok, 1 not supported, 1 failed with a reason"
    assert endings(runs[:2]) == "2 ok, 0 failed with a reason"
    cut = [*runs, ended("interrupted")]
    assert endings(cut) == f"{endings(runs)}, 1 interrupted"


@pytest.mark.parametrize("norm", [[], ["--json"]])
def test_an_order_of_unsupported_runs_alone_is_one_sentence(stepbench, monkeypatch, norm):
    runs = [(ended("unsupported", h), Rows(t=[], values={})) for h in (0.1, 0.05, 0.025)]
    monkeypatch.setattr("bench.running.session.solve_cells", lambda *a, **k: (runs, {}))
    result = stepbench("order", "pendulum", "newmark", *norm)
    assert result.exit_code == 1
    sentence = "Error: newmark[beta=0.25,gamma=0.5] does not take pendulum: Because.\n"
    assert result.stderr == sentence
    if norm:
        assert json.loads(result.stdout)["status"] == ["unsupported"] * 3
    else:
        assert result.stdout == ""
    runs[0] = ended("diverged"), runs[0][1]
    assert "No run succeeded" in stepbench("order", "pendulum", "newmark").stderr


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
        store.save_plan(part)
    report = read_report(folder, interactive=False)
    assert report.title == "quick: 1 scene, 2 integrators"
    assert "3 ok, 0 failed with a reason" in report.state


def test_a_method_of_one_s_own_comes_beside_the_suite():
    name, profile = read_profile("quick")
    registry = Inventory()
    whole = make_suite(name, profile, registry)
    plan = make_suite(name, profile, registry, mine="wbz").plan
    assert plan.mine == "wbz[rho_inf=0.8]"
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
            store.save_plan(
                Plan(name=name, title=title, samples=1, budget_s=1.0, studies=[], mine=mine)
            )
    merge([tmp_path / "one", tmp_path / "two"], tmp_path / "all")
    with Store(tmp_path / "all") as store:
        plan = store.plan()
    assert plan is not None
    assert (plan.mine, plan.name, plan.title) == ("good", "one + two", "")
