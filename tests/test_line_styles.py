"""Colours, marks and dashes: fixed by the name, legible on every paper, not twice in a figure."""

import math
import subprocess
import sys
from collections.abc import Iterable
from functools import cache
from itertools import combinations

import pytest
import vl_convert
from helpers import long
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.running.inventory import Inventory
from bench.running.plan import make_suite, read_profile
from reports.charts.line_styles import MARKS, LineStyle, line_styles, luminance, style_of
from reports.names import BUILT_IN
from reports.series import label_of

PAPERS = {"light": ("#ffffff", "#f8fafc"), "dark": ("#0f172a", "#15181c")}
INVENTORY = Inventory()
#: Signs of names that a plugin may have; those of all alphabets take seconds to be found.
SIGNS = "aZ_09[]=,. \n\0äβ‰☃𝄞"
METHODS = [*BUILT_IN, *(f"generalized_alpha[rho_inf={rho}]" for rho in (0.8, 0.5, 0.9, 1.0, 0.0))]


def contrast(one: str, two: str) -> float:
    light, dark = sorted((luminance(one), luminance(two)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def oklab(color: str) -> list[float]:
    """A colour in Ottosson's space, in which distances are as they are seen."""
    parts = [int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    rgb = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    cones = [
        sum(w * c for w, c in zip(row, rgb, strict=True)) ** (1 / 3)
        for row in (
            (0.4122214708, 0.5363325363, 0.0514459929),
            (0.2119034982, 0.6806995451, 0.1073969566),
            (0.0883024619, 0.2817188376, 0.6299787005),
        )
    ]
    return [
        sum(w * c for w, c in zip(row, cones, strict=True))
        for row in (
            (0.2104542553, 0.7936177850, -0.0040720468),
            (1.9779984951, -2.4285922050, 0.4505937099),
            (0.0259040371, 0.7827717662, -0.8086757660),
        )
    ]


def distance(one: str, two: str) -> float:
    return math.dist(oklab(one), oklab(two))


def near(one: str, two: str) -> bool:
    """Whether colours are so near that a small mark may pass for the other."""
    return distance(one, two) < 0.06


def test_the_contrast_and_distance_of_known_colours():
    """WCAG's examples: black on white, and #777777 on white; black and white have no colour."""
    assert contrast("#000000", "#ffffff") == pytest.approx(21)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)
    assert oklab("#ffffff") == pytest.approx([1, 0, 0], abs=1e-4)
    assert oklab("#000000") == pytest.approx([0, 0, 0], abs=1e-4)
    assert near("#436be0", "#416be0")
    assert not near("#436be0", "#16843b")


@settings(max_examples=30)
@given(st.one_of(st.sampled_from(METHODS), st.text(SIGNS, max_size=20)))
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


@cache
def scenes(name: str) -> dict[str, list[str]]:
    """The integrators of a built-in suite by scene: printed names, with patterns of steps."""
    found: dict[str, dict[str, None]] = {}
    for cell in make_suite(*read_profile(name), INVENTORY).cells.values():
        record = cell.record("ok")
        found.setdefault(record.problem, {})[label_of(record)] = None
    return {scene: list(labels) for scene, labels in found.items()}


def suite(name: str) -> list[str]:
    return list(dict.fromkeys(label for labels in scenes(name).values() for label in labels))


def alike(labels: Iterable[str]) -> list[tuple[LineStyle, LineStyle]]:
    """Pairs of styles whose colours are near."""
    pairs = combinations(line_styles(labels).values(), 2)
    return [(one, two) for one, two in pairs if near(one.color, two.color)]


def test_lines_of_a_suite_are_told_apart():
    """Near colours differ in mark and dash, lines of one mark in colour, and all without colour."""
    for name in ("quick", "full", "sizes", "families"):
        if name != "families":
            pairs = alike(suite(name))
            assert pairs, name
            assert [(a, b) for a, b in pairs if a.shape == b.shape or a.dash == b.dash] == [], name
        styles = line_styles(suite(name)).values()
        pairs = [(a, b) for a, b in combinations(styles, 2) if a.shape == b.shape]
        assert [pair for pair in pairs if distance(pair[0].color, pair[1].color) < 0.12] == [], name
        if name in ("quick", "full"):
            marks = [(s.dash, s.shape) for s in styles]
            assert len(set(marks)) == len(marks), name


@pytest.mark.parametrize("name", ["methods", *long("paper")])
def test_many_variants_of_a_method_differ_in_mark_or_dash(name):
    """Of the 96 of "methods", no two of one colour have one mark; on a scene two of near ones."""
    pairs = alike(suite(name))
    assert len(pairs) > 10
    assert [(a, b) for a, b in pairs if (a.shape, a.dash) == (b.shape, b.dash)] == []
    assert [a for a, b in pairs if (a.color, a.shape) == (b.color, b.shape)] == []
    for labels in scenes(name).values():
        assert len([a for a, b in alike(labels) if a.shape == b.shape]) <= 1


def test_methods_with_the_same_options_differ_in_mark_or_dash():
    """All names of the catalogue; the options go to those that take them."""
    taking = {"generalized_alpha", "generalized_alpha_adaptive", "hht", "wbz", "newmark"}
    for options in ("", "newton=modified", "formulation=stabilised_index2,start=corrected"):
        labels = []
        for name in BUILT_IN:
            head, _, rest = INVENTORY.integrator(name).spec.rstrip("]").partition("[")
            added = ",".join(filter(None, [rest, options if name in taking else ""]))
            labels.append(f"{head}[{added}]" if added else head)
        pairs = alike(labels)
        assert pairs
        assert [(a, b) for a, b in pairs if (a.shape, a.dash) == (b.shape, b.dash)] == []


def test_every_mark_is_drawn():
    """A figure with one point per mark has as many different paths."""
    places = {"domain": [str(i) for i in range(len(MARKS))], "range": list(MARKS)}
    chart = {
        "data": {"values": [{"mark": mark} for mark in places["domain"]]},
        "mark": {"type": "point", "size": 200},
        "encoding": {"shape": {"field": "mark", "scale": places, "legend": None}},
    }
    points = vl_convert.vegalite_to_svg(chart).split('aria-roledescription="point"')[1:]
    assert len({point.split(' d="')[1].split('"')[0] for point in points}) == len(MARKS)
