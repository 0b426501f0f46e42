"""The first page of a report stays small, however large the run."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from planted import plant, planted

from reports.pages.html_report import write_html_report


def test_a_run_adds_six_characters_to_the_first_page(tmp_path):
    def size(runs):
        held = {"q": (1.0, 2), "a": (3.0, 2)}
        records = [
            planted("pendulum", f"m[rho_inf={m / 10}]", held, h=0.1 / 1.4**k)
            for m in range(8)
            for k in range(runs)
        ]
        folder = plant(tmp_path / str(runs), records, samples=1, plan=False)
        return write_html_report(folder).stat().st_size

    assert 6 <= (size(22) - size(12)) / (8 * 10) < 7


@pytest.mark.long
def test_a_large_report_opens_with_little(tmp_path):
    sys.path.insert(0, str(Path(__file__).parent / "benchmarks"))
    from report_size import plant_many

    assert 200_000 < write_html_report(plant_many(tmp_path)).stat().st_size < 300_000
