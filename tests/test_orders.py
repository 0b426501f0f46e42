"""The rule that fits orders, orders that are lost, and claims beside fitted orders."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planted import STEPS, planted
from small_stores import atlas_with

from bench.atlas.experiments import built_in_experiments
from bench.commands.suite import suite_of_orders
from bench.results.orders import fit_order, fit_orders
from bench.results.records import SceneRecord
from bench.results.store import Store
from bench.running.inventory import Inventory
from bench.running.plan import DEFAULT_HALVINGS
from reports.scenes import StoredRuns
from reports.series import series_of
from reports.tables.order_table import lost_orders_table, order_table, order_tables
from reports.wrong import IGNORED, OVER, PATTERN, STIFF, TRANSIENT, UNDAMPED

EIGHT = [0.1 * 2.0**-k for k in range(8)]


@given(st.integers(1, 5), st.floats(1e-3, 1e3))
def test_a_clean_power_law_is_found_over_all_points(order, factor):
    fit = fit_order(EIGHT, [factor * h**order for h in EIGHT])
    assert fit.order == pytest.approx(order, abs=1e-6)
    assert fit.points == 8
    assert fit.window == pytest.approx((EIGHT[0], EIGHT[-1]))
    assert fit.verdict == "converges"


def test_the_window_of_a_fit_has_asymptotic_points_alone():
    """Orders with their tolerance, and the numbers of points of the window's ends."""
    spoilt = [h**2 for h in EIGHT]
    spoilt[-1], spoilt[-2] = spoilt[-3] * 1.5, spoilt[-3] * 0.9
    for errors, floor, order, tolerance, first, last in (
        ([h**2 * (1 + 400 * h * h) for h in EIGHT], 0.0, 2.0, 0.06, 1, 7),  # coarse points go
        ([h**2 + 0.03 * h for h in EIGHT], 0.0, 1.0, 0.2, 0, 7),  # an order lost at fine steps
        (spoilt, 0.0, 2.0, 1e-6, 0, 5),  # round-off
        ([h**2 + 1e-6 for h in EIGHT], 1e-6, 2.0, 0.06, 0, 3),  # near the reference's own error
    ):
        fit = fit_order(EIGHT, errors, floor=floor)
        assert fit.order == pytest.approx(order, abs=tolerance)
        assert fit.window[0] < 1.01 * EIGHT[first]
        assert fit.window[1] > 0.99 * EIGHT[last]
        assert fit_order(EIGHT[::-1], errors[::-1], floor=floor) == fit


def test_errors_without_an_order_say_so():
    unknown, stuck = "not determined", "does not converge"
    for errors, verdict, order in (
        ([1e-2, 1e-3] + [None] * 6, unknown, None),  # fewer than three points
        ([1e-2, 1e-3] + [math.inf, math.nan] * 3, unknown, None),
        ([1e-2, 1e-3] + [0.0] * 6, unknown, None),
        ([None] * 8, unknown, None),
        ([h**2 + 1e-3 * h for h in EIGHT], unknown, None),  # still falling at the finest step
        ([h**2 + 3e-3 * h for h in EIGHT], unknown, None),
        ([0.3] * 8, stuck, 0.0),
        ([0.3, 0.8, 0.2, 0.9, 0.3, 1.1, 0.25, 0.7], stuck, None),
    ):
        fit = fit_order(EIGHT, errors)
        assert fit.verdict == verdict
        assert fit.order == (order if order is None else pytest.approx(order, abs=1e-9))
    assert fit_order([0.1] * 3, [0.3] * 3).verdict == unknown
    # A plateau of round-off is no order zero, and a long rise of it hides none.
    rise = [1e-5, 2.5e-6, 6.3e-7, 2.2e-7, 5.5e-7, 2.1e-6, 7.4e-6, 2.8e-5]
    plateau = [1e-3 * h**4 + 2e-12 for h in EIGHT]
    for steps, errors, order in (
        (EIGHT, plateau, pytest.approx(4.0, abs=0.2)),
        ([1e-3 * 2.0**-k for k in range(8)], rise, pytest.approx(2.0, abs=0.25)),
    ):
        fit = fit_order(steps, errors)
        assert fit.verdict != stuck
        assert fit.order is None or fit.order == order


def test_a_step_given_twice_is_one_point():
    once = fit_order(EIGHT, [h**2 for h in EIGHT])
    assert fit_order(EIGHT + EIGHT[:2], [h**2 for h in EIGHT + EIGHT[:2]]) == once
    # Of several runs at one step the worst counts, wherever it stands.
    worst, better = [h**2 for h in EIGHT], [h**2 / (2 + k) for k, h in enumerate(EIGHT)]
    assert fit_order(EIGHT * 2, worst + better) == fit_order(EIGHT * 2, better + worst) == once


def vibration(step, rho=1.0):
    """Largest errors of a vibration of 3162 rad/s over 10 s, beside a slow motion of order two."""
    t = np.linspace(0.0, 10.0, 20_001)
    omega = math.sqrt(1e7)
    phase = 2 / step * math.atan(omega * step / 2)  # of the trapezoidal rule
    fast = np.max(np.abs(rho**t * np.cos(phase * t) - np.cos(omega * t)))
    return {"q": 1e-4 * fast + step**2, "v": 0.25 * fast, "a": fast}


def test_a_phase_that_no_step_resolves_determines_no_order_in_any_group():
    for rho in [1.0, 0.5]:
        steps = [2e-4 * 2.0**-k for k in range(4)]
        found = [vibration(h, rho) for h in steps]
        errors = {group: [f[group] for f in found] for group in ("q", "v", "a")}
        assert fit_order(steps, errors["a"]).verdict == "does not converge"  # of itself
        for fit in fit_orders(steps, errors, dict.fromkeys(errors, 0.0)).values():
            assert (fit.order, fit.verdict) == (None, "not determined")


@given(st.floats(0.01, 100.0), st.floats(0.5, 5.0), st.permutations(range(8)))
def test_a_group_that_is_stuck_beside_one_that_gains_does_not_converge(level, order, places):
    steps = [EIGHT[k] for k in places]
    errors = {"q": [h**order for h in steps], "lam": [level] * 8}
    fits = fit_orders(steps, errors, {"q": 0.0, "lam": 0.0})
    assert fits["lam"].verdict == "does not converge"
    assert fits["q"] == fit_order(steps, errors["q"])
    # A position that is as good as its reference has gained, too.
    exact = errors | {"q": [1e-15] * 8}
    assert fit_orders(steps, exact, {"q": 1e-15, "lam": 0.0})["lam"] == fits["lam"]


SECOND = {"q": (1.0, 2), "a": (1.0, 2)}
OF_RUNS = (0.04, 0.02, 0.01, 0.005)
LEVEL = 9.27


def ringing(name, scene="pendulum", **changes):
    """Runs whose multiplier does not converge, and whose acceleration loses an order at first."""
    runs = []
    for h in OF_RUNS:
        own = planted(scene, name, SECOND | {"lam": (LEVEL, 0)}, h=h, **changes)
        own.errors["a"]["max"] = 0.3 * h
        runs.append(own)
    return runs


def test_lost_orders_are_listed_beside_the_claims_with_what_explains_them():
    claims = {"q": 2, "a": 2, "lam": 2}

    def lost(runs, method="m", described=None):
        atlas = atlas_with(method, PATTERN, STIFF, TRANSIENT, UNDAMPED)
        table = lost_orders_table({"pendulum": series_of(runs)}, atlas, described or {})
        assert {row for row, _ in table.links} == {
            k for k, row in enumerate(table.rows) if row[5] != "not explained"
        }
        return [row[2:] for row in table.rows]

    held = ringing("m", formulation="index3", claims=claims)
    first = ["a", "2", "1.00; after the start transient 2.00", "1. About start_transient"]
    never = ["lam", "2", "none: error 9.27 at h=0.04, 9.27 at h=0.005", "1. About undamped_index3"]
    assert lost(held) == [first, never]
    none = "not explained"
    # An experiment of another method, or of constraints on a scene without them, explains nothing.
    assert lost(held, "other") == [[*first[:-1], none], [*never[:-1], none]]
    free = ringing("m", formulation="unconstrained", claims=claims)
    assert lost(free) == [[*first[:-1], none], [*never[:-1], none]]
    uneven = ringing("m", pattern=(0.3, 0.7), claims=claims)
    assert {row[-1] for row in lost(uneven)} == {"1. About variable_steps"}
    fast = SceneRecord(problem="pendulum", t_end=1.0, t0=0.0, rates={"oscillation": 1e4})
    assert {r[-1] for r in lost(held, "m", {"pendulum": fast})} == {
        "1. About spurious_acceleration"
    }
    # Of tolerances nothing is claimed, but errors have to fall; nor can an unclaimed order be lost.
    loose = ringing("m", controls="tolerance")
    for k, record in enumerate(loose, 3):
        record.rtol = record.atol = 10.0**-k
    stuck = "none: error 9.27 at rtol=0.001, 9.27 at rtol=1e-6"
    assert lost(loose) == [["lam", "none", stuck, none]]
    assert [row[0] for row in lost(ringing("m", formulation="index3"))] == ["lam"]
    good = [planted("s", "m", SECOND, h=h, claims=claims) for h in OF_RUNS]
    assert lost_orders_table({"s": series_of(good)}, {}, {}) is None


def test_the_experiments_that_explain_losses_exist():
    assert {PATTERN, STIFF, TRANSIENT, UNDAMPED, IGNORED, OVER} <= {*built_in_experiments()}


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
    stuck = {"q": (1, 2), "a": (0.3, 0)}
    found = rows([planted("pendulum", "mine", stuck, h=h, claims={"a": 1}) for h in STEPS])
    assert found["mine", "claimed"] == {"q": "–", "a": "1"}  # noqa: RUF001
    assert found["mine", "settled"] == {"q": "2.00", "a": "0 *"}


def test_a_row_says_its_start_where_others_have_another_one():
    def names(*labels):
        runs = [
            planted("pendulum", label, {"lam": (1, 2)}, h=h, family="f") for label in labels
            for h in STEPS
        ]  # fmt: skip
        return list(dict.fromkeys(name for name, _ in rows(runs)))

    plain = "generalized_alpha[rho_inf=0.8]", "newmark"
    stable = "generalized_alpha[rho_inf=0.8,formulation=stabilised_index2,start=corrected]"
    assert names(*plain) == ["gα 0.8", "Newmark"]
    assert names(stable, *plain) == [
        "gα 0.8 · GGL · corrected start", "gα 0.8 · plain start", "Newmark · plain start"
    ]  # fmt: skip


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
def test_the_table_of_the_document_is_measured(stepbench, tmp_path):
    page = (Path(__file__).parents[1] / "docs" / "orders.md").read_text(encoding="utf-8")
    alpha = "generalized_alpha[rho_inf=0.8]", "generalized_alpha[rho_inf=0.8,start=corrected]"
    methods = *alpha, "generalized_alpha[formulation=stabilised_index2]", "newmark"
    answer = stepbench(
        "order", "double_pendulum_controlled", *methods, "newmark[formulation=stabilised_index2]",
        "--steps", "0.005,0.0025,0.00125,0.000625,0.0003125", "--out", tmp_path,
    )  # fmt: skip
    assert answer.exit_code == 0, answer.output
    for words in ("Newmark", "claimed", "settled", "with transient"):
        assert words in answer.stdout
    assert "Orders" in (tmp_path / "report.html").read_text(encoding="utf-8")
    lines = (row.split(" | ") for row in re.findall(r"^\| (.*) \|$", page, re.MULTILINE))
    kinds = "claimed", "settled", "with transient"
    told = {tuple(cells[:2]): cells[2:] for cells in lines if cells[1] in kinds}
    with Store(tmp_path) as store:
        (table,) = order_tables(StoredRuns.of(store))
    found = {tuple(row[:2]): row[2:] for row in table.rows}
    assert len(told) == 15
    for row, orders_told in told.items():
        for one, other in zip(orders_told, found[row], strict=True):
            assert one == other or float(one) == pytest.approx(float(other), abs=0.02), row
