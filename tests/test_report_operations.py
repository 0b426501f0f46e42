"""The bill of operations in reports: bars, columns, flat rows."""

from __future__ import annotations

import altair
import pytest
from planted import planted

from bench.results.flat_rows import flatten
from bench.results.quantities import PARTS
from reports.charts.line_styles import line_styles
from reports.charts.work import MOST_BARS, bills
from reports.series import series_of
from reports.tables.run_tables import runs_table, summary_table


def run(name, h, **changes):
    """A run of 1000 operations in each step."""
    operations = {"residuals": 600 / h, "Jacobians": 300 / h, "solves": 100 / h}
    known = {"operations": operations} | changes
    return planted("pendulum", name, {"q": (1.0, 2), "a": (1.0, 2)}, h=h, **known)


def test_a_bar_shows_the_parts_of_its_run_and_of_many_the_finest_is_drawn():
    def drawn(records):
        chart = bills(series_of(records), line_styles(r.integrator for r in records))
        if chart is not None:
            altair.Chart.from_dict(chart, validate=True)
            return chart["datasets"]["bills"]

    text = drawn([run("one", 0.01), run("two", 0.005)])
    assert text.count("\n") == 1 + 2 * 3
    assert '"one, h=0.01: 100000",one,residuals,60.0,0,60000.0' in text
    assert "two, h=0.005: 200000" in text
    many = drawn([run("one", 0.01 / k) for k in range(1, MOST_BARS + 2)])
    assert ("h=0.0004:" in many, "h=0.01:" in many) == (True, False)
    assert drawn([run("one", 0.1, operations={})]) is None


def test_tables_and_flat_rows_have_the_sum_and_every_part():
    for table in (runs_table, summary_table):
        made = table(series_of([run("one", 0.01)]))
        assert dict(zip(made.head, made.rows[0], strict=True))["operations"] == "100000"
    row = flatten(run("one", 0.01), {})
    parts = {part: row["operations_" + part.replace(" ", "_")] for part in PARTS}
    counts = {"residuals": 6e4, "Jacobians": 3e4, "solves": 1e4}
    assert parts == dict.fromkeys(PARTS) | {k: pytest.approx(n) for k, n in counts.items()}
    assert row["operations"] == pytest.approx(1e5)
    assert flatten(run("one", 0.1, operations={}), {})["operations"] is None
