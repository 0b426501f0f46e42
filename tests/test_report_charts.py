"""Charts of the reports: valid, and true to the numbers they are given."""

from __future__ import annotations

import json
import math
from xml.etree import ElementTree

import altair
import numpy as np
import pytest
import vl_convert
from planted import STEPS, chart_rows, curves, everything, plant, planted

from bench.results.flat_rows import flatten
from bench.results.quantities import COSTS, PARTS
from bench.results.records import Rows, SceneRecord
from bench.results.store import Store
from bench.running.measure import MOST_COMPONENTS, stored_rows
from bench.running.scene_records import scene_record
from problems.scenes.pendulums import Chain
from problems.truth.reference import Reference, ReferenceFailed
from reports.charts.errors import convergence_chart, error_against_cost, error_charts
from reports.charts.line_styles import line_styles
from reports.charts.over_time import (
    ERRORS,
    HISTORIES,
    MOST_ROWS,
    histories,
    thinned,
    trajectory_chart,
)
from reports.charts.work import MOST_BARS, bills, size_charts
from reports.pages.page import Page
from reports.pages.report import read_report
from reports.questions import Question
from reports.series import series_of
from reports.tables.run_tables import runs_table, summary_table


def near(value):
    """The number that a chart has for it."""
    return float(f"{value:.5g}")


@pytest.fixture
def series():
    records = [r for r in everything() if r.problem == "pendulum"]
    for i, record in enumerate(records):
        record.run_s = [1e-3 * (i + 1), 2e-3 * (i + 1), 4e-3 * (i + 1)]
    return series_of(records)


@pytest.fixture
def styles(series):
    return line_styles(s.label for s in series)


# ---- errors ------------------------------------------------------------------------------
@pytest.mark.long
def test_charts_are_valid_and_join_their_panels_in_one_legend(series, styles):
    by_step = convergence_chart(series, ["q", "v", "a", "lam"], styles)
    assert len(by_step["concat"]) == 4
    costs = ["seconds", "residuals"]
    for chart in (
        by_step,
        error_charts(series, ["q", "a"], costs, styles),
        error_charts(series, ["a"], ["q"], styles),
    ):
        altair.Chart.from_dict(chart, validate=True)
        vega = json.dumps(vl_convert.vegalite_to_vega(chart))
        # The legend has a name only if a click on it is heard.
        assert vega.count('"name": "series_legend_symbols"') == 1


def test_errors_against_costs_and_each_other_are_those_of_the_records(series, styles):
    groups, runs = ["q", "a", "lam"], [(s, r) for s in series for r in s.ok]
    for norm in ("max", "end"):
        chart = error_charts(series, groups, ["seconds", "residuals", "q"], styles, norm)
        columns = ("seconds", "residuals", *(f"{g}_{norm}" for g in groups))
        shown = {
            (row["series"], row["run"], *(near(float(row[c])) for c in columns))
            for row in chart_rows(chart, "runs")
        }
        assert shown == {
            (s.label, r.resolution, near(r.seconds), r.work["residuals"], *errors)
            for s, r in runs
            for errors in [[near(r.errors[g][norm]) for g in groups]]
        }
        axes = [[p["layer"][-1]["encoding"][c] for c in "xy"] for p in chart["concat"]]
        assert [(x["field"], y["field"]) for x, y in axes] == [
            (x, f"{y}_{norm}") for x in ("seconds", "residuals", f"q_{norm}") for y in groups
        ]
        assert axes[0][0]["title"] == COSTS["seconds"].title
        assert axes[1][1]["title"] == "relative error in acceleration a" + (
            "" if norm == "max" else ", at the end"
        )
    assert error_charts([], ["a"], ["q"], styles) is None


def test_a_reference_that_is_near_is_drawn_as_a_floor(series, styles):
    def floors():
        (panel,) = error_charts(series, ["q"], ["seconds"], styles)["concat"]
        return [layer["data"]["values"] for layer in panel["layer"] if "data" in layer]

    assert floors() == []  # 1e-15, far below
    for record in series[0].records:
        record.reference_error["q"]["max"] = 1e-4
    assert floors() == [[{"floor": 1e-4}]]


def test_the_legend_names_the_fitted_orders_by_short_names():
    label = "generalized_alpha[rho_inf=0.8]"
    steps = [2.0**-k for k in range(3, 8)]
    records = [planted("pendulum", label, {"q": (1.0, 2.0), "lam": (1.0, 1.0)}, h=h) for h in steps]
    records += [planted("pendulum", "n", {"q": (1.0, 2.0), "lam": (1.0, 0.0)}, h=h) for h in steps]
    records += [planted("pendulum", "two", {"q": (1.0, 2.0)}, h=h) for h in steps[:2]]
    series = series_of(records)
    chart = convergence_chart(series, ["q", "lam"], line_styles(s.label for s in series))
    svg = vl_convert.vegalite_to_svg(chart)
    text = [element.text for element in ElementTree.fromstring(svg).iter() if element.text]
    assert {"gα 0.8: order q 2.00, λ 1.00", "n: order q 2.00, λ 0.00"} <= set(text)
    assert "two: order not determined" in text
    assert {row["series"] for row in chart_rows(chart, "runs")} == {label, "n", "two"}
    # Of a family with both starts each is told.
    other = f"{label[:-1]},formulation=stabilised_index2,start=corrected]"
    records = [r for r in records if r.integrator == label]
    records += [planted("pendulum", other, {"q": (1.0, 2.0)}, h=h) for h in steps]
    records += [planted("pendulum", "n", {"q": (1, 2)}, h=h, family="newmark") for h in steps]
    series = series_of(records)
    chart = convergence_chart(series, ["q"], line_styles(s.label for s in series))
    names = chart["concat"][0]["layer"][-1]["encoding"]["color"]["legend"]["labelExpr"]
    assert [*json.loads(names.partition("[datum")[0].lstrip("(")).values()] == [
        "gα 0.8 · plain start: order q 2.00",
        "gα 0.8 · GGL · corrected start: order q 2.00",
        "n: order q 2.00",
    ]


def test_error_against_cost_has_a_panel_for_each_scene_with_several_integrators():
    records = everything()
    records.append(planted("alone", "good[rho_inf=0.8]", {"a": (1.0, 2.0)}, h=0.1))
    scenes: dict[str, list] = {}
    for r in records:
        scenes.setdefault(r.problem, []).append(r)
    series = {name: series_of(own) for name, own in scenes.items()}
    styles = line_styles(r.integrator for r in records)
    chart = error_against_cost(series, styles, Question("a", 1e-4, "residuals", "end"))
    altair.ConcatChart.from_dict(chart, validate=True)
    titles = [panel["title"]["text"] for panel in chart["concat"]]
    assert titles == ["spring mass", "pendulum"]
    for name in ("spring_mass", "pendulum"):
        rows = chart_rows(chart, f"runs on {name}")
        shown = {(r["series"], float(r["residuals"]), float(r["a_end"])) for r in rows}
        ok = [r for r in scenes[name] if r.status == "ok" and "a" in r.errors]
        assert shown == {
            (r.integrator, r.work["residuals"], near(r.errors["a"]["end"])) for r in ok
        }
    assert "<svg" in vl_convert.vegalite_to_svg(chart)
    alone = {"alone": series["alone"]}
    assert error_against_cost(alone, styles, Question("a", 1, "residuals")) is None


def guides(chart):
    """Name and slope of the guides to the eye of each panel."""
    return {
        panel["layer"][-1]["encoding"]["y"]["field"].partition("_")[0]: [
            (row["name"], math.log(row["error"] / row["error2"]) / math.log(row["h"] / row["h2"]))
            for layer in panel["layer"]
            if layer["mark"]["type"] == "rule"
            for row in layer["data"]["values"]
        ]
        for panel in chart["concat"]
    }


def test_guides_to_the_eye_have_the_slope_of_the_whole_orders_found(series, styles):
    for norm, order in (("end", 2), ("max", 1)):
        found = guides(convergence_chart(series, ["q", "lam"], styles, norm))
        assert found["q"] == [("order 2", pytest.approx(2, abs=1e-3))]
        assert found["lam"] == [(f"order {order}", pytest.approx(order, abs=1e-3))]
    odd = [planted("pendulum", "odd", {"q": (1.0, 1.5)}, h=h) for h in STEPS]
    assert guides(convergence_chart(series_of(odd), ["q"], line_styles(["odd"]))) == {"q": []}


# ---- over time ---------------------------------------------------------------------------
def test_only_what_varies_is_drawn_over_time_errors_logarithmically(styles):
    label, rows = next(iter(styles)), curves(1.0, {"q": 1})
    count = len(rows.t)
    rows.notes = {
        "h": [None, *(1e-3 * (1 + k % 3) for k in range(1, count))],
        "gamma": [None, *[0.6] * (count - 1)],
        "position": [0.0, *(1e-12 * k for k in range(1, count))],
        "error_a": [0.0, *(10.0**-k for k in range(count - 1))],
    }
    bare = [*styles][-1], curves(1.0, {"q": 1})  # it has no line, nor a place in the legend
    chart = histories([(label, rows), bare], styles, tuple(HISTORIES))
    color = chart["concat"][0]["layer"][0]["encoding"]["color"]
    assert color["scale"]["domain"] == [label] != [bare[0]]
    axes = [panel["layer"][0]["encoding"]["y"] for panel in chart["concat"]]
    assert [axis["field"] for axis in axes] == ["error_a", "h", "position"]
    assert axes[0]["title"] == "error in acceleration a"
    assert {axis["scale"]["type"] for axis in axes} == {"log"}
    shown = chart_rows(chart, "histories")
    assert shown[0]["h"] == ""  # no step led to the start
    assert [float(row["h"]) for row in shown[1:]] == pytest.approx(rows.notes["h"][1:])
    assert float(shown[8]["error_a"]) == 1e-7
    assert histories([(label, curves(1.0, {"q": 1}))], styles, tuple(ERRORS)) is None


def test_a_scene_s_page_shows_errors_over_time_where_they_are_stored(tmp_path):
    def over_time(name):
        (page,) = [p for p in read_report(folder).scenes if p.values["key"] == name]
        tab = Page("", "", sections=[page.values["tabs"][1]])
        return [name for figure in tab.figures for name in figure.charts]

    folder = plant(tmp_path, everything())
    assert over_time("pendulum") == ["scene-2-1-trajectory"]
    with Store(folder, create=True) as store:
        for key, record in store.records().items():
            if rows := store.rows(key) if record.problem == "pendulum" else None:
                rows.notes = {"error_q": [1e-3 * (1 + k) for k in range(len(rows.t))]}
                store.save(record, rows)
    assert over_time("pendulum")[0] == "scene-2-1-errors"
    assert over_time("spring_mass") == ["scene-1-1-trajectory"]


def test_a_study_chooses_what_is_drawn_over_time_or_over_another_component(styles):
    label, rows = next(iter(styles)), curves(1.0, {"q": 5, "x": 2})
    chosen = [[("q", 4)], [("x", 0)], [("q", 1), ("q", 0)]]
    chart = trajectory_chart([(label, rows)], rows, ["q", "x"], styles, {}, chosen)
    for panel, (x, y) in zip(
        chart["concat"], (("t", "q4"), ("t", "x0"), ("q0", "q1")), strict=True
    ):
        for layer in panel["layer"]:  # the reference and the run
            assert [layer["encoding"][c]["field"] for c in ("x", "y", "order")] == [x, y, "t"]
    assert chart["concat"][2]["layer"][1]["encoding"]["x"]["title"] == "q[1]"
    first = chart_rows(chart, "runs")[0]
    assert float(first["q4"]) == pytest.approx(rows.values["q"][0][4], rel=1e-4)
    assert "q2" not in first


def test_a_trajectory_has_every_value_of_the_runs_and_of_the_reference():
    runs = [(k, curves(1.0, {"q": 2, "lam": 1}, size)) for k, size in (("one", 1.1), ("two", 1.2))]
    reference = curves(1.0, {"q": 2, "lam": 1})
    styles, names = line_styles(["one", "two"]), {"q": ["X [m]", "Y [m]"]}
    chart = trajectory_chart(runs, reference, ["q", "lam"], styles, names)
    axes = [panel["layer"][-1]["encoding"]["y"] for panel in chart["concat"]]
    titles = {"q0": "q[X] in m", "q1": "q[Y] in m", "lam0": "λ[1]"}
    assert {axis["field"]: axis["title"] for axis in axes} == titles
    for table, drawn in (("runs", runs), ("reference", [("reference", reference)])):
        shown = [(r["series"], *(float(r[c]) for c in ("t", *titles))) for r in
                 chart_rows(chart, table)]  # fmt: skip
        assert shown == [
            (label, *map(near, (t, *q, *lam)))
            for label, run in drawn
            for t, q, lam in zip(run.t, run.values["q"], run.values["lam"], strict=True)
        ]


def test_a_chart_shows_few_rows_and_the_last_among_them():
    count = 3 * MOST_ROWS + 1
    t = [float(k) for k in range(count)]
    shown = thinned(Rows(t=t, values={"q": [[2 * x] for x in t]}, notes={"h": t}))
    assert len(shown.t) <= MOST_ROWS + 1
    assert (shown.t[0], shown.t[-1]) == (0.0, t[-1])
    assert shown.values["q"] == [[2 * x] for x in shown.t]
    assert shown.notes["h"] == shown.t
    few = Rows(t=t[:5], values={"q": [[0.0]] * 5})
    assert thinned(few) == few
    assert thinned(Rows(t=[])) == Rows(t=[])


# ---- operations -------------------------------------------------------------------------
def counted(name, h, **changes):
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

    text = drawn([counted("one", 0.01), counted("two", 0.005)])
    assert text.count("\n") == 1 + 2 * 3
    assert '"one, h=0.01: 100000",one,residuals,60.0,0,60000.0' in text
    assert "two, h=0.005: 200000" in text
    many = drawn([counted("one", 0.01 / k) for k in range(1, MOST_BARS + 2)])
    assert ("h=0.0004:" in many, "h=0.01:" in many) == (True, False)
    assert drawn([counted("one", 0.1, operations={})]) is None


def test_tables_and_flat_rows_have_the_sum_and_every_part():
    one = counted("one", 0.01)
    series = series_of([one])
    for made in (runs_table(series, {one.key: "run-1"}, {}), summary_table(series)):
        assert dict(zip(made.head, made.rows[0], strict=True))["operations"] == "100000"
    row = flatten(counted("one", 0.01), {})
    parts = {part: row["operations_" + part.replace(" ", "_")] for part in PARTS}
    counts = {"residuals": 6e4, "Jacobians": 3e4, "solves": 1e4}
    assert parts == dict.fromkeys(PARTS) | {k: pytest.approx(n) for k, n in counts.items()}
    assert row["operations"] == pytest.approx(1e5)
    assert flatten(counted("one", 0.1, operations={}), {})["operations"] is None


def scene(problem, t_end, nq, nl):
    sizes = {"nq": nq, "nl": nl, "nx": 0, "ny": 0}
    return SceneRecord(problem=problem, t0=0.0, t_end=t_end, sizes=sizes)


def run(links, method, steps, seconds, t_end=2.0, **changes):
    return planted(
        f"chain[links={links}]", method, {}, h=t_end / steps, t_end=t_end,
        key=f"{links} {method} {steps}", run_s=[seconds], work={"steps": steps}, **changes,
    )  # fmt: skip


SCENES = {f"chain[links={n}]": scene(f"chain[links={n}]", 2.0, 2 * n, n) for n in (10, 100, 1000)}


def drawn(records, scenes=SCENES):
    styles = line_styles(r.integrator for r in records)
    series = {r.problem: series_of(x for x in records if x.problem == r.problem) for r in records}
    return size_charts(series, scenes, styles)


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
    with pytest.raises(ReferenceFailed, match="450 unknowns"):
        Reference(large, 0.1)(np.array([0.1]))
    assert not Reference(Chain(links=100), 0.1).missing
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
