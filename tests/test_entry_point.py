"""Entry points of a package that is installed: its scene and its integrator are listed and run."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest
from planted import whole_markdown
from test_contributing import EXAMPLES

from bench.results.store import Store

DIST = "tiny_plugins-0.1.dist-info"
ENTRY_POINTS = """
[stepbench.problems]
ramp_oscillator = tiny_plugins.ramp_oscillator:RampOscillator
[stepbench.integrators]
euler = tiny_plugins.euler:Euler
"""


@pytest.mark.long
def test_a_package_with_entry_points_is_listed_run_and_reported(tmp_path):
    for name, text in {
        "tiny_plugins/__init__.py": "",
        **{f"tiny_plugins/{name}": EXAMPLES[name] for name in ("ramp_oscillator.py", "euler.py")},
        f"{DIST}/METADATA": "Metadata-Version: 2.1\nName: tiny-plugins\nVersion: 0.1\n",
        f"{DIST}/entry_points.txt": ENTRY_POINTS,
        "one.toml": "samples = 1\n[[study]]\nproblems = ['ramp_oscillator']\nt_end = 1.0\n"
        "integrators = ['euler', 'newmark']\nsteps = [0.1, 0.05, 0.025]\n",
    }.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)

    def stepbench(*arguments: str) -> str:
        command, more = [sys.executable, "-m", "bench", *arguments], {"PYTHONPATH": str(tmp_path)}
        done = subprocess.run(
            command, cwd=tmp_path, env=os.environ | more, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    listed = json.loads(stepbench("list", "--json"))
    for kind, name in (("problems", "ramp_oscillator"), ("integrators", "euler")):
        (row,) = (row for row in listed[kind] if row["name"] == name)
        assert (row["available"], row["origin"]) == (True, "tiny-plugins 0.1")
    assert "6 runs: 6 ok" in stepbench("run", "one.toml", "--out", "out")
    with Store(tmp_path / "out") as store:
        records = store.records().values()
    assert {record.integrator.split("[")[0] for record in records} == {"euler", "newmark"}
    page = whole_markdown(tmp_path / "out")
    assert "euler" in page
    assert "A mass on a spring under a force that grows with time" in page
