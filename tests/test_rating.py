"""The search for the coarsest resolution that meets a rule, of `stepbench recommend` with names."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planted import planted

from bench.plugins.registry import Registry
from bench.results.demands import bracket, demand, overviews
from bench.results.records import UNSUPPORTED, Plan, Record, Study
from bench.results.store import Store
from bench.running.inventory import Inventory
from bench.running.plan import make_suite
from bench.running.profiles import read_profile
from bench.running.search import MOST_RUNS, RESOLVED, Sizes
from problems.base.spec import SpecError
from problems.scenes.iftomm_pendulum import IFToMMPendulum

STEPS = Sizes(length=10.0, start=0.1, finest=1e-7, coarsest=10.0)
RTOL = Sizes(length=None, start=1e-4, finest=1e-13, coarsest=0.1)


def search(sizes, error, limit):
    tried = {}
    while (size := sizes.next(tried, limit)) is not None:
        assert size not in tried
        assert sizes.finest <= size <= sizes.coarsest
        tried[size] = error(size)
    return tried


@settings(deadline=None)
@given(
    st.floats(0.7, 6.0), st.floats(-2.0, 4.0), st.floats(-6.0, -1.0), st.sampled_from([STEPS, RTOL])
)
def test_the_coarsest_good_size_of_a_power_law_is_found_in_few_runs(order, factor, limit, sizes):
    limit = 10**limit
    exact = (limit / 10**factor) ** (1 / order)
    tried = search(sizes, lambda size: 10**factor * size**order, limit)
    assert len(tried) <= 12
    good, bad = bracket(tried, limit)
    if sizes.finest * 2 < exact < sizes.coarsest / 2:
        assert good <= exact * 1.001 <= bad * 1.002
        neighbours = sizes.length is not None and sizes.length / good - sizes.length / bad < 1.5
        assert bad <= good * RESOLVED or neighbours


def test_a_size_above_the_limit_of_stability_fails_and_is_bracketed():
    tried = search(STEPS, lambda h: 1e-9 * h if h < 0.0123 else math.inf, 1e-3)
    good, bad = bracket(tried, 1e-3)
    assert good < 0.0123 <= bad <= good * RESOLVED


def test_a_size_that_is_good_by_accident_is_not_taken_and_a_finer_one_that_fails_spoils_nothing():
    tried = {0.4: 1.0, 0.2: 1e-9, 0.1: 0.5, 0.05: 1e-4, 0.02: 1e-5}
    assert bracket(tried, 1e-3) == (0.05, 0.1)
    tried = {0.4: 1.0, 0.2: 0.05, 0.1: 0.01, 0.05: math.inf, 0.02: 1e-4, 0.01: math.inf}
    for limit, wanted in (0.1, (0.2, 0.4)), (1e-3, (0.02, 0.05)), (1e-5, (None, 0.01)):
        assert bracket(tried, limit) == wanted

    def error(h):  # steps that come near a singular position
        return math.inf if round(100 / h) % 7 == 0 else h**2

    for limit in (1e-2, 1e-4, 1e-8):
        good, _ = bracket(search(STEPS, error, limit), limit)
        assert limit / 2 < error(good) <= limit


def test_every_search_ends():
    tried = search(STEPS, lambda h: max(h**2, 1e-6), 1e-8)  # errors do not fall any more
    assert bracket(tried, 1e-8).good is None
    assert len(tried) <= 8
    assert len(search(STEPS, lambda h: math.inf, 1e-3)) <= 4
    wild = iter([10.0 ** ((-1) ** k * k) for k in range(100)])
    assert len(search(STEPS, lambda h: next(wild), 1e-3)) <= MOST_RUNS
    # The coarsest size of all may be good.
    assert bracket(search(STEPS, lambda h: 1e-9, 1e-3), 1e-3) == (10.0, None)


def test_an_interval_has_a_whole_number_of_steps_and_tolerances_have_two_digits():
    for size in (0.03, 0.7, 9.0):
        count = STEPS.length / STEPS.allowed(size)
        assert count == pytest.approx(round(count))
    assert RTOL.allowed(1.23456e-5) == 1.2e-5


def test_demands_are_read_and_judged():
    run = Record(
        key="", problem="", integrator="", family="", formulation="", controls="step", t0=0.0,
        t_end=1.0, status="ok", errors={"q": {"max": 0.2, "end": 0.1}}, energy_drift=0.3,
        history_error=0.4,
    )  # fmt: skip
    found = [demand(text).of(run) for text in ("q:1", "q:end:1", "energy:1", "points:1", "a:1")]
    assert found == [0.2, 0.1, 0.3, 0.4, math.inf]
    run.status = "diverged"
    assert demand("q:1").of(run) == math.inf
    for text in ("a", "a:", "a:0", "a:-1", "a:nan", "a:inf", ":1", "z:1", "a:b:1"):
        with pytest.raises(SpecError):
            demand(text)


def test_rate_finds_sizes_and_keeps_runs(stepbench, tmp_path):
    rate = "recommend", "pendulum", "rattle", "ida", "--t-end", "0.5", "--out", tmp_path, "--json"
    result = stepbench(*rate, "--error", "q:1e-3")
    assert result.exit_code == 0, result.output
    told = json.loads((tmp_path / "recommendation.json").read_text())
    assert json.loads(result.stdout) == told
    for own in told["ratings"]:
        assert (own["met"], own["error"] <= 1e-3) == (True, True)
        assert min(own["seconds"], own["operations"]) > 0
    again = stepbench(*rate, "--error", "q:1e-3")
    assert "measuring" not in again.stderr
    assert json.loads(again.stdout)["ratings"] == told["ratings"]


@pytest.mark.long
def test_a_rule_that_nobody_meets_is_an_error_with_reasons(stepbench, tmp_path):
    result = stepbench(
        "recommend", "pendulum", "half_explicit_euler", "stormer_verlet", "--out", tmp_path,
        "--t-end", "0.4", "--error", "q:1e-14", "--budget", "2", "--json",
    )  # fmt: skip
    assert result.exit_code == 1
    assert "No integrator reaches" in result.stderr
    ratings = json.loads((tmp_path / "recommendation.json").read_text())["ratings"]
    first, second = sorted(ratings, key=lambda own: own["integrator"])
    assert not first["met"]
    assert not second["met"]
    assert first["obstacle"].startswith(("Errors do not fall", "budget_exceeded"))
    assert second["obstacle"].startswith("unsupported")
    assert 1e-14 < first["error"] < 1e-3


def test_the_table_of_a_suite_has_the_time_of_the_coarsest_good_run():
    def run(scene, method, h, error, seconds, status="ok"):
        return planted(
            scene, method, {}, h=h, history_error=error, run_s=[seconds], status=status,
        )  # fmt: skip

    runs = [
        run("s", "one", 0.1, 0.05, 1.0), run("s", "one", 0.01, 5e-4, 9.0),
        run("s", "one", 0.02, 9e-4, 5.0), run("t", "one", 0.1, 9e-4, 3.0),
        run("s", "two", 0.1, 0.05, 2.0), run("t", "two", 0.1, 0.0, 1.0, UNSUPPORTED),
        run("s", "three", 0.1, 5e-4, 7.0), run("t", "three", 0.1, 2e-3, 2.0),
        # Good by accident: a finer run is not.
        run("s", "four", 0.1, 5e-4, 1.0), run("s", "four", 0.05, 0.01, 2.0),
    ]  # fmt: skip
    studies = [
        Study(
            title=scene, problem=scene, t_end=1.0, figures=[],
            cells=[r.key for r in runs if r.problem == scene], demands=demands,
        )
        for scene, demands in (("s", ["points:1e-3", "no:1"]), ("t", ["points:1e-3"]), ("u", []))
    ]  # fmt: skip
    plan = Plan(name="", title="", samples=1, budget_s=1.0, studies=studies)
    (table,) = overviews(plan, {r.key: r for r in runs})
    assert table.head == ["integrator", "s", "t"]
    assert table.rows == [
        ["one", "5", "3"], ["three", "7", "not met"], ["two", "not met", "–"],  # noqa: RUF001
        ["four", "not met", "–"],  # noqa: RUF001
    ]  # fmt: skip
    assert table.best == {(0, 1), (0, 2)}


@pytest.mark.long
def test_the_iftomm_rule_has_two_precisions_of_the_points(stepbench, tmp_path):
    rule = "--rule", "iftomm", "--out", tmp_path, "--t-end", "1", "--json"
    told = json.loads(stepbench("recommend", "iftomm_pendulum", "rattle", *rule).stdout)["ratings"]
    assert [own["demand"] for own in told] == [
        "error of the named points <= 0.1", "error of the named points <= 0.001",
    ]  # fmt: skip
    for own, limit in zip(told, (0.1, 1e-3), strict=True):
        assert limit / 4 < own["error"] <= limit
        with Store(tmp_path) as store:
            (run,) = (r for r in store.records().values() if r.resolution == own["resolution"])
        (place,) = run.points.values()
        assert np.hypot(*place) == pytest.approx(1.0, abs=1e-10)
        exact = IFToMMPendulum().exact(np.array([1.0]))["q"][0]
        assert 0.0 < np.abs(place - exact).max() < limit


def test_a_scene_without_points_is_judged_by_its_energy_or_says_why_not(stepbench, tmp_path):
    rule = "--out", tmp_path, "--t-end", "0.5", "--json"
    found = stepbench("recommend", "pendulum", "rattle", "--rule", "iftomm", *rule)
    assert "pendulum names no points: its change of energy is judged." in found.stderr
    told = json.loads(found.stdout)["ratings"]
    assert [own["demand"] for own in told] == [
        "change of energy <= 0.1", "change of energy <= 0.001",
    ]  # fmt: skip
    assert all(own["error"] == own["energy_drift"] for own in told)


def test_the_suite_iftomm_has_many_families_and_methods_that_take_its_scenes():
    registry, inventory = Registry(), Inventory()
    suite = make_suite(*read_profile("iftomm"), inventory)
    pairs = {(c.problem, c.integrator) for c in suite.cells.values()}
    assert len({registry.integrator(method).family for _, method in pairs}) >= 8
    for scene, method in pairs:
        assert inventory.problem(scene).points
        assert registry.integrator(method).supports(registry.problem(scene)) is None
