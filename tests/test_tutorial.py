"""The tutorial works as written: its files and commands run, in order, in an empty folder."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from bench.results.compare import compare_folders

TEXT = (Path(__file__).parent.parent / "docs" / "tutorial.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE)


def flat(text: str) -> str:
    return " ".join(text.split())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder after the last command; the printed text was checked after each command."""
    path, said = tmp_path_factory.mktemp("tutorial"), ""
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    for kind, block in BLOCKS:
        if kind == "sh":
            run = subprocess.run(
                ["bash", "-euo", "pipefail", "-c", block],
                cwd=path,
                env=os.environ | {"PATH": programs, "COLUMNS": "200"},
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=120,
            )
            said = flat(run.stdout)
            assert run.returncode == 0, f"{block}\n{run.stdout}"
        elif kind == "text":
            for line in block.splitlines():
                assert flat(line) in said, f"{line}\nis not in\n{said}"
        else:
            name = block.split("\n", 1)[0].strip("<!-># ")
            assert name.endswith({"python": ".py", "toml": ".toml", "xml": ".xml"}[kind])
            (path / name).write_text(block, encoding="utf-8")
    return path


@pytest.mark.long
def test_the_tutorial_leaves_what_it_promises(folder):
    assert (folder / "first" / "report.html").stat().st_size > 0
    assert (folder / "cost.pdf").read_bytes().startswith(b"%PDF")
    assert (folder / "acceleration.png").read_bytes().startswith(b"\x89PNG")
    words = " ".join(ElementTree.parse(folder / "orders.svg").getroot().itertext())
    assert "my_method" in words


@pytest.mark.long
def test_fewer_corrections_change_the_work_and_the_errors_of_one_method(folder):
    found = compare_folders(folder / "first", folder / "second")
    changes = found.of("error", "work")
    assert {change.integrator for change in changes} == {"my_method"}
    assert {change.kind for change in changes} == {"error", "work"}
    for change in changes:
        if change.kind == "work":
            rest = 0.05 if change.name == "operations" else 0.0  # values are read once a step
            assert change.ratio == pytest.approx(0.5, abs=rest)
        elif change.name in "qva":
            assert change.ratio < 1  # as the text says


def test_every_command_of_the_tutorial_is_one_of_the_tool(stepbench):
    names = set(re.findall(r"stepbench (\w+)", TEXT))
    assert {"run", "new", "check", "report", "compare", "solve", "recommend"} <= names
    for name in names - {"is"}:
        assert stepbench(name, "--help").exit_code == 0, name
