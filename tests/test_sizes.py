"""Cost against size: charts of the right runs, and short records of large scenes."""

from __future__ import annotations

import altair
import numpy as np
import pytest
import vl_convert
from planted import chart_rows, planted

from bench.results.records import SceneRecord
from bench.running.measure import MOST_COMPONENTS, stored_rows
from bench.running.scene_records import scene_record
from problems.scenes.pendulums import Chain
from problems.truth.reference import Reference
from reports.charts.line_styles import line_styles
from reports.charts.work import size_charts


def scene(problem, t_end, nq, nl):
    sizes = {"nq": nq, "nl": nl, "nx": 0, "ny": 0}
    return SceneRecord(problem=problem, t0=0.0, t_end=t_end, sizes=sizes)


def run(links, method, steps, seconds, t_end=2.0, **changes):
    return planted(
        f"chain[links={links}]", method, {}, h=t_end / steps, t_end=t_end,
        key=f"{links} {method} {steps}", run_s=[seconds], work={"steps": steps}, **changes,
    )  # fmt: skip


SCENES = {
    (f"chain[links={n}]", 2.0): scene(f"chain[links={n}]", 2.0, 2 * n, n) for n in (10, 100, 1000)
}


def drawn(records, scenes=SCENES):
    styles = line_styles(r.integrator for r in records)
    return size_charts(records, scenes, styles)


def test_the_run_with_the_most_steps_is_drawn_at_its_number_of_unknowns():
    records = [run(n, "ours", steps, 1e-3 * n * steps / 100) for n in (10, 100, 1000)
               for steps in (100, 200)]  # fmt: skip
    (chart,) = drawn(records).values()
    rows = chart_rows(chart, "sizes-chain")
    assert [int(row["unknowns"]) for row in rows] == [30, 300, 3000]
    # 200 steps of n x 1e-5 s each over 2 s.
    assert [float(r["per_step"]) for r in rows] == pytest.approx([1e-4, 1e-3, 1e-2])
    assert [float(r["per_second"]) for r in rows] == pytest.approx([1e-2, 1e-1, 1.0])
    assert [float(r["per_unknown"]) for r in rows] == pytest.approx([1e-4 / 30] * 3, rel=1e-4)
    altair.Chart.from_dict(chart)
    assert "ours" in vl_convert.vegalite_to_svg(chart)


def test_two_sizes_make_no_line_and_failed_or_untimed_runs_no_point():
    two = [run(n, "ours", 100, 1.0) for n in (10, 100)]
    assert drawn(two) == {}
    failed = run(1000, "ours", 100, 1.0, status="newton_failed")
    untimed = run(1000, "theirs", 100, 1.0)
    untimed.run_s = []
    assert drawn([*two, failed, untimed]) == {}
    assert drawn([*two, run(1000, "ours", 100, 1.0)], scenes={}) == {}


def test_of_a_large_scene_the_record_says_why_it_has_no_reference():
    large = Chain(links=150)
    record = scene_record(large, 0.1, lambda: Reference(large, 0.1))
    assert "450 unknowns" in record.reference_method
    assert (record.reference.t, record.drawings, record.rates) == ([], [], None)
    assert record.sizes == {"nq": 300, "nl": 150, "nx": 0, "ny": 0}


def test_of_large_groups_the_first_components_are_stored():
    t = np.linspace(0, 1, 3)
    values = dict.fromkeys(("v", "a", "x", "xdot", "y"), np.zeros((3, 0)))
    values |= {"t": t, "q": np.arange(900.0).reshape(3, 300), "lam": np.ones((3, 5))}
    rows = stored_rows(values)
    assert np.shape(rows.values["q"]) == (3, MOST_COMPONENTS)
    assert rows.values["q"][2][0] == 600.0
    assert np.shape(rows.values["lam"]) == (3, 5)
