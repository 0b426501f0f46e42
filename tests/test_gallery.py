"""Pictures of scenes: stills, animations, the catalogue, and its facts about a scene."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from helpers import long
from planted import Document

from bench.plugins.registry import Registry
from bench.running.scene_records import drawings, equations, rates, scene_record
from problems.scenes.ivp_test_set import CarAxis
from problems.scenes.oscillators import SpringMass
from problems.scenes.pendulums import Pendulum
from problems.truth.reference import Reference

DOCS = Path(__file__).parents[1] / "docs"


def test_the_gallery_has_a_small_picture_of_every_scene():
    shown = re.findall(r"!\[(\w+)\]\(gallery/(\w+).svg\)", (DOCS / "gallery.md").read_text("utf-8"))
    names = [*Registry().problems]
    assert shown == [(name, name) for name in names]
    files = {path.stem: path for path in (DOCS / "gallery").iterdir()}
    assert set(files) == set(names)
    assert sum(path.stat().st_size for path in files.values()) < 400_000
    for name, path in files.items():
        drawn = [line.get("d") for line in ElementTree.parse(path).getroot()]
        assert len(drawn) == 7, name
        assert len(set(drawn)) > 4, f"{name} does not move"


def test_rates_are_the_eigenvalues_of_the_motion():
    quiet = Pendulum(th0=1e-4)  # small swings: a pair at +-i sqrt(g/length), the rest is zero
    found = rates(quiet, Reference(quiet, 1.35))
    assert found["oscillation"] == pytest.approx(np.sqrt(quiet.g / quiet.length), rel=1e-4)
    assert found["fastest"] == pytest.approx(found["oscillation"], rel=1e-4)
    loop = SpringMass(k=4.0, b=0.0)  # no feedback: the filter's pole stands beside the spring's
    found = rates(loop, Reference(loop, 2.0))
    assert found["oscillation"] == pytest.approx(2.0)
    assert found["decay"] == pytest.approx(loop.sigma)
    assert found["slowest"] == pytest.approx(loop.sigma)


def test_equations_are_those_that_the_scene_has():
    assert equations(CarAxis()) == ["M(q) a = g(q, v, t) - Phi_q^T lam", "0 = Phi(q, t)"]
    assert equations(SpringMass())[0] == "M(q) a = g(q, v, t) + L y"
    assert len(equations(SpringMass())) == 3
    assert not any("lam" in text for text in equations(SpringMass()))


def test_drawings_follow_the_motion():
    scene = Pendulum()
    made = drawings(scene, Reference(scene, 1.35), 5)
    assert [d["t"] for d in made] == pytest.approx(np.linspace(0.35, 1.35, 5))
    for d in made:
        rod = np.array(d["lines"][0])
        np.testing.assert_allclose(rod[1], scene.exact(np.array([d["t"]]))["q"][0], atol=1e-12)
    record = scene_record(scene, 1.35, lambda: Reference(scene, 1.35))
    assert record.tags == list(scene.tags)
    assert record.difficulties
    assert record.title == "A point mass on a massless rod: a small index-3 system with an " \
        "exact solution."  # fmt: skip


@pytest.mark.usefixtures("without_processes")
@pytest.mark.parametrize("suffix", ["svg", *long("png")])
def test_show_writes_a_picture(stepbench, tmp_path, suffix):
    file = tmp_path / f"swing.{suffix}"
    result = stepbench("show", "pendulum", "--set", "th0=2.0", "-o", file)
    assert result.exit_code == 0, result.output
    if suffix == "svg":
        assert ElementTree.parse(file).getroot().tag.endswith("svg")
    else:
        assert file.read_bytes().startswith(b"\x89PNG")


@pytest.mark.usefixtures("without_processes")
def test_an_animation_has_all_it_needs_in_one_file(stepbench, tmp_path):
    file = tmp_path / "play.html"
    result = stepbench("show", "pendulum", "--animate", "--t-end", "0.85", "-o", file)
    assert result.exit_code == 0, result.output
    text = file.read_text()
    assert not re.search(r"""(src|href)=["'](?!data:|#)|https?://(?!www\.w3\.org)""", text)
    frames = json.loads(re.search(r'"application/json">(.*)</script>', text).group(1))
    assert len(frames) == 240
    assert (frames[0]["t"], frames[-1]["t"]) == (0.35, 0.85)
    x, y = Pendulum().exact(np.array([0.85]))["q"][0]
    # A page has y downwards, the scene upwards.
    assert frames[-1]["lines"][0][1] == pytest.approx([x, -y], rel=1e-3)


@pytest.mark.long
def test_a_scene_without_a_picture_is_told_so_and_still_catalogued(stepbench, plugins, tmp_path):
    plugin = plugins / "ramp_oscillator.py"
    result = stepbench("show", plugin.stem, "--plugins", plugin)
    assert result.exit_code != 0
    assert f"{plugin.stem} has no picture: it does not define draw(q)" in result.output
    line = "list", plugin.stem, "spring_mass", "--draw", "--plugins", plugin
    result = stepbench(*line, "--out", tmp_path)
    assert result.exit_code == 0, result.output
    page = (tmp_path / "catalogue.html").read_text()
    for words in (
        "A mass on a spring under a force that grows", "Active damping of one mass",
        "xdot = f(q, v, a, x, y, t)",  # without constraints no λ
    ):  # fmt: skip
        assert words in Document(page).words
    assert page.count("<svg") == 1
