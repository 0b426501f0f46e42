"""`stepbench stability`: numbers, pages, plugins, and refused input."""

from __future__ import annotations

import json

import numpy as np
import pytest
from helpers import long
from planted import Document
from test_contributing import EXAMPLES

RADII = {1.0: 0.999474614014, 10.0: 0.929791767153}


@pytest.fixture(scope="module")
def plugins(tmp_path_factory):
    folder = tmp_path_factory.mktemp("examples")
    for name, code in EXAMPLES.items():
        (folder / name).write_text(code)
    return folder


def found_by(stepbench, *arguments):
    result = stepbench("stability", *arguments, "--no-ratios", "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


@pytest.mark.long
def test_numbers_at_the_steps_that_are_asked_for(stepbench):
    (found,) = found_by(stepbench, "generalized_alpha[rho_inf=0.8]", "--at", "1,10")
    assert found["at"]["omega_h"] == [1.0, 10.0]
    assert found["at"]["radius"] == pytest.approx(list(RADII.values()), abs=1e-11)
    assert found["radius_at_infinity"] == pytest.approx(0.8, abs=1e-9)
    assert (found["stability_limit"], found["order"]) == (None, 2)
    assert found["theory"]["formulas"]["q"]["infinity_roots"] == [
        {"re": pytest.approx(-0.8), "im": pytest.approx(0.0, abs=1e-9), "times": 3}
    ]
    over = {m["over"]: m for m in found["maps"]}
    assert set(over) == {"rho_inf", "step ratio"}
    last = [row["radii"][-1] for row in over["rho_inf"]["rows"]]
    assert last == pytest.approx([row["value"] for row in over["rho_inf"]["rows"]], abs=5e-3)


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


@pytest.mark.usefixtures("without_processes")
@pytest.mark.parametrize("cases", [("relaxation",), *long(["joined", "loop", "coupled"])])
def test_other_systems_have_radii(stepbench, cases):
    for system in cases:
        (found,) = found_by(stepbench, "generalized_alpha[rho_inf=0.5]", "--system", system)
        assert found["system"].startswith(system)
        assert found["growing"] == []
        assert found["order"] is None
        assert 0.45 < found["radius_at_infinity"] < 0.55
