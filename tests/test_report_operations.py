"""The bill in reports: bars, columns, flat rows; where seconds and operations disagree."""

from __future__ import annotations

import altair
from planted import planted

from bench.results.flat_rows import flatten
from bench.results.quantities import PARTS
from bench.results.records import Record
from reports.charts.bills import MOST_BARS, bills
from reports.charts.line_styles import line_styles
from reports.series import series_of
from reports.text.observations import observations
from reports.text.run_tables import runs_table, summary_table


def run(name: str, h: float, ns: float, calls: str = "", factor: float = 1.0) -> Record:
    """A run of 1000 operations in each step, and ``ns`` nanoseconds for each of them."""
    steps = factor / h
    operations = {"residuals": 600 * steps, "Jacobians": 300 * steps, "solves": 100 * steps}
    seconds = 1000 * steps * ns * 1e-9
    changes = {"operations": operations, "run_s": [seconds] * 3, "calls": calls}
    return planted("pendulum", name, {"q": (1.0, 2), "a": (1.0, 2)}, h=h, **changes)


def told(*records: Record) -> dict[tuple[str, ...], str]:
    return {o.integrators: o.text for o in observations(series_of(records))}


def drawn(records):
    return bills(series_of(records), line_styles(r.integrator for r in records))


def test_a_method_far_from_the_median_is_told_with_its_own_reason():
    usual = [run(name, 0.01, 2.0) for name in ("one", "two", "three")]
    found = told(*usual, run("slow", 0.01, 2.0 * 3.1, "its loop is Python"))
    assert found == {
        ("slow",): "in its finest run an operation takes 3.1 times the median of the integrators' "
        "finest runs (2 ns): its loop is Python."
    }
    assert told(*usual, run("near", 0.01, 2.0 * 2.9, "its loop is Python")) == {}
    # What integrators on both sides of the median state explains neither.
    compiled = "its loop is compiled"
    both = run("slow", 0.01, 9.0, compiled), run("fast", 0.01, 0.4, compiled)
    slow, fast = told(*usual, *both).values()
    assert slow.endswith("no cause is known; faster ones state the same (its loop is compiled).")
    assert fast.endswith("no cause is known; slower ones state the same (its loop is compiled).")
    for own, median in zip(both, (2.0, 2.0), strict=True):
        (text,) = told(*usual, own).values()
        assert text.endswith(f"({median:g} ns): its loop is compiled.")
    silent = run("slow", 0.01, 9.0), run("fast", 0.01, 0.4)
    assert [text.count(" to ") for text in told(*usual, *silent).values()] == [0, 0]
    (text,) = told(*usual, run("fast", 0.01, 2.0 / 4)).values()
    assert "takes 0.25 times the median" in text
    assert "does not state how it calls" in text
    # The reason is the method's own; methods with one reason share a sentence.
    (names,) = told(*usual, run("b", 0.01, 20.0, "x"), run("c", 0.01, 30.0, "x"))
    assert names == ("b", "c")


def test_an_operation_counts_not_the_number_of_them():
    usual = [run(name, 0.01, 2.0) for name in ("one", "two", "three")]
    assert told(*usual, run("dear", 0.01, 2.0, factor=100.0)) == {}


def test_fixed_costs_of_short_runs_are_told():
    records = [run("one", 0.1, 20.0), run("one", 0.001, 2.0), run("two", 0.001, 2.0)]
    (names,) = told(*records)
    assert names == ("one",)
    assert "fixed costs" in told(*records)[names]
    assert told(run("one", 0.1, 2.0 * 2.9), *records[1:]) == {}


def test_runs_without_a_bill_or_a_time_are_left_out():
    unknown = planted("pendulum", "one", {"q": (1.0, 2)}, h=0.1, operations={})
    assert told(unknown) == {}
    assert drawn([unknown]) is None


def test_a_bar_shows_the_parts_of_its_run_and_their_sum():
    chart = drawn([run("one", 0.01, 2.0), run("two", 0.01, 2.0, factor=2)])
    assert chart is not None
    altair.Chart.from_dict(chart, validate=True)
    text = chart["datasets"]["bills"]
    assert text.count("\n") == 1 + 2 * 3
    assert '"one, h=0.01: 100000",one,residuals,60.0,0,60000.0' in text
    assert "two, h=0.01: 200000" in text


def test_of_many_runs_the_finest_of_each_integrator_is_drawn():
    records = [run("one", 0.01 / k, 2.0) for k in range(1, MOST_BARS + 2)]
    chart = drawn(records)
    assert chart is not None
    assert "h=0.0004:" in chart["datasets"]["bills"]
    assert "h=0.01:" not in chart["datasets"]["bills"]


def test_tables_have_the_sum():
    for table in [runs_table, summary_table]:
        made = table(series_of([run("one", 0.01, 2.0)]))
        row = dict(zip(made.head, made.rows[0], strict=True))
        assert row["operations"] == "100000"


def test_flat_rows_have_the_sum_and_every_part():
    row = flatten(run("one", 0.01, 2.0), {})
    parts = {part: row["operations_" + part.replace(" ", "_")] for part in PARTS}
    assert parts == {
        "residuals": 6e4, "Jacobians": 3e4, "inner solves": None, "factorisations": None,
        "solves": 1e4, "method": None,
    }  # fmt: skip
    assert row["operations"] == 1e5
    assert flatten(planted("pendulum", "one", {}, h=0.1, operations={}), {})["operations"] is None
