"""Charts with menus, and charts over time: their numbers are those of the records."""

from __future__ import annotations

import csv
import io

import pytest
from planted import curves, everything, plant

from bench.results.quantities import NORMS
from bench.results.records import Rows
from bench.results.store import Store
from reports.charts.errors import acceleration_accuracy, work_precision_chart
from reports.charts.line_styles import line_styles
from reports.charts.over_time import ERRORS, STILL_ROWS, histories, thinned, trajectory_chart
from reports.pages.report import read_report
from reports.series import series_of


def table(text):
    return list(csv.DictReader(io.StringIO(text)))


@pytest.fixture
def series():
    records = [r for r in everything() if r.problem == "pendulum"]
    for i, record in enumerate(records):
        record.run_s = [1e-3 * (i + 1), 2e-3 * (i + 1), 4e-3 * (i + 1)]
    return series_of(records)


@pytest.fixture
def styles(series):
    return line_styles(s.label for s in series)


def test_the_chart_of_costs_holds_the_errors_in_every_norm_beside_the_costs(series, styles):
    chart = work_precision_chart(series, ["q", "v", "a", "lam"], styles, interactive=True)
    rows = table(chart["datasets"]["runs"])
    runs = [(s, r) for s in series for r in s.ok]
    assert len(rows) == len(runs)
    label, record = runs[0][0].label, runs[0][1]
    (mine,) = [row for row in rows if (row["series"], row["run"]) == (label, record.resolution)]
    for group in ("q", "v", "a", "lam"):
        for norm in NORMS:
            wanted = pytest.approx(record.errors[group][norm], rel=1e-4)
            assert float(mine[f"{group}_{norm}"]) == wanted
    assert float(mine["seconds"]) == pytest.approx(sorted(record.run_s)[1])
    assert (float(mine["fastest"]), float(mine["slowest"])) == pytest.approx(
        (min(record.run_s), max(record.run_s))
    )
    assert int(mine["residuals"]) == record.work["residuals"]
    (buttons,) = chart["params"]
    assert buttons["bind"]["options"] == list(NORMS)
    axes = [
        tuple(panel["layer"][0]["encoding"][c]["title"].split()[-1] for c in "yx")
        for panel in chart["concat"]
    ]
    assert [group for group, _ in axes] == ["q", "v", "a", "λ"] * 2


def test_a_reference_that_is_near_is_drawn_as_a_floor(series, styles):
    chart = work_precision_chart(series, ["q"], styles, interactive=True)
    assert "datum.seen" not in str(chart)  # 1e-15, far below
    for record in series[0].records:
        record.reference_error["q"]["max"] = 1e-4
    chart = work_precision_chart(series, ["q"], styles, interactive=True)
    floors = chart["concat"][0]["layer"][0]["data"]["values"]
    assert [row for row in floors if row["seen"]] == [{"norm": "max", "floor": 1e-4, "seen": 1}]
    # Elsewhere an unseen line that widens no axis.
    assert [row["norm"] for row in floors if not row["seen"]] == ["end", "rms", "settled"]
    lowest = min(r.errors["q"]["rms"] for s in series for r in s.ok)
    assert {row["floor"] for row in floors if not row["seen"]} == {float(f"{lowest:.5g}")}


def test_acceleration_stands_beside_position(series, styles):
    chart = acceleration_accuracy(series, styles, "max")
    points = {(float(r["q_max"]), float(r["a_max"])) for r in table(chart["datasets"]["accuracy"])}
    wanted = {
        (float(f"{r.errors['q']['max']:.5g}"), float(f"{r.errors['a']['max']:.5g}"))
        for s in series
        for r in s.ok
    }
    assert points == wanted
    assert acceleration_accuracy([], styles) is None


def test_only_what_varies_is_drawn_over_time(styles):
    label = next(iter(styles))
    rows = curves(1.0, {"q": 1})
    count = len(rows.t)
    rows.notes = {
        "h": [None, *(1e-3 * (1 + k % 3) for k in range(1, count))],
        "gamma": [None, *[0.6] * (count - 1)],
        "position": [0.0, *(1e-12 * k for k in range(1, count))],
    }
    chart = histories([(label, rows)], styles)
    drawn = [panel["layer"][0]["encoding"]["y"]["field"] for panel in chart["concat"]]
    assert drawn == ["h", "position"]
    values = [row["h"] for row in table(chart["datasets"]["histories"])]
    assert values[0] == ""  # no step led to the start
    assert [float(v) for v in values[1:]] == pytest.approx(rows.notes["h"][1:])
    assert histories([(label, curves(1.0, {"q": 1}))], styles) is None


def test_errors_over_time_are_drawn_logarithmically_a_panel_for_each_group(styles):
    label, rows = next(iter(styles)), curves(1.0, {"q": 1})
    rows.notes = {f"error_{g}": [0.0, *(10.0**-k for k in range(60))] for g in ("q", "a")}
    chart = histories([(label, rows)], styles, notes=tuple(ERRORS))
    axes = [panel["layer"][0]["encoding"]["y"] for panel in chart["concat"]]
    assert [axis["title"] for axis in axes] == ["error in position q", "error in acceleration a"]
    assert {axis["scale"]["type"] for axis in axes} == {"log"}
    assert float(table(chart["datasets"]["histories"])[8]["error_a"]) == 1e-7


def test_a_legend_has_short_names_and_the_data_the_printed_ones():
    label = "generalized_alpha[rho_inf=0.8]"
    rows = curves(1.0, {"q": 1})
    rows.notes = {"error_q": [10.0**-k for k in range(61)]}
    chart = histories([(label, rows)], line_styles([label]))
    color = chart["concat"][0]["layer"][0]["encoding"]["color"]
    assert color["scale"]["domain"] == [label]
    assert "g\\u03b1 0.8" in color["legend"]["labelExpr"]
    assert {row["series"] for row in table(chart["datasets"]["histories"])} == {label}


def test_a_scene_s_page_shows_errors_over_time_where_they_are_stored(tmp_path):
    folder = plant(tmp_path, everything())
    chapters = {c.name: c for c in read_report(folder, interactive=True).scenes}
    assert all("errors" not in name for name in _over_time(chapters["pendulum"]))
    with Store(folder, create=True) as store:
        for key, record in store.records().items():
            if rows := store.rows(key) if record.problem == "pendulum" else None:
                rows.notes = {"error_q": [1e-3 * (1 + k) for k in range(len(rows.t))]}
                store.save(record, rows)
    chapters = {c.name: c for c in read_report(folder, interactive=True).scenes}
    assert _over_time(chapters["pendulum"])[0] == "scene-2-1-errors"
    assert _over_time(chapters["spring_mass"]) == ["scene-1-1-trajectory"]


def _over_time(chapter):
    figures = [f for study in chapter.studies for f in study.figures if f.topic == "time"]
    return [name for figure in figures for name in figure.charts]


def test_a_study_chooses_what_is_drawn_over_time(styles):
    label = next(iter(styles))
    rows = curves(1.0, {"q": 5, "x": 2})
    chart = trajectory_chart(
        [(label, rows)], None, ["q", "x"], styles, components=[("q", 4), ("x", 0)]
    )
    fields = [panel["layer"][-1]["encoding"]["y"]["field"] for panel in chart["concat"]]
    assert fields == ["q4", "x0"]
    first = table(chart["datasets"]["runs"])[0]
    assert float(first["q4"]) == pytest.approx(rows.values["q"][0][4], rel=1e-4)
    assert "q0" not in first


def test_a_path_is_drawn_over_another_component_in_the_order_of_time(styles):
    label = next(iter(styles))
    rows = curves(1.0, {"q": 2, "x": 1})
    chosen = [("q", 1, "q", 0), ("x", 0)]
    chart = trajectory_chart([(label, rows)], rows, ["q", "x"], styles, components=chosen)
    path, over_time = chart["concat"]
    for layer in path["layer"]:  # the reference and the run
        axes = layer["encoding"]
        assert [axes[c]["field"] for c in ("x", "y", "order")] == ["q0", "q1", "t"]
    assert path["layer"][1]["encoding"]["x"]["title"] == "q[1]"
    assert over_time["layer"][1]["encoding"]["x"]["field"] == "t"
    first = table(chart["datasets"]["runs"])[0]
    assert float(first["q0"]) == pytest.approx(rows.values["q"][0][0], rel=1e-4)


def test_a_still_picture_shows_few_rows_and_the_last_among_them():
    count = 3 * STILL_ROWS + 1
    t = [float(k) for k in range(count)]
    long = Rows(t=t, values={"q": [[2 * x] for x in t]}, notes={"h": t})
    shown = thinned(long)
    assert len(shown.t) <= STILL_ROWS + 1
    assert (shown.t[0], shown.t[-1]) == (0.0, t[-1])
    assert shown.values["q"] == [[2 * x] for x in shown.t]
    assert shown.notes["h"] == shown.t
    few = Rows(t=t[:5], values={"q": [[0.0]] * 5})
    assert thinned(few) == few
    assert thinned(Rows(t=[])) == Rows(t=[])
