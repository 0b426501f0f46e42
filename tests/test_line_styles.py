"""Colours, marks and dashes: fixed by the name, legible on every paper, not twice in a figure."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from itertools import combinations
from pathlib import Path

import pytest
import vl_convert
from hypothesis import given, settings
from hypothesis import strategies as st

from reports.charts.line_styles import line_styles, luminance, paper_line_styles, style_of
from reports.names import BUILT_IN

PAPERS = {"light": ("#ffffff", "#f8fafc"), "dark": ("#0f172a", "#15181c")}
PROFILES = Path(__file__).parents[1] / "bench/profiles"
METHODS = [*BUILT_IN, *(f"generalized_alpha[rho_inf={rho}]" for rho in (0.8, 0.5, 0.9, 1.0, 0.0))]


def contrast(one: str, two: str) -> float:
    light, dark = sorted((luminance(one), luminance(two)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def test_the_contrast_of_known_colours():
    """WCAG's own examples: black on white, and #777777 on white."""
    assert contrast("#000000", "#ffffff") == pytest.approx(21)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)


@given(st.one_of(st.sampled_from(METHODS), st.text(max_size=20)))
def test_marks_are_seen_on_light_and_dark_pages(label):
    style = style_of(label)
    assert all(contrast(style.color, paper) >= 3 for papers in PAPERS.values() for paper in papers)
    assert all(contrast(style.dark, paper) >= 4.5 for paper in PAPERS["dark"])


def test_a_style_depends_on_the_name_alone():
    """Neither on the other integrators nor on the process, which salts its hashes."""
    labels = ["mine", "generalized_alpha[rho_inf=0.8]", "mine[k=3] x 0.3/0.7"]
    assert line_styles(reversed(labels)) == {k: line_styles([k])[k] for k in labels}
    code = "from reports.charts.line_styles import line_styles; import sys\n"
    code += "print(line_styles(sys.argv[1:]))"
    run = subprocess.run(
        [sys.executable, "-c", code, *labels], capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == str(line_styles(labels))


def suite(name: str) -> list[str]:
    """The integrators of a built-in suite, by the names that they have there."""
    studies = tomllib.loads((PROFILES / f"{name}.toml").read_text(encoding="utf-8"))["study"]
    return list(dict.fromkeys(spec for study in studies for spec in study["integrators"]))


@pytest.mark.parametrize("name", ["quick", "full", "sizes"])
def test_the_integrators_of_a_suite_do_not_look_alike(name):
    styles = line_styles(suite(name))
    for one, two in combinations(styles, 2):
        a, b = styles[one], styles[two]
        assert (a.color, a.dash, a.shape) != (b.color, b.dash, b.shape), (one, two)
        if one.partition("[")[0] == two.partition("[")[0]:  # of nearly the same hue
            assert (a.dash, a.shape) != (b.dash, b.shape), (one, two)


def test_the_built_in_integrators_differ_in_hue_or_mark_for_every_eye():
    """Without colour, in greys of equal lightness, marks and dashes part most of them."""
    styles = line_styles(suite("full"))
    marks = [(s.dash, s.shape) for s in styles.values()]
    assert len(set(marks)) >= len(marks) - 2, styles


@settings(max_examples=25)
@given(st.lists(st.one_of(st.sampled_from(METHODS), st.text(max_size=5)), min_size=24, unique=True))
def test_no_mark_and_no_dash_comes_twice_among_24_lines_of_a_figure(labels):
    styles = list(paper_line_styles(labels).values())
    assert len({s.shape for s in styles[:24]}) == len({s.dash for s in styles[:24]}) == 24
    assert len({(s.shape, s.dash) for s in styles}) == len(styles)
    assert {s.color for s in styles} == {style_of(k).color for k in labels}


def test_every_mark_of_paper_is_drawn():
    """A figure with one point per mark has 24 different paths."""
    marks = [s.shape for s in paper_line_styles(f"m{i}" for i in range(24)).values()]
    places = {"domain": [str(i) for i in range(24)], "range": marks}
    chart = {
        "data": {"values": [{"mark": str(i)} for i in range(24)]},
        "mark": {"type": "point", "size": 200},
        "encoding": {"shape": {"field": "mark", "scale": places, "legend": None}},
    }
    svg = vl_convert.vegalite_to_svg(chart)
    points = svg.split('aria-roledescription="point"')[1:]
    assert len({point.split(' d="')[1].split('"')[0] for point in points}) == 24
