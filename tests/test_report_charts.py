"""Charts of the reports: valid, and true to the numbers they are given."""

from __future__ import annotations

import csv
import io
import json
import math
from xml.etree import ElementTree

import altair
import pytest
import vl_convert
from planted import STEPS, everything, planted

from bench.results.quantities import NORMS
from reports.charts.errors import (
    acceleration_accuracy,
    convergence_chart,
    error_against_cost,
    work_precision_chart,
)
from reports.charts.line_styles import line_styles
from reports.questions.question import Question
from reports.series import series_of


@pytest.mark.long
def test_charts_are_valid_and_join_their_panels_in_one_legend() -> None:
    records = [r for r in everything() if r.problem == "pendulum"]
    for record in records:
        record.run_s = [1e-3, 2e-3]
    series = series_of(records)
    styles = line_styles(s.label for s in series)
    by_step = convergence_chart(series, ["q", "v", "a", "lam"], styles, interactive=True)
    assert len(by_step["concat"]) == 4
    for chart in (
        by_step,
        work_precision_chart(series, ["q", "a"], styles, interactive=True),
        acceleration_accuracy(series, styles, interactive=True),
    ):
        altair.Chart.from_dict(chart, validate=True)
        vega = json.dumps(vl_convert.vegalite_to_vega(chart))
        # The legend has a name only if a click on it is heard.
        assert vega.count('"name": "series_legend_symbols"') == 1


def test_the_legend_of_a_convergence_chart_names_the_fitted_orders() -> None:
    steps = [2.0**-k for k in range(3, 8)]
    records = [planted("pendulum", "m", {"q": (1.0, 2.0), "lam": (1.0, 1.0)}, h=h) for h in steps]
    records += [planted("pendulum", "n", {"q": (1.0, 2.0), "lam": (1.0, 0.0)}, h=h) for h in steps]
    records += [planted("pendulum", "two", {"q": (1.0, 2.0)}, h=h) for h in steps[:2]]
    series = series_of(records)
    styles = line_styles(s.label for s in series)
    svg = vl_convert.vegalite_to_svg(convergence_chart(series, ["q", "lam"], styles))
    text = [element.text for element in ElementTree.fromstring(svg).iter() if element.text]
    assert "m: order q 2.00, lam 1.00" in text
    assert "n: order q 2.00, lam 0.00" in text
    assert "two: order not determined" in text


def test_error_against_cost_has_a_panel_for_each_scene_with_several_integrators() -> None:
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
        rows = csv.DictReader(io.StringIO(chart["datasets"][f"runs on {name}"]))
        shown = {(r["series"], float(r["residuals"]), float(r["a_end"])) for r in rows}
        ok = [r for r in scenes[name] if r.status == "ok" and "a" in r.errors]
        assert shown == {
            (r.integrator, r.work["residuals"], float(f"{r.errors['a']['end']:.5g}")) for r in ok
        }
    assert "<svg" in vl_convert.vegalite_to_svg(chart)
    assert error_against_cost({"alone": series["alone"]}, styles, Question("a", 1, "steps")) is None


def guides(chart: dict) -> dict[str, list[tuple[str, float]]]:
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


def test_guides_to_the_eye_have_the_slope_of_the_whole_orders_found() -> None:
    records = [r for r in everything() if r.problem == "pendulum"]
    series = series_of(records)
    styles = line_styles(s.label for s in series)
    for norm, order in (("end", 2), ("max", 1)):
        found = guides(convergence_chart(series, ["q", "lam"], styles, norm))
        assert found["q"] == [("order 2", pytest.approx(2, abs=1e-3))]
        assert found["lam"] == [(f"order {order}", pytest.approx(order, abs=1e-3))]
    odd = [planted("pendulum", "odd", {"q": (1.0, 1.5)}, h=h) for h in STEPS]
    styles = line_styles(["odd"])
    assert guides(convergence_chart(series_of(odd), ["q"], styles)) == {"q": []}


def test_a_norm_without_errors_is_not_the_first_one_shown() -> None:
    records = [planted("pendulum", "m", {"q": (1.0, 2), "lam": (1.0, 2)}, h=h) for h in STEPS]
    for record in records:
        record.errors["lam"]["end"] = 0.0
        record.errors["q"]["rms"] = record.h**1.5  # an order that is nearly none
    series, styles = series_of(records), line_styles(["m"])
    chart = convergence_chart(series, ["q", "lam"], styles, "end", interactive=True)
    (choice,) = chart["params"]
    assert (choice["value"], choice["bind"]["options"]) == ("max", list(NORMS))
    # Layers hold something in every norm in which there are errors, so that no scale is empty.
    for panel, norms in zip(chart["concat"], (set(NORMS), {"max", "rms", "settled"}), strict=True):
        rows = [row for layer in panel["layer"][:2] for row in layer["data"]["values"]]
        assert {row["norm"] for row in rows} == norms
        unnamed = [row for row in rows if not row["name"]]
        assert all((row["h"], row["error"]) == (row["h2"], row["error2"]) for row in unnamed)
    picture = convergence_chart(series, ["q", "lam"], styles, "end")
    assert [*guides(picture)] == ["q"]
