"""The page on measures: a reader recomputes its numbers from an export."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.long  # one run of the command

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
