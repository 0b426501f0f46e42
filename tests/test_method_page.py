"""The page of a method: its card, its states at every accuracy, its errors over cost."""

from __future__ import annotations

import csv
import io
import json
import re

import altair
import msgspec
import pytest
import vl_convert
from planted import everything, page_data, plant
from test_ranking import costing as run
from test_ranking import scenes_of

from bench.results.store import Store
from problems.spec import SpecError
from reports.charts.all_scenes import method_strip
from reports.pages.html_report import write_html_report
from reports.questions.method_card import method_card
from reports.ranking import answers


def strip(label, records):
    """{(scene, column): (state, text)} of the strip of an integrator."""
    scenes = scenes_of(records)
    found = [a for q, a in answers(scenes, ["a"]).items() if q.cost == "residuals"]
    own = {k: s for k, series in scenes.items() for s in series if s.label == label}
    chart = method_strip(label, found, own)
    if chart is None:
        return None
    altair.LayerChart.from_dict(chart, validate=True)
    assert vl_convert.vegalite_to_svg(chart).count('fill="#1a7f5a"') > 1  # in cells, too
    rows = csv.DictReader(io.StringIO(chart["datasets"]["strip"]))
    return {(r["scene"], r["target"]): (r["state"], r["text"]) for r in rows}


def test_the_strip_has_a_state_for_each_scene_and_accuracy():
    records = [
        *(run("won", n, c) for n, c in (("me", 10), ("other", 25))),
        *(run("tied", n, 10) for n in ("me", "other")),
        *(run("lost", n, c) for n, c in (("me", 25), ("other", 10))),
        run("lost", "me", 5, error=2.0, h=0.1),
        run("lost", "me", 6, error=2.0, h=0.05, message="It is wrong."),
        run("died", "me", 1, status="newton_failed"),
        run("died", "other", 1),
        run("single_one", "me", 7),
        run("foreign", "other", 7),
    ]
    found = strip("me", records)
    assert {k: state for (k, t), state in found.items() if t == "1e-4"} == {
        "won": ("cheapest alone", ""),
        "tied": ("tied for the cheapest", ""),
        "lost": ("dearer, by this factor", "2.5"),
        "died": ("no run reaches the end", ""),
        "single one": ("reached, with none to compare", ""),
    }
    assert found["won", "1e-6"] == ("not reached", "")
    assert {k: v for k, v in found.items() if k[1] == "wrong"} == {
        ("lost", "wrong"): ("runs wrong without a note", "1 of 3")
    }
    assert len(found) == 5 * 9 + 1
    assert strip("nobody", records) is None


def test_the_page_of_each_method_has_its_charts(tmp_path):
    plant(tmp_path, everything())
    write_html_report(tmp_path)
    text = (tmp_path / "report/method-poor.html").read_text(encoding="utf-8")
    charts = dict(
        re.findall(r'<script type="application/json" data-chart="([^"]*)">(.*?)</script>', text)
    )
    assert list(charts) == ["chart-poor-strip"]
    assert 'id="chart-poor-strip"' in text
    assert 'href="../report.html#highlight=poor" data-highlight="poor"' in text
    rows = csv.DictReader(io.StringIO(json.loads(charts["chart-poor-strip"])["datasets"]["strip"]))
    assert {r["scene"] for r in rows} == {"spring mass"}


@pytest.mark.parametrize("mine", ["poor", "never_run"])
def test_the_front_page_knows_the_own_method(tmp_path, mine):
    plant(tmp_path, everything())
    with Store(tmp_path, create=True) as store:
        store.keep(msgspec.structs.replace(store.plan(), mine=mine))
    write_html_report(tmp_path)
    assert page_data(tmp_path)["first"]["highlight"] == mine * (mine == "poor")


def test_the_card_of_a_method_says_where_it_wins_loses_and_fails(tmp_path):
    plant(tmp_path, everything())
    reaches = "reaches 1e-4 in acceleration (largest over time) on"
    assert method_card(tmp_path, "good[rho_inf=0.8]") == [
        f"good 0.8 (index 3) {reaches} 2 of 2 scenes tried.",
        "Cheapest alone by operations: spring mass.",
        "Dearer than the cheapest by operations: pendulum (1.92 times the cost of adaptive).",
        "All of its runs reached the end.",
    ]
    assert method_card(tmp_path, "poor") == [
        f"poor {reaches} 0 of 1 scene tried.",
        "Does not reach it: spring mass (smallest error: 0.00938).",
        "All of its runs reached the end.",
        "Wrong without warning: 2 of 6 runs that reached the end "
        "(error in acceleration above 0.1, largest over time).",
    ]
    assert method_card(tmp_path, "fragile")[1:] == [
        "Fails: pendulum (2 newton failed).",
        "2 of its 2 runs failed: pendulum (2).",
    ]
    assert len(method_card(tmp_path, "good")) == 7  # of two variants
    with pytest.raises(SpecError, match="did you mean 'poor'"):
        method_card(tmp_path, "pooor")
