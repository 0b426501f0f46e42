"""`stepbench new` writes a file that runs at once, passes its checks, and harms nothing."""

from __future__ import annotations

import re

import pytest
from helpers import long

from bench.check.checker import CHECKS, examine
from bench.check.verdicts import FAILED
from bench.plugins.registry import Registry
from problems.spec import snake_case


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("kind", "plural", "rest", "checks"),
    [
        ("integrator", "integrators", [], CHECKS["integrators"].keys() - {"order"}),
        *long(("integrator", "integrators", [], {"order"})),
        *long(("problem", "problems", ["--out", "scene_of_mine.py"], CHECKS["problems"])),
    ],
)
def test_what_is_written_passes_every_check(stepbench, tmp_path, kind, plural, rest, checks):
    result = stepbench("new", kind, f"my_{kind}", *rest)
    assert result.exit_code == 0, result.output
    file = tmp_path / (rest[1] if rest else f"my_{kind}.py")
    assert f"stepbench check {file.name}" in result.stdout
    assert len(file.read_text().splitlines()) < 60
    registry = Registry([file])
    findings = [examine(registry, plural, f"my_{kind}", check) for check in checks]
    assert [finding.text for finding in findings if finding.verdict == FAILED] == []


@pytest.mark.long
@pytest.mark.parametrize(("kind", "integrator"), [("integrator", None), ("problem", "newmark")])
def test_the_command_that_it_names_next_runs(stepbench, kind, integrator):
    told = stepbench("new", kind, "brand_new").stdout
    command = next(line.split() for line in told.splitlines() if "solve" in line)
    result = stepbench(*command[1:])
    assert result.exit_code == 0, result.output
    assert "ok" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["integrator", "My Method"],
            "in small letters, digits and '_'; try 'my_method'",
        ),
        (["problem", "HeavyTop2"], "try 'heavy_top2'"),
        (["problem", "3d"], "try 'my_3d'"),
        (["problem", "__"], "try 'my'"),
        (["problem", "class"], "try 'my_class'"),
        (["integrator", "pendulum"], "The name 'pendulum' is taken by"),
        (["problem", "scene", "--out", "scene.txt"], "scene.txt is not the name of a Python file"),
    ],
)
def test_a_name_that_cannot_be_is_refused_in_a_sentence(stepbench, tmp_path, arguments, words):
    result = stepbench("new", *arguments)
    assert result.exit_code == 1
    assert words in " ".join(result.output.split())
    assert list(tmp_path.iterdir()) == []


def test_a_new_file_needs_a_folder(stepbench, tmp_path):
    result = stepbench("new", "problem", "scene", "--out", "nowhere/scene.py")
    assert result.exit_code == 2
    assert "there is no folder 'nowhere'; make it first." in " ".join(result.output.split())
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten(stepbench, tmp_path):
    (tmp_path / "mine.py").write_text("precious")
    result = stepbench("new", "problem", "mine")
    assert result.exit_code == 1
    assert "mine.py is there already" in result.output
    assert (tmp_path / "mine.py").read_text() == "precious"


@pytest.mark.parametrize("name", ["rk4", "a_b", "x_2", "my_method", "bdf_2_fixed"])
def test_a_class_is_named_so_that_it_is_found_by_the_name_given(stepbench, tmp_path, name):
    assert stepbench("new", "integrator", name).exit_code == 0
    (cls,) = re.findall(r"^class (\w+)", (tmp_path / f"{name}.py").read_text(), re.M)
    assert snake_case(cls) == name
