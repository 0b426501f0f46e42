"""`stepbench recommend`: the search for the coarsest good resolution, the race and its verdict."""

from __future__ import annotations

import json
import math
import time
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planted import MACHINE, planted

from bench.results.quantities import ERROR_NAMES, NORMS
from bench.results.records import UNSUPPORTED, Record, Rows
from bench.results.store import Store
from bench.running import inventory, recommend
from bench.running.inventory import Inventory
from bench.running.race import Race
from bench.running.recommend import Recommendation
from bench.running.runner import Runner
from bench.running.search import MOST_RUNS, RESOLVED, Candidate, Sizes, bracket, demand
from integrators.resolutions import Steps
from problems.base.spec import SpecError
from problems.scenes.iftomm import IFToMMPendulum

# ---- the search for one method -----------------------------------------------------------
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


def test_sizes_that_fail_or_are_good_by_accident_spoil_no_bracket():
    good, bad = bracket(search(STEPS, lambda h: 1e-9 * h if h < 0.0123 else math.inf, 1e-3), 1e-3)
    assert good < 0.0123 <= bad <= good * RESOLVED
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


def test_every_search_ends_at_allowed_sizes():
    tried = search(STEPS, lambda h: max(h**2, 1e-6), 1e-8)  # errors do not fall any more
    assert bracket(tried, 1e-8)[0] is None
    assert len(tried) <= 8
    assert len(search(STEPS, lambda h: math.inf, 1e-3)) <= 4
    wild = iter([10.0 ** ((-1) ** k * k) for k in range(100)])
    assert len(search(STEPS, lambda h: next(wild), 1e-3)) <= MOST_RUNS
    assert bracket(search(STEPS, lambda h: 1e-9, 1e-3), 1e-3) == (10.0, None)
    for size in (0.03, 0.7, 9.0):  # an interval has a whole number of steps
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


def test_a_demand_names_group_and_norm():
    for text, group, norm in (
        ("a:rms:1", "a", "rms"), (" a : end :1", "a", "end"), ("a:1", "a", "max"),
        ("|q|:1", "|q|", "max"),
    ):  # fmt: skip
        assert demand(text).title == f"error in {ERROR_NAMES[group]} ({NORMS[norm]})"
    for text, words in (
        ("z:max:1", "no error of 'z'; known: a, constraint"), ("|a:max:1", "no error of"),
        ("a:mx:1", "no norm 'mx'; did you mean 'max'"),
    ):  # fmt: skip
        with pytest.raises(SpecError, match=words):
            demand(text)


# ---- the race of all ---------------------------------------------------------------------
LIMIT = 1e-3
ASKED = demand(f"q:{LIMIT}")


class Power:
    """A method whose error and operations are powers of the step."""

    def __init__(self, name: str, order: float, error: float, per_step: float) -> None:
        self.order, self.error, self.per_step = order, error, per_step
        method = SimpleNamespace(spec=name, name=name, controls="step", family=name, orders={})
        scene = SimpleNamespace(spec="s", name="s", interval=(0.0, 1.0), nominal_step=0.1)
        self.candidate = Candidate(scene, method, 1.0, ASKED)

    def run(self, size: float, status: str = "ok") -> None:
        """Plant the run of a size."""
        record = planted(
            "s", self.candidate.method.name, {"q": (self.error, self.order)}, h=size,
            status=status, message=status, operations={"residuals": self.per_step / size},
        )  # fmt: skip
        self.candidate.runs[size] = record

    def least(self) -> float:
        """The operations of the largest step that is good."""
        return self.per_step * (self.error / LIMIT) ** (1 / self.order)


def raced(methods: list[Power]) -> Race:
    """Run a race to its end."""
    race = Race([m.candidate for m in methods], 1.1, math.inf)
    while cells := race.next():
        for cell in cells:
            (method,) = (m for m in methods if m.candidate.method.spec == cell.integrator)
            assert isinstance(cell.resolution, Steps)
            method.run(cell.resolution.h)
    return race


def test_a_race_finds_the_cheapest_and_drops_the_others_soon():
    methods = [
        Power("first", 1, 1.0, 10.0), Power("second", 2, 1.0, 30.0), Power("fourth", 4, 1.0, 90.0),
        Power("fifth", 5, 1.0, 100.0), Power("dear", 2, 1.0, 3000.0),
    ]  # fmt: skip
    race, least = raced(methods), min(m.least() for m in methods)
    assert race.leader is min(methods, key=Power.least).candidate
    assert race.leader.cost() == pytest.approx(least, rel=Race.SETTLED - 1)
    for method in methods:
        dropped = method.least() > 1.1 * race.leader.cost()
        assert race.is_dropped(method.candidate) == dropped
    # Alone it would be searched to the end.
    dear, alone = methods[-1].candidate, Power("dear", 2, 1.0, 3000.0)
    raced([alone])
    assert len(dear.runs) < len(alone.candidate.runs)


def test_the_winner_hangs_neither_on_the_order_of_the_start_nor_on_a_first_step_far_too_fine():
    def named(order):
        methods = [Power("a", 2, 5.0, 7.0), Power("b", 3, 2.0, 11.0), Power("c", 1, 0.1, 1.0)]
        return raced([methods[k] for k in order]).leader.method.name

    assert {named(order) for order in ((0, 1, 2), (2, 1, 0), (1, 0, 2))} == {named((0, 1, 2))}
    fine, rival = Power("fine", 5, LIMIT, 100.0), Power("rival", 2, 60 * LIMIT, 22.0)
    race = raced([rival, fine])
    assert not race.is_dropped(fine.candidate)
    assert race.leader is fine.candidate
    assert fine.candidate.cost() == pytest.approx(100.0)


@settings(deadline=None)
@given(
    st.lists(
        st.sampled_from(
            [0.0, 5e-324, LIMIT, math.nextafter(LIMIT, 1), 0.5, math.nextafter(0.5, 1), 1.7e308]
        )
        | st.sampled_from([math.nan, math.inf])
        | st.floats(1e-4, 1e-2),
        min_size=1,
    )
)
def test_a_race_ends_whatever_errors_do(errors):
    class Odd(Power):
        """A method with errors that stagnate, grow, vanish or are no numbers."""

        def run(self, size: float, status: str = "ok") -> None:
            self.error = errors[len(self.candidate.runs) % len(errors)]
            super().run(size, status)

    good, odd = Power("good", 2, 1.0, 3.0), Odd("odd", 0, 1.0, 3.0)
    raced([odd, good])
    assert len(odd.candidate.runs) <= MOST_RUNS
    assert good.candidate.best
    assert odd.candidate.promised > 0
    if any(0 < e < math.inf for e in errors[: len(odd.candidate.runs)]):
        assert odd.candidate.promised < math.inf


def test_a_method_is_dropped_for_its_promise_not_for_unknown_operations_and_time_ends_a_race():
    good, flat = Power("good", 2, 1e-3, 3.0), Power("flat", 0, 0.5, 3.0)
    for size in (0.1, 0.05):
        good.run(size)
        flat.run(size)
    # Two nearly equal errors promise very many operations, and not infinitely many.
    flat.candidate.runs[0.1].errors["q"] = dict.fromkeys(NORMS, math.nextafter(0.5, 1))
    race = Race([good.candidate, flat.candidate], 1.1, math.inf)
    assert 1e6 < flat.candidate.promised < math.inf
    assert race.is_dropped(flat.candidate)
    known, unknown = Power("a", 2, 1e-3, 7.0), Power("b", 2, 10.0, 0.0)
    known.run(0.1)
    unknown.run(0.1)
    race = Race([known.candidate, unknown.candidate], 1.1, math.inf)
    assert race.leader is known.candidate
    assert not race.is_dropped(unknown.candidate)
    method = Power("a", 2, 5.0, 7.0)
    assert Race([method.candidate], 1.1, time.monotonic() - 1.0).next() == []
    method.run(0.1, UNSUPPORTED)
    assert Race([method.candidate], 1.1, math.inf).next() == []


# ---- the command -------------------------------------------------------------------------
@pytest.fixture
def planted_runs(monkeypatch):
    """A search in two processes whose runs cost what a law says, by methods: phem56 least, and less
    with constant steps; a later stage raises after a number of runs."""
    law = SimpleNamespace(costs={"phem56": 2.0, "rattle": 3.0}, others=50.0, fails=math.inf)

    def measure(suite, store, runner, further):
        store.keep(MACHINE)
        made = 0
        while cells := further()[:2]:
            for cell in cells:
                size = getattr(cell.resolution, "h", None) or cell.resolution.rtol
                cost = law.costs.get(cell.method.name, law.others)
                halved = cell.method.name in law.costs and "constant" in cell.integrator
                record = cell.record("ok")
                record.environment = MACHINE.number
                record.errors = {"q": dict.fromkeys(NORMS, size)}
                record.operations = {"residuals": cost / (1 + halved) / size}
                store.save(record, Rows(t=[]))
            made += len(cells)
            if made > law.fails:
                raise RuntimeError("A later stage raises.")

    monkeypatch.setattr(recommend, "measure_suite", measure)
    monkeypatch.setattr(recommend, "time_suite", lambda *_: None)
    monkeypatch.setattr(Runner, "run", lambda *_: iter(()))
    return law


def test_constant_steps_win_where_they_are_cheapest_and_an_error_loses_nothing(
    stepbench, tmp_path, planted_runs, monkeypatch
):
    asked = "recommend", "pendulum", "--error", f"q:{LIMIT}", "--cost", "operations"
    asked += "--budget", "600", "--out", tmp_path
    methods = ["phem56", "rattle"]
    monkeypatch.setattr(recommend, "_methods", lambda *_: methods)
    told = json.loads(stepbench(*asked, "--json").stdout)
    assert told["ratings"][0]["integrator"] == "phem56[steps=constant]"
    _, tried = told["sentences"][-1].split(
        "Constant steps and other Newton's methods were tried for "
    )
    assert {"phem56", "rattle"} == {*tried.partition(" alone")[0].split(", ")}
    # Then others lead before phem56; its form in the store is cheaper still.
    methods += ["bdf2", "ali3p", "generalized_alpha"]
    planted_runs.others = 1.5
    shown = stepbench(*asked).stdout
    line = 'In a program: bench.solve("pendulum", "phem56[steps=constant]", step='
    assert line in " ".join(shown.split())
    # Of another source, runs in the folder count no more.
    monkeypatch.setattr(inventory, "fingerprint", lambda plugin: "another")
    planted_runs.costs, planted_runs.others, planted_runs.fails = {}, 50.0, 30
    result = stepbench(*asked, "--json")
    assert result.exit_code
    told = json.loads((tmp_path / "recommendation.json").read_text())
    assert told["ratings"]
    assert all(own["operations"] * own["error"] == pytest.approx(50.0) for own in told["ratings"])
    assert json.loads(result.stdout) == told


def test_a_scene_without_points_is_judged_by_its_energy_or_says_why_not():
    registry = Inventory()
    found = Recommendation(registry, registry.problem("pendulum"), ["rattle"], rule="iftomm")
    assert found.remarks == ["pendulum names no points: its change of energy is judged."]
    demands = [str(race.asked) for race in found.races]
    assert demands == ["change of energy <= 0.1", "change of energy <= 0.001"]


def test_named_methods_have_their_coarsest_good_runs_which_are_kept(stepbench, tmp_path):
    rate = "recommend", "pendulum", "rattle", "ida", "--t-end", "0.5", "--out", tmp_path, "--json"
    result = stepbench(*rate, "--error", "q:1e-3")
    assert result.exit_code == 0, result.output
    told = json.loads((tmp_path / "recommendation.json").read_text())
    assert json.loads(result.stdout) == told
    for own in told["ratings"]:
        assert (own["met"], own["error"] <= 1e-3) == (True, True)
        assert min(own["seconds"], own["operations"]) > 0
    again = json.loads(stepbench(*rate, "--error", "q:1e-3").stdout)
    assert again["ratings"] == told["ratings"]
    with Store(tmp_path) as store:
        assert (
            len({run.environment for run in store.records().values()}) == 1 < len(again["machine"])
        )


@pytest.mark.long
def test_a_file_with_one_scene_gets_its_verdict_and_again_at_once(stepbench, tmp_path, monkeypatch):
    methods = [
        "bdf2",
        "kvaerno5",
        "dopri8",
    ]  # few, so that the search is done before its time is up
    monkeypatch.setattr(recommend, "_methods", lambda *_: methods)
    file = tmp_path / "own.py"
    file.write_text(
        "from problems.scenes.oscillators import Oscillator\n"
        "class OwnMass(Oscillator):\n    'A mass on a spring.'\n    interval = (0.0, 1.0)\n"
    )
    out = tmp_path / "out"
    asked = "recommend", file, "--error", "q:1e-4", "--cost", "operations", "--out", out, "--json"

    def verdict():
        told = json.loads(stepbench(*asked, "--budget", "1e6").stdout)
        assert told == json.loads((out / "recommendation.json").read_text())
        assert told.pop("machine")  # of each invocation
        with Store(out) as store:
            return told, {key: run.environment for key, run in store.records().items()}

    told, runs = verdict()
    first, *others = told["ratings"]
    assert first["problem"] == "own_mass"
    assert first["error"] <= 1e-4
    assert all(first["operations"] <= other["operations"] for other in others)
    assert f"ake {first['integrator']} with {first['resolution']}" in told["sentences"][0]
    assert (out / "report.html").exists() is False  # --json writes no page
    assert verdict() == (told, runs)  # all runs are of the first invocation


@pytest.mark.long
def test_a_demand_that_nobody_meets_is_an_error_with_reasons(stepbench, tmp_path):
    asked = "recommend", "oscillator", "--error", "q:1e-30", "--budget", "30"
    result = stepbench(*asked, "--out", tmp_path / "all")
    assert result.exit_code == 1
    assert "Nothing reaches error in position q" in result.stdout
    assert "No integrator reaches" in result.stderr
    asked = "recommend", "pendulum", "half_explicit_euler", "stormer_verlet", "--t-end", "0.4"
    result = stepbench(*asked, "--error", "q:1e-14", "--budget", "2", "--out", tmp_path, "--json")
    assert result.exit_code == 1
    ratings = json.loads((tmp_path / "recommendation.json").read_text())["ratings"]
    first, second = sorted(ratings, key=lambda own: own["integrator"])
    assert (first["met"], second["met"]) == (False, False)
    assert first["obstacle"].startswith(("Errors do not fall", "budget_exceeded"))
    assert second["obstacle"].startswith("unsupported")
    assert 1e-14 < first["error"] < 1e-3


@pytest.mark.long
def test_the_iftomm_rule_has_two_precisions_of_the_points(stepbench, tmp_path):
    rule = "--rule", "iftomm", "--out", tmp_path, "--t-end", "1", "--json"
    told = json.loads(stepbench("recommend", "iftomm_pendulum", "rattle", *rule).stdout)["ratings"]
    for own, limit in zip(told, (0.1, 1e-3), strict=True):
        assert own["demand"] == f"error of the named points <= {limit:g}"
        assert limit / 4 < own["error"] <= limit
        with Store(tmp_path) as store:
            (run,) = (r for r in store.records().values() if r.resolution == own["resolution"])
        (place,) = run.points.values()
        assert np.hypot(*place) == pytest.approx(1.0, abs=1e-10)
        exact = IFToMMPendulum().exact(np.array([1.0]))["q"][0]
        assert 0.0 < np.abs(place - exact).max() < limit
