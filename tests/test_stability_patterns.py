"""Varying steps: growing patterns and runs that confirm them; `stepbench stability`."""

from __future__ import annotations

import csv
import io
import itertools
import json

import altair
import numpy as np
import pytest
from helpers import long
from planted import Document

from bench.stability.matrices import matrices
from bench.stability.patterns import (
    ALTERNATING,
    LARGEST_RATIO,
    fractions,
    largest_safe_ratio,
    worst,
)
from bench.stability.spectra import eigenvalues, radii
from bench.stability.systems import Oscillator
from integrators import Steps
from integrators.methods.generalized_alpha import GeneralizedAlpha, Newmark
from reports.charts.maps import radius_map

#: Largest ratios of two steps in turns that do not grow: rho_inf, gamma fixed, gamma updated.
SAFE = [
    (0.5, 5.344, 2.602),
    *long((0.0, 5.825, 4.252), (0.9, 1.510, 1.044), (0.2, 6.373, 4.151), (0.8, 2.265, 1.189)),
]


def step_words(longest):
    """All cyclic words of -1, 0 and 1 that sum to zero, each once, the shortest first."""
    found = {}
    for length in range(2, longest + 1):
        for word in itertools.product((1, 0, -1), repeat=length):
            turns = [word[k:] + word[:k] for k in range(length)]
            if sum(word) == 0 and any(word) and word == max(turns) and turns.count(word) == 1:
                found[word] = None
    return list(found)


def method_of(rho_inf, gamma):
    return GeneralizedAlpha(rho_inf=rho_inf, gamma=gamma)


def growth_of_a_run(method, macro, pattern, patterns):
    """Growth per pattern over the second half of a run, from its largest values."""
    scene = Oscillator().from_deviation([1.0, 0.3])
    run = method.prepare(scene, patterns * macro, Steps(macro, pattern)).measure()
    size = np.abs(run.q[:, 0]) + np.abs(run.v[:, 0]) * macro
    half, last = run.t[-1] / 2, run.t[-1]
    early = size[(run.t > half - 60 * macro) & (run.t <= half)].max()
    late = size[run.t > last - 60 * macro].max()
    return (late / early) ** (macro / (last - half))


def test_fractions_follow_the_words():
    parts = np.array(fractions((1, 1, -1, -1), 2.0))
    assert parts.sum() == pytest.approx(1.0)
    assert parts / parts[0] == pytest.approx([1, 2, 4, 2])


@pytest.mark.long
def test_the_safe_ratio_is_searched_for():
    found = largest_safe_ratio(method_of(0.8, "updated"))
    assert found.ratio == pytest.approx(1.189, rel=2e-3)
    assert found.omega_h == pytest.approx(4.09, rel=0.01)
    assert found.radius > 1
    # Longer patterns with the same ratio grow earlier if there is more damping to lose.
    assert worst(method_of(0.0, "updated"), fractions((1, 1, 1, -1, -1, -1), 2.8))[0] > 1 + 1e-3
    assert worst(method_of(0.0, "updated"), fractions(ALTERNATING, 2.8))[0] <= 1 + 1e-10


def test_without_damping_any_ratio_is_neutral():
    for method in (Newmark(), method_of(1.0, "updated"), method_of(1.0, "fixed")):
        radius, _ = worst(method, fractions(ALTERNATING, LARGEST_RATIO))
        assert radius == pytest.approx(1.0, abs=1e-11)


@pytest.mark.parametrize("gamma", [*long("fixed"), "updated"])
@pytest.mark.parametrize(("rho_inf", "fixed", "updated"), SAFE)
def test_runs_confirm_a_stable_and_an_unstable_point(rho_inf, fixed, updated, gamma):
    method = method_of(rho_inf, gamma)
    limit = fixed if gamma == "fixed" else updated
    below, above = (
        worst(method, fractions(ALTERNATING, 1 + part * (limit - 1)))[0] for part in (0.98, 1.02)
    )
    assert below <= 1 + 1e-10 < above
    grows = fractions(ALTERNATING, 1.05 * limit)
    radius, macro = worst(method, grows)
    assert radius > 1 + 1e-5
    patterns = int(min(200_000, 400 + 8 / np.log(radius)))
    assert growth_of_a_run(method, macro, grows, patterns) == pytest.approx(radius, rel=2e-2)
    assert growth_of_a_run(method, macro, grows, patterns) > 1
    # A tenth below the limit nothing grows, there or anywhere.
    stays = fractions(ALTERNATING, 1 + 0.9 * (limit - 1))
    scene = Oscillator().from_deviation([1.0, 0.3])
    run = method.prepare(scene, 2000 * macro, Steps(macro, stays)).measure()
    size = np.abs(run.q[:, 0])
    assert size[len(size) // 2 :].max() <= size[: len(size) // 2].max() * (1 + 1e-9)


def test_the_pattern_of_figure_6_grows_with_updated_gamma_unless_it_is_guarded():
    for gamma, radius in [("fixed", 0.99670), ("updated", 1.04285), ("guarded", 0.98764)]:
        # Steps 0.3 H, 0.7 H of Bruels & Arnold (2008), rho_inf = 0.8, at omega H = 4.47.
        method, pattern, macro = method_of(0.8, gamma), (0.3, 0.7), 4.47
        found = radii(eigenvalues(matrices(method, Oscillator(), [macro], pattern).a))[0]
        assert found == pytest.approx(radius, abs=1e-5)
        if gamma == "updated":
            assert growth_of_a_run(method, macro, pattern, 400) == pytest.approx(radius, abs=1e-4)


def test_the_period_of_a_pattern_is_the_product_of_its_steps():
    # Newmark's method has no memory of the grid: the matrix of a pattern is the product.
    h, pattern = 1.7, (0.2, 0.5, 0.3)
    method = Newmark(beta=0.3, gamma=0.6)
    product = np.eye(3)
    for part in pattern:
        product = matrices(method, Oscillator(zeta=0.1), [h * part]).a[0] @ product
    found = matrices(method, Oscillator(zeta=0.1), [h], pattern).a[0]
    np.testing.assert_allclose(found, product, atol=1e-12)


def found_by(stepbench, *arguments):
    result = stepbench("stability", *arguments, "--no-ratios", "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


@pytest.mark.long
def test_plugins_get_their_spectra_without_a_line(stepbench, plugins):
    names = "euler", "bathe_ode"
    euler, bathe = found_by(stepbench, *names, "--plugins", plugins, "--at", "0.1,1000")
    assert bathe["order"] == 2
    assert bathe["growing"] == []
    assert bathe["radius_at_infinity"] == 0
    assert bathe["at"]["radius"][0] == pytest.approx(1.0, abs=1e-5)
    assert bathe["at"]["radius"][1] < 0.01
    # Bathe's closed form: trapezoidal rule over h/2, then backward differences of second order.
    z = 0.1j
    middle = (1 + z / 4) / (1 - z / 4)
    exact = (4 * middle - 1) / (3 - z)
    assert bathe["at"]["radius"][0] == pytest.approx(abs(exact), abs=1e-12)
    # Any other Python code is run for one step and for two.
    at = np.array(euler["omega_h"])
    assert euler["radius"] == pytest.approx(np.sqrt(1 + at**2), rel=1e-9)
    assert euler["stability_limit"] == 0.0
    assert euler["maps"] == []


def test_tiles_meet_in_the_middle_and_show_the_radii():
    rows = [{"value": 0.0, "radii": [0.2, 0.1, 1.0]}, {"value": 1.0, "radii": [None, 1.05, 1.02]}]
    chart = radius_map({"over": "sigma", "omega_h": [0.01, 0.1, 1.0], "rows": rows}, "omega h")
    altair.Chart.from_dict(chart)
    tiles = [list(row.values()) for row in csv.DictReader(io.StringIO(chart["datasets"]["map"]))]
    near, far = 10**-1.5, 10**-0.5
    expected = [
        (10**-2.5, far, -0.5, 0.5, "to 0.25"),
        (far, 10**0.5, -0.5, 0.5, "0.99 to 1"),
        (10**-2.5, near, 0.5, 1.5, "above 2"),
        (near, 10**0.5, 0.5, 1.5, "1.001 to 1.1"),
    ]
    for (*ends, words), (*wanted, said) in zip(tiles, expected, strict=True):
        assert words == said
        assert [float(end) for end in ends] == pytest.approx(wanted, rel=1e-4)
    assert radius_map({"over": "sigma", "omega_h": [0.01, 0.1], "rows": rows[:1]}, "h") is None


@pytest.mark.long
def test_the_page_shows_everything_in_one_file(stepbench, tmp_path):
    names = "generalized_alpha[gamma=updated]", "newmark[beta=1/6]"
    result = stepbench("stability", *names, "--out", tmp_path)
    assert result.exit_code == 0, result.output
    assert "grows for omega h in: 3.46410162 to infinity" in result.output
    assert "largest safe ratio" in result.output
    text = (tmp_path / "stability.html").read_text()
    page = Document(text)
    for words in (
        "generalized_alpha[rho_inf=0.8,gamma=updated]",
        "-0.8 (×3)",  # noqa: RUF001
        "Ratios of neighbouring steps",
        "spectral radius over omega h and rho_inf",
        "spectral radius over omega H and step ratio",
        "The same methods as linear multistep formulas",
    ):
        assert words in page.words, words
    assert text.count("<svg") == 5 + 4
    assert "nan" not in page.words.lower().split()


@pytest.mark.long
def test_a_step_that_does_not_converge_is_told_and_is_no_growth(stepbench, tmp_path):
    # One iteration finds the solution of a linear step, and no second one confirms it.
    method = "newmark[newton_max=1]"
    result = stepbench("stability", method, "--no-ratios", "--out", tmp_path)
    assert result.exit_code == 0, result.output
    words = " ".join(result.output.split())
    assert "step not solved for omega h in: 0.01 to 10000" in words
    assert "radius at infinity: not solved" in words
    assert "grows for omega h in: none" in words
    assert "not solved" in Document((tmp_path / "stability.html").read_text()).words


@pytest.mark.parametrize(("rho_inf", "safe", "grows"), long((0.5, 2.2, 2.35), (0.8, 1.16, 1.19)))
def test_the_safe_ratio_holds_for_all_words(rho_inf, safe, grows):
    # Doubling and halving at will is safe with rho_inf = 0.5, but not with 0.8.
    method = method_of(rho_inf, "updated")
    for ratio, wanted in ((safe, False), (grows, True)):
        radii_over = (worst(method, fractions(word, ratio))[0] for word in step_words(6))
        assert any(radius > 1 + 1e-10 for radius in radii_over) == wanted


@pytest.mark.usefixtures("without_processes")
@pytest.mark.parametrize("cases", [("relaxation",), *long(["joined", "loop", "coupled"])])
def test_other_systems_have_radii(stepbench, cases):
    for system in cases:
        (found,) = found_by(stepbench, "generalized_alpha[rho_inf=0.5]", "--system", system)
        assert found["system"].startswith(system)
        assert found["growing"] == []
        assert found["order"] is None
        assert 0.45 < found["radius_at_infinity"] < 0.55
