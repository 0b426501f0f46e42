"""The order table: claims beside fitted orders, on planted errors and in a run."""

from __future__ import annotations

import pytest
from planted import STEPS, planted

from bench.commands import studies
from bench.plugins.registry import Registry
from bench.results.records import Study
from bench.results.store import Store
from bench.running.profiles import read_profile
from problems.dependence import mass_varies
from problems.spec import SpecError
from reports.series import series_of
from reports.text.order_table import order_table


def rows(records):
    table = order_table(series_of(records), "Orders")
    assert table is not None
    return {tuple(row[:2]): dict(zip(table.head[2:], row[2:], strict=True)) for row in table.rows}


def test_claims_stand_beside_settled_orders_and_those_with_the_start():
    records = [
        planted("pendulum", "mine", {"q": (1, 2), "lam": (4, 2)}, h=h, claims={"q": 2, "lam": 3})
        for h in STEPS
    ]
    for r in records:
        r.errors["lam"]["max"] = 2 * r.h
    found = rows(records)
    assert found["mine", "claimed"] == {"q": "2", "λ": "3"}
    assert found["mine", "settled"] == {"q": "2.00", "λ": "2.00 *"}
    assert found["mine", "with start"] == {"q": "2.00", "λ": "1.00"}


def test_no_claim_and_no_convergence_are_told_apart():
    records = [
        planted("pendulum", "mine", {"q": (1, 2), "a": (0.3, 0)}, h=h, claims={"a": 1})
        for h in STEPS
    ]
    found = rows(records)
    assert found["mine", "claimed"] == {"q": "–", "a": "1"}  # noqa: RUF001
    assert found["mine", "settled"] == {"q": "2.00", "a": "0 *"}


def test_methods_that_choose_their_steps_or_have_two_runs_are_left_out():
    few = [planted("pendulum", "mine", {"q": (1, 2)}, h=h) for h in STEPS[:2]]
    assert order_table(series_of(few), "Orders") is None
    whole = [planted("pendulum", "other", {"q": (1, 2)}, h=h) for h in STEPS]
    assert (
        "fewer than three runs to the end: mine."
        in order_table(series_of([*few, *whole]), "Orders").note
    )


def test_methods_are_taken_as_named_and_stand_under_titles_that_are_true(stepbench, monkeypatch):
    suites = []

    def run_suite(suite, *_, **__):
        suites.append(suite)
        raise SpecError("Planned")

    monkeypatch.setattr(studies, "run_suite", run_suite)
    answer = stepbench("orders-table", "bathe", "rattle", "phem56", "-p", "double_pendulum")
    assert answer.exit_code == 1
    assert "phem56 chooses its own steps, over which no order can be measured" in answer.stderr
    assert not suites
    named = "hht_classical", "bathe", "phem56[steps=constant]"
    stepbench("orders-table", *named, "-p", "double_pendulum")
    (suite,) = suites
    found = {
        study.title: sorted({suite.cells[key].integrator for key in study.cells})
        for study in suite.plan.studies
    }
    published = "Two rods: one-step methods of second order as first published"
    assert found == {
        published: ["hht_classical[alpha=0.1]"],
        "double_pendulum: methods named": ["bathe[gamma=0.5]", "phem56[steps=constant]"],
    }


@pytest.mark.long
def test_the_command_measures_claims_and_orders(stepbench, tmp_path):
    answer = stepbench("orders-table", "bdf2", "-p", "pendulum", "--out", tmp_path)
    assert answer.exit_code == 0, answer.output
    for words in ("BDF2", "claimed", "settled", "with start"):
        assert words in answer.stdout
    with Store(tmp_path) as store:
        plan, records = store.plan(), store.records()
    assert all(isinstance(s, Study) for s in plan.studies)
    assert {tuple(r.claims.items()) for r in records.values()} == {
        tuple(dict.fromkeys(("q", "v", "a", "lam", "x", "y"), 2).items())
    }
    assert "Orders" in (tmp_path / "report.html").read_text(encoding="utf-8")
    again = stepbench("orders-table", "bdf2", "-p", "pendulum", "--out", tmp_path, "--markdown")
    assert "| BDF2 | claimed | 2 | 2 | 2 | 2 |" in again.stdout


def test_a_constrained_scene_of_the_suite_has_a_mass_that_depends_on_q_and_a_controller():
    """It shows the order that HHT-I3 loses as published, in x and y, too."""
    _, profile = read_profile("orders")
    named = [
        (p, name) for study in profile.study for p in study.problems for name in study.integrators
    ]
    registry = Registry([])
    scenes = {p: registry.problem(p) for p, _ in named}
    whole = {
        p for p, s in scenes.items() if s.has("constraint") and s.has("output") and mass_varies(s)
    }
    assert {name for p, name in named if p in whole} >= {
        "hht_i3[steps=constant]",
        "hht_i3[steps=constant,mixed=forces]",
    }
