"""README, the tutorial and the page on measures work as written, in an empty folder."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from bench.results.folders import compare_folders

pytestmark = pytest.mark.long
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


def test_the_commands_of_readme_run_and_say_what_it_shows(tmp_path):
    lines = [*played(tmp_path, "README.md")]
    assert len(lines) > 10
    for line, said in lines:
        assert words(line) <= words(said), f"{line}\nis not in\n{said}"


def test_the_tutorial_leaves_what_it_promises(folder):
    assert (folder / "first" / "report.html").stat().st_size > 0
    charts = [ElementTree.parse(p) for p in (folder / "first" / "report_figures").glob("*.svg")]
    assert any("my_method" in " ".join(chart.getroot().itertext()) for chart in charts)


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


PAGE = Path("docs/measures.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture(scope="module")
def recomputed(tmp_path_factory):
    from click.testing import CliRunner

    from bench.commands.main import main

    folder = tmp_path_factory.mktemp("measures")
    (folder / "measures.toml").write_text(blocks("toml")[0].replace("samples = 7", "samples = 1"))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for line in blocks("sh")[0].splitlines():
            result = CliRunner().invoke(main, line.split()[1:])
            assert result.exit_code == 0, result.output
        names: dict = {}
        exec("\n".join(blocks("python")), names)
    return names


def test_the_table_is_that_of_the_run(recomputed):
    runs = recomputed["runs"]
    rows = re.findall(r"^\| (generalized_alpha\S*|newmark\S*) \|(.*)\|$", PAGE, re.MULTILINE)
    assert len(rows) == 6
    for name, cells in rows:
        h, components, *numbers = (cell.strip() for cell in cells.split("|"))
        (run,) = runs[(runs.integrator == name) & np.isclose(runs.h, float(h))].itertuples()
        shown = [f"{float(e):.3g}" for e in run.error_a_components_max.split()]
        assert " ".join(shown) == components
        found = [run.error_a_max, run.error_a_end, run.error_a_settled, run.error_a_rms]
        assert [f"{e:.3g}" for e in found] == numbers[:4]
        # Rounding decides whether an elimination is repeated with pivots.
        assert run.operations == pytest.approx(float(numbers[4]), rel=0.01)


def test_every_block_finds_what_the_page_says(recomputed):
    runs, alpha = recomputed["runs"], recomputed["alpha"]
    assert recomputed["worst"].tolist() == pytest.approx(runs.error_a_max.tolist(), rel=1e-8)
    assert recomputed["order"] == pytest.approx(2.0, abs=0.1)
    assert recomputed["parts"].tolist() == runs.operations.tolist()
    of_alpha = recomputed["of_alpha"].tolist()
    assert recomputed["linear_algebra"].tolist() == pytest.approx(of_alpha, rel=0.02)
    assert (alpha.work_solves > 0).all()
    cheapest = recomputed["cheapest"]
    assert [name.partition("[")[0] for name in cheapest.index] == ["generalized_alpha", "ida"]
    for group in ("q", "v", "a", "lam"):
        for norm in ("end", "settled", "rms"):
            assert (runs[f"error_{group}_{norm}"] <= runs[f"error_{group}_max"]).all()


def test_the_example_by_hand_is_that_run(stepbench, recomputed):
    result = stepbench(
        "solve", "pendulum", "generalized_alpha[rho_inf=0.8]", "--step", 0.01, "--t-end", 1.35,
        "--json",
    )  # fmt: skip
    found = json.loads(result.stdout)["a"]
    text = re.search(r"By hand:(.*?)\n\n", PAGE, re.DOTALL)[1]
    pairs = re.findall(r"\((-?[\d.]+), (-?[\d.]+)\)", text)
    value, reference, largest = (np.array(pair, dtype=float) for pair in pairs)
    assert found == pytest.approx(value, abs=1e-6)
    errors = np.abs(value - reference) / largest
    shown = [float(e) for e in re.findall(r"= ([\d.]+\d)", text)]
    assert errors == pytest.approx(shown, rel=5e-3)
    runs = recomputed["runs"]
    (run,) = runs[np.isclose(runs.h, 0.01) & runs.integrator.str.contains("rho_inf")].itertuples()
    assert run.error_a_end == pytest.approx(errors.max(), rel=1e-4)
