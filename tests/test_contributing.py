"""The examples printed in CONTRIBUTING.md run exactly as printed."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

TEXT = (Path(__file__).parent.parent / "CONTRIBUTING.md").read_text(encoding="utf-8")
EXAMPLES = {
    block.split("\n", 1)[0].removeprefix("# "): block
    for block in re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
}


@pytest.fixture
def plugins(tmp_path):
    for name, code in EXAMPLES.items():
        (tmp_path / name).write_text(code)
    return tmp_path


def test_there_are_three_short_examples():
    assert set(EXAMPLES) == {"ramp_oscillator.py", "velocity_verlet.py", "euler.py"}
    assert all(len(code.splitlines()) < 50 for code in EXAMPLES.values())


@pytest.mark.parametrize(("integrator", "order"), [("velocity_verlet", 2), ("euler", 1)])
def test_the_examples_have_the_order_that_they_claim(stepbench, plugins, integrator, order):
    result = stepbench(
        "order",
        "ramp_oscillator",
        integrator,
        "--steps",
        "0.02,0.01,0.005,0.0025",
        "--plugins",
        plugins,
        "--json",
    )
    assert result.exit_code == 0, result.output
    orders = json.loads(result.stdout)["orders"]
    for group in ("q", "v", "a"):
        assert orders[group]["max"] == pytest.approx(order, abs=0.1)


def test_the_example_that_cannot_take_a_scene_says_so(stepbench, plugins):
    result = stepbench("solve", "pendulum", "velocity_verlet", "--plugins", plugins)
    assert result.exit_code != 0
    assert "unsupported: it takes scenes without constraints" in result.output
