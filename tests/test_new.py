"""`stepbench new` writes a file that runs at once, passes its checks, and harms nothing."""

from __future__ import annotations

import re

import pytest
from helpers import long

from bench.check.checker import CHECKS, examine
from bench.check.verdicts import FAILED
from bench.plugins.registry import Registry
from problems.base.spec import snake_case


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("kind", "plural", "rest", "checks"),
    [
        ("integrator", "integrators", [], {"description", "endings"}),
        *long(("integrator", "integrators", [], CHECKS["integrators"])),
        *long(("problem", "problems", ["--out", "scene_of_mine.py"], CHECKS["problems"])),
    ],
)
def test_what_is_written_passes_every_check(stepbench, tmp_path, kind, plural, rest, checks):
    result = stepbench("new", kind, f"my_{kind}", *rest)
    assert result.exit_code == 0, result.output
    file = tmp_path / (rest[1] if rest else f"my_{kind}.py")
    assert f"stepbench check {file.name}" in result.stdout
    then = "recommend " if kind == "problem" else f"run --mine my_{kind} --plugins "
    assert f"stepbench {then}{file.name}" in result.stdout
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


def test_a_class_is_named_so_that_it_is_found_by_the_name_given(stepbench, tmp_path):
    for name in ("rk4", "a_b", "x_2", "my_method", "bdf_2_fixed"):
        assert stepbench("new", "integrator", name).exit_code == 0
        (cls,) = re.findall(r"^class (\w+)", (tmp_path / f"{name}.py").read_text(), re.M)
        assert snake_case(cls) == name
