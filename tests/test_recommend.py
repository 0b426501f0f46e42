"""`stepbench recommend`: a race of all methods, and its verdict."""

from __future__ import annotations

import json
import math
import time
from functools import partialmethod
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planted import planted
from test_refusals import scenes

from bench.results.demands import demand
from bench.results.quantities import NORMS
from bench.results.records import UNSUPPORTED
from bench.running.race import Race
from bench.running.search import MOST_RUNS, Candidate, Search
from integrators.resolutions import Steps

LIMIT = 1e-3


class Power:
    """A method whose error and operations are powers of the step."""

    def __init__(self, name: str, order: float, error: float, per_step: float) -> None:
        self.order, self.error, self.per_step = order, error, per_step
        method = SimpleNamespace(spec=name, name=name, controls="step", family=name, orders={})
        scene = SimpleNamespace(spec="s", name="s", interval=(0.0, 1.0), nominal_step=0.1)
        self.candidate = Candidate(scene, method, 1.0, [demand(f"q:{LIMIT}")])

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
    race = raced(methods)
    assert race.leader is min(methods, key=Power.least).candidate
    assert race.operations(race.leader) == pytest.approx(
        min(m.least() for m in methods), rel=Race.SETTLED - 1
    )
    for method in methods:
        assert race.is_dropped(method.candidate) == (
            method.least() > 1.1 * race.operations(race.leader)
        )
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
    assert race.operations(fine.candidate) == pytest.approx(100.0)


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
    race = raced([odd, good])
    assert len(odd.candidate.runs) <= MOST_RUNS
    assert good.candidate.best(race.asked)
    assert race.promised(odd.candidate) > 0
    if any(0 < e < math.inf for e in errors[: len(odd.candidate.runs)]):
        assert race.promised(odd.candidate) < math.inf


def test_equal_errors_promise_far_more_operations_than_one_good_run():
    """Two equal errors once promised infinitely many, which is no number."""
    good, flat = Power("good", 2, 1e-3, 3.0), Power("flat", 0, 0.5, 3.0)
    for size in (0.1, 0.05):
        good.run(size)
        flat.run(size)
    flat.candidate.runs[0.1].errors["q"] = dict.fromkeys(NORMS, math.nextafter(0.5, 1))
    race = Race([good.candidate, flat.candidate], 1.1, math.inf)
    assert 1e6 < race.promised(flat.candidate) < math.inf
    assert race.is_dropped(flat.candidate)


def test_no_run_begins_when_the_time_is_over_and_none_of_who_refuses():
    method = Power("a", 2, 5.0, 7.0)
    assert Race([method.candidate], 1.1, time.monotonic() - 1.0).next() == []
    method.run(0.1, UNSUPPORTED)
    assert Race([method.candidate], 1.1, math.inf).next() == []
    # A method whose operations are unknown is not dropped for them.
    known, unknown = Power("a", 2, 1e-3, 7.0), Power("b", 2, 10.0, 0.0)
    known.run(0.1)
    unknown.run(0.1)
    race = Race([known.candidate, unknown.candidate], 1.1, math.inf)
    assert race.leader is known.candidate
    assert not race.is_dropped(unknown.candidate)


@pytest.mark.long
def test_a_file_with_one_scene_gets_its_verdict_and_again_at_once(stepbench, tmp_path):
    file = tmp_path / "own.py"
    file.write_text(scenes("OwnMass"))
    out = tmp_path / "out"
    asked = "recommend", file, "--error", "q:1e-4", "--cost", "operations", "--out", out, "--json"
    told = json.loads(stepbench(*asked, "--budget", "40").stdout)
    assert told == json.loads((out / "recommendation.json").read_text())
    first, *others = told["ratings"]
    assert first["problem"] == "own_mass"
    assert first["error"] <= 1e-4
    assert all(first["operations"] <= other["operations"] for other in others)
    assert f"ake {first['integrator']} with {first['resolution']}" in told["sentences"][0]
    assert (out / "report.html").exists() is False  # --json writes no page
    again = stepbench(*asked, "--budget", "40")
    assert "ake " in again.stdout
    assert json.loads(again.stdout)["ratings"][0]["operations"] <= first["operations"]


@pytest.mark.long
def test_it_says_when_nothing_reaches_the_error(stepbench, tmp_path):
    result = stepbench(
        "recommend", "oscillator", "--error", "q:1e-30", "--budget", "30", "--out", tmp_path
    )
    assert result.exit_code == 1
    assert "Nothing reaches error in position q" in result.stdout
    assert "No integrator reaches" in result.stderr


@pytest.fixture
def planted_runs(monkeypatch):
    """A search whose runs cost what a law says: phem56 least, and less with constant steps."""
    costs = {"phem56": 2.0, "rattle": 3.0}

    def run(search, choose, tell, fails=math.inf):
        made = 0
        while cells := choose():
            for cell in cells:
                (c,) = (c for c in search.candidates if c.method.spec == cell.integrator)
                size = getattr(cell.resolution, "h", None) or cell.resolution.rtol
                made += 1
                cost = costs.get(c.method.name, 50.0) / (1 + ("constant" in c.method.spec))
                c.runs[size] = planted(
                    "pendulum", cell.integrator, {"q": (1.0, 1)}, h=size,
                    operations={"residuals": cost / size},
                )  # fmt: skip
            tell()
            if made > fails:
                raise RuntimeError("A later stage raises.")

    monkeypatch.setattr(Search, "run", run)
    monkeypatch.setattr(Search, "take_times", lambda search, runs: None)
    return lambda **changes: monkeypatch.setattr(Search, "run", partialmethod(run, **changes))


ASKED = "recommend", "pendulum", "--error", f"q:{LIMIT}", "--cost", "operations", "--json"


@pytest.mark.usefixtures("without_processes", "planted_runs")
def test_constant_steps_win_where_they_are_cheapest(stepbench, tmp_path):
    told = json.loads(stepbench(*ASKED, "--budget", "600", "--out", tmp_path).stdout)
    assert told["ratings"][0]["integrator"] == "phem56[steps=constant]"
    _, tried = told["sentences"][-1].split(
        "Constant steps and other Newton's methods were tried for "
    )
    assert {"phem56", "rattle"} < {*tried.partition(" alone")[0].split(", ")}
    shown = stepbench(*ASKED[:-1], "--budget", "600", "--out", tmp_path).stdout
    line = 'In a program: bench.solve("pendulum", "phem56[steps=constant]", step='
    assert line in " ".join(shown.split())


@pytest.mark.usefixtures("without_processes")
def test_what_was_found_before_an_error_is_not_lost(stepbench, tmp_path, planted_runs):
    planted_runs(fails=60)
    result = stepbench(*ASKED, "--budget", "600", "--out", tmp_path)
    assert result.exit_code
    told = json.loads((tmp_path / "recommendation.json").read_text())
    assert told["ratings"]
    assert json.loads(result.stdout) == told
