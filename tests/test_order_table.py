"""The order table: claims beside fitted orders, on planted errors and in a run."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from planted import STEPS, planted

from bench.commands.suite import suite_of_orders
from bench.plugins.registry import Registry
from bench.results.records import Study
from bench.results.store import Store
from bench.running.inventory import Inventory
from bench.running.plan import DEFAULT_HALVINGS
from bench.running.profiles import read_profile
from problems.equations.block_structure import mass_varies
from reports.series import series_of
from reports.tables.order_table import order_table, stored_order_tables


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
    assert found["mine", "with transient"] == {"q": "2.00", "λ": "1.00"}


def test_no_claim_and_no_convergence_are_told_apart():
    records = [
        planted("pendulum", "mine", {"q": (1, 2), "a": (0.3, 0)}, h=h, claims={"a": 1})
        for h in STEPS
    ]
    found = rows(records)
    assert found["mine", "claimed"] == {"q": "–", "a": "1"}  # noqa: RUF001
    assert found["mine", "settled"] == {"q": "2.00", "a": "0 *"}


def test_of_one_method_a_scene_has_the_rows():
    """As on the page of a method, with the claims for each scene."""
    series = [
        series_of([planted(k, "m", {"q": (1, 2), "a": (1, 1)}, h=h, claims=own) for h in STEPS])[0]
        for k, own in (("free", {"q": 2, "a": 2}), ("held", {"q": 2}))
    ]
    table = order_table(series, "Orders", ["free", "held"])
    assert table.head == ["scene", "order", "q", "a"]
    assert table.rows[:2] == [["free", "claimed", "2", "2"], ["free", "settled", "2.00", "1.00 *"]]
    assert table.rows[3] == ["held", "claimed", "2", "–"]  # noqa: RUF001


def test_methods_that_choose_their_steps_or_have_two_runs_are_left_out():
    few = [planted("pendulum", "mine", {"q": (1, 2)}, h=h) for h in STEPS[:2]]
    assert order_table(series_of(few), "Orders") is None
    whole = [planted("pendulum", "other", {"q": (1, 2)}, h=h) for h in STEPS]
    assert (
        "fewer than three runs to the end: mine."
        in order_table(series_of([*few, *whole]), "Orders").note
    )


def test_several_methods_on_a_scene_take_the_steps_that_are_given():
    registry = Inventory()
    scene, methods = registry.problem("pendulum", th0="1.0"), ("newmark", "bdf2")
    given = suite_of_orders(registry, scene, methods, 7, (0.1, 0.05, 0.025), (0.3, 0.7), 1.35)
    assert {c.problem for c in given.cells.values()} == {"pendulum[th0=1.0]"}
    assert {c.integrator.partition("[")[0] for c in given.cells.values()} == {"newmark", "bdf2"}
    assert {(c.t_end, c.resolution.pattern) for c in given.cells.values()} == {(1.35, (0.3, 0.7))}
    assert {c.resolution.h for c in given.cells.values()} == {0.1, 0.05, 0.025}
    assert (given.plan.budget_s, given.plan.samples, len(given.plan.studies)) == (7, 0, 1)
    assert len(suite_of_orders(registry, scene, ["newmark"]).cells) == DEFAULT_HALVINGS


@pytest.mark.long
def test_the_command_measures_claims_and_orders(stepbench, tmp_path):
    answer = stepbench("order", "pendulum", "bdf2", "newmark", "--out", tmp_path)
    assert answer.exit_code == 0, answer.output
    for words in ("BDF2", "claimed", "settled", "with transient"):
        assert words in answer.stdout
    with Store(tmp_path) as store:
        plan, records = store.plan(), store.records()
    assert all(isinstance(s, Study) for s in plan.studies)
    assert {tuple(r.claims.items()) for r in records.values() if "bdf2" in r.integrator} == {
        tuple(dict.fromkeys(("q", "v", "a", "lam", "x", "y"), 2).items())
    }
    assert "Orders" in (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.mark.long
def test_the_table_of_the_document_is_measured(stepbench, tmp_path):
    page = (Path(__file__).parents[1] / "docs" / "orders.md").read_text(encoding="utf-8")
    alpha = "generalized_alpha[rho_inf=0.8]", "generalized_alpha[rho_inf=0.8,start=corrected]"
    methods = *alpha, "generalized_alpha[formulation=stabilised_index2]", "newmark"
    answer = stepbench(
        "order", "double_pendulum_controlled", *methods, "newmark[formulation=stabilised_index2]",
        "--steps", "0.005,0.0025,0.00125,0.000625,0.0003125", "--out", tmp_path,
    )  # fmt: skip
    assert answer.exit_code == 0, answer.output
    lines = (row.split(" | ") for row in re.findall(r"^\| (.*) \|$", page, re.MULTILINE))
    kinds = "claimed", "settled", "with transient"
    told = {tuple(cells[:2]): cells[2:] for cells in lines if cells[1] in kinds}
    (table,) = stored_order_tables(tmp_path)
    found = {tuple(row[:2]): row[2:] for row in table.rows}
    assert len(told) == 15
    for row, orders_told in told.items():
        for one, other in zip(orders_told, found[row], strict=True):
            assert one == other or float(one) == pytest.approx(float(other), abs=0.02), row


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
