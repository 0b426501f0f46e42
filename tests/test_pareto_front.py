"""The Pareto front: exactly the runs that no other beats in error and cost at once."""

from __future__ import annotations

import csv
import io
import itertools
import random

import altair
import pytest
import vl_convert
from planted import everything, planted

from bench.results.quantities import NORMS
from reports.charts.line_styles import line_styles
from reports.charts.pareto_front import pareto_chart, pareto_front
from reports.questions.question import Question
from reports.series import series_of

COUNTS = Question("a", 1e-4, "residuals")


def run(name, error, residuals, scene="one", floor=1e-15, **changes):
    """A run with this error in q, a tenth of it in a, and these costs."""
    changes = {"run_s": [1e-6 * residuals], "work": {"residuals": residuals}} | changes
    errors = {"q": dict.fromkeys(NORMS, error), "a": dict.fromkeys(NORMS, error / 10)}
    reference_error = {group: dict.fromkeys(NORMS, floor) for group in errors}
    key = f"{scene} | {name} | {error} | {residuals}"
    known = {"key": key, "errors": errors, "reference_error": reference_error}
    return planted(scene, name, {}, h=0.1, **(known | changes))


def on_front(records, group="a", cost="residuals"):
    runs = pareto_front(series_of(records), group, cost)
    return [(r.integrator, r.work["residuals"]) for r in runs]


def test_a_run_is_on_the_front_unless_another_is_no_worse_in_both_and_better_in_one():
    cheap, level, twin = run("a", 1.0, 10), run("b", 1e-2, 100), run("c", 1e-2, 100)
    beaten_in_cost, beaten_in_error = run("d", 1e-2, 101), run("e", 2e-2, 100)
    best, failed = run("f", 1e-4, 1000), run("g", 1e-9, 1, status="newton_failed", errors={})
    records = [best, beaten_in_cost, twin, failed, beaten_in_error, cheap, level]
    assert on_front(records) == [("a", 10), ("c", 100), ("b", 100), ("f", 1000)]


def test_costs_decide_which_front_it_is():
    quick = run("quick", 1e-2, 100, run_s=[1.0, 3.0, 1.0])
    lean = run("lean", 1e-2, 10, run_s=[2.0])
    uncounted = run("uncounted", 1e-9, 1, work={"residuals": None}, run_s=[])
    assert on_front([quick, lean, uncounted]) == [("lean", 10)]
    assert on_front([quick, lean, uncounted], cost="seconds") == [("quick", 100)]


def test_a_cost_of_zero_is_on_the_front():
    explicit = run("explicit", 1e-3, 100, work={"residuals": 100, "jacobians": 0})
    implicit = run("implicit", 1e-2, 10, work={"residuals": 10, "jacobians": 5})
    assert on_front([explicit, implicit], cost="jacobians") == [("explicit", 100)]


def test_the_front_is_that_of_the_largest_error_over_all_times():
    early, late = run("early", 1e-2, 10), run("late", 1e-3, 100)
    late.errors["a"]["end"] = 1.0
    assert on_front([early, late]) == [("early", 10), ("late", 100)]


def test_errors_below_the_trust_in_the_reference_are_equal():
    coarse, enough = run("a", 1e-2, 1, floor=1e-7), run("b", 9e-5, 10, floor=1e-7)
    finer = run("c", 1e-8, 100, floor=1e-7)
    assert on_front([coarse, enough, finer]) == [("a", 1), ("b", 10)]
    for record in (coarse, enough, finer):
        record.reference_error["a"]["max"] = 1e-12
    assert on_front([coarse, enough, finer]) == [("a", 1), ("b", 10), ("c", 100)]


def test_the_front_equals_its_definition_on_many_runs():
    chance = random.Random(5)
    records = [
        run(f"m{k}", 10.0 ** -chance.randint(1, 9), 2 ** chance.randint(1, 9), key=str(k))
        for k in range(150)
    ]

    def beaten(r):
        mine = r.work["residuals"], r.errors["q"]["max"]
        theirs = ((o.work["residuals"], o.errors["q"]["max"]) for o in records)
        return any(o[0] <= mine[0] and o[1] <= mine[1] and o != mine for o in theirs)

    found = {r.key for r in pareto_front(series_of(records), "q", "residuals")}
    assert found == {r.key for r in records if not beaten(r)}
    assert 0 < len(found) < len(records)


def styles(records):
    return line_styles(r.integrator for r in records)


@pytest.mark.parametrize("interactive", [False, True])
def test_the_chart_marks_the_runs_on_each_front(interactive):
    records = [r for r in everything() if r.problem == "pendulum"]
    for record in records:
        record.run_s = [1.0 / record.work["residuals"]] if record.status == "ok" else []
    series = series_of(records)
    chart = pareto_chart({"pendulum": series}, styles(records), interactive)
    altair.Chart.from_dict(chart, validate=True)
    assert "<svg" in vl_convert.vegalite_to_svg(chart)
    rows = list(csv.DictReader(io.StringIO(chart["datasets"]["pareto_front"])))
    assert len(rows) == sum(r.status == "ok" for r in records)
    for group, cost in itertools.product(("q", "a", "lam"), ("seconds", "residuals")):
        marked = {(row["series"], row["run"]) for row in rows if row[f"{group}_{cost}"]}
        wanted = pareto_front(series, group, cost)
        assert marked == {(r.integrator, r.resolution) for r in wanted}


def test_an_own_integrator_stands_against_the_front_of_the_others():
    records = [
        *(run("own", e, c) for e, c in ((1.0, 10), (1e-4, 20), (1e-2, 900))),
        *(run("front", e, c) for e, c in ((1e-1, 15), (1e-3, 50))),
        *(run("beaten", e, c) for e, c in ((1.0, 60), (1e-2, 70))),
        run("other", 1.0, 10, "two"),
        run("another", 1e-2, 10, "two"),
    ]
    scenes = {n: series_of(r for r in records if r.problem == n) for n in ("one", "two")}
    chart = pareto_chart(scenes, styles(records), False, COUNTS, own="own")
    altair.Chart.from_dict(chart, validate=True)
    rows = list(csv.DictReader(io.StringIO(chart["datasets"]["pareto_front"])))
    assert {(r["scene"], r["series"]) for r in rows} == {("one", "own"), ("one", "front")}
    marked = {(r["series"], float(r["residuals"])) for r in rows if r["a_residuals"]}
    assert marked == {("front", 15.0), ("front", 50.0)}
    assert len(rows) == 5
    _, line, _ = chart["spec"]["layer"]
    assert line["transform"] == [{"filter": 'datum.series === "own"'}]


def test_a_scene_with_one_integrator_has_no_front():
    alone = {"alone": series_of([run("a", 1e-2, 10, "alone"), run("a", 1e-4, 100, "alone")])}
    assert pareto_chart(alone, styles([run("a", 1, 1)]), True) is None
