"""README and the tutorial work as written: files and commands, in order, in an empty folder."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest

from bench.results.folders import compare_folders

ROOT = Path(__file__).parent.parent


def flat(text: str) -> str:
    return " ".join(text.split())


def words(text: str) -> set[str]:
    """The words of a text; its numbers are of one run."""
    return set(re.findall(r"[a-zA-Zα-ω]{2,}", text))


def played(path: Path, document: str) -> Iterator[tuple[str, str]]:
    """Play a document's blocks in a folder: each printed line with what the last command said."""
    said, programs = "", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    text = (ROOT / document).read_text(encoding="utf-8")
    for kind, block in re.findall(r"^```(\w+)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE):
        if kind == "sh" and not block.startswith("make "):
            # A search among all methods has 60 s by the clock, which a busy machine takes away.
            block = block.replace("recommend pendulum", "recommend pendulum --budget 300")
            run = subprocess.run(
                ["bash", "-euo", "pipefail", "-c", block],
                cwd=path,
                env=os.environ | {"PATH": programs, "COLUMNS": "200"},
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=900,
            )
            said = flat(run.stdout)
            assert run.returncode == 0, f"{block}\n{run.stdout}"
        elif kind == "text":
            yield from ((flat(line), said) for line in block.splitlines())
        elif kind != "sh":
            name = block.split("\n", 1)[0].strip("<!-># ")
            assert name.endswith({"python": ".py", "toml": ".toml", "xml": ".xml"}[kind])
            (path / name).write_text(block, encoding="utf-8")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder after the last command; the printed text was checked after each command."""
    path = tmp_path_factory.mktemp("tutorial")
    for line, said in played(path, "docs/tutorial.md"):
        assert line in said, f"{line}\nis not in\n{said}"
    return path


@pytest.mark.long
def test_the_commands_of_readme_run_and_say_what_it_shows(tmp_path):
    lines = [*played(tmp_path, "README.md")]
    assert len(lines) > 10
    for line, said in lines:
        assert words(line) <= words(said), f"{line}\nis not in\n{said}"


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
