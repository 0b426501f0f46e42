"""The examples printed in CONTRIBUTING.md and docs/integrators.md run exactly as printed."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from helpers import long

from bench.conformance.checker import CHECKS, examine
from bench.conformance.verdicts import FAILED
from bench.plugins.registry import Registry

DOCUMENTS = ("CONTRIBUTING.md", "docs/integrators.md")
EXAMPLES = {
    block.split("\n", 1)[0].removeprefix("# "): block
    for name in DOCUMENTS
    for block in re.findall(
        r"```python\n(.*?)```",
        (Path(__file__).parent.parent / name).read_text(encoding="utf-8"),
        re.DOTALL,
    )
}


@pytest.fixture(scope="module")
def plugins(tmp_path_factory):
    folder = tmp_path_factory.mktemp("examples")
    for name, code in EXAMPLES.items():
        (folder / name).write_text(code)
    return folder


def test_the_examples_have_less_than_40_lines_of_code():
    assert set(EXAMPLES) == {"ramp_oscillator.py", "bathe_ode.py", "euler_dae.py", "euler.py"}
    for code in EXAMPLES.values():
        assert sum(bool(line.strip()) for line in code.splitlines()) < 40


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("problems", "ramp_oscillator"),
        *long(*(("integrators", name) for name in ("euler_dae", "euler", "bathe_ode"))),
    ],
)
def test_the_examples_pass_every_check(plugins, kind, name):
    registry = Registry([plugins])
    findings = [examine(registry, kind, name, check) for check in CHECKS[kind]]
    assert [finding.text for finding in findings if finding.verdict == FAILED] == []


@pytest.mark.usefixtures("without_processes")
@pytest.mark.parametrize(
    ("integrator", "order"), [("euler_dae", 1), *long(("bathe_ode", 2), ("euler", 1))]
)
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
