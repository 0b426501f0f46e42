"""Examples of the documents run as printed; commands, options and numbers are those there are."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import long
from planted import whole_markdown

import bench
from bench.atlas.experiments import built_in_experiments
from bench.check.checker import CHECKS, examine
from bench.check.verdicts import FAILED
from bench.commands.main import main
from bench.plugins.registry import Registry
from bench.results.store import Store
from bench.running.plan import built_in_profiles

ROOT = Path(__file__).parent.parent
DOCUMENTS = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in (*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"))
}
TEXT = DOCUMENTS["CONTRIBUTING.md"] + DOCUMENTS["docs/integrators.md"]
EXAMPLES = {
    block.split("\n", 1)[0].removeprefix("# "): block
    for block in re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
}


def test_the_lines_that_import_something_do():
    lines = re.findall(r"^from \S+ import .*|(?<=`)from [^`]+(?=`)", TEXT, re.MULTILINE)
    assert sum("integrators.native" in line for line in lines) > 4
    for line in dict.fromkeys(lines):
        exec(line, {})


def test_readme_counts_what_there_is():
    registry = Registry()
    there = [
        [len(built_in_experiments()), "experiments"],
        [len(registry.problems), "scenes"],
        [len(registry.integrators), "integrators"],
        [len(built_in_profiles()), "suites"],
    ]
    words = "|".join(word for _, word in there)
    text = re.sub(r"```text.*?```", "", DOCUMENTS["README.md"], flags=re.DOTALL)
    told = re.findall(rf"\b(\d+) ({words})\b", text)
    assert [[int(number), word] for number, word in told] == there


def test_every_command_of_the_documents_is_one_of_the_tool_with_its_options():
    found = 0
    for name, text in DOCUMENTS.items():
        lines = re.findall(r"^stepbench .*", text.replace("\\\n", " "), re.MULTILINE)
        lines += re.findall(r"`(stepbench [^`]+)`", text)
        if name == "README.md":
            rows = re.findall(r"^\| (`[\w`, ]+`) \|", text, re.MULTILINE)
            assert set(re.findall(r"`(\w+)`", "".join(rows))) == set(main.commands)
        for line in lines:
            words = shlex.split(re.split(r"[;&|]", line)[0], comments=True)
            command = main.commands.get(words[1], main)
            if command is main and not words[1].startswith("-"):
                assert f"\n{line}" in text, line  # a sentence that begins with the tool's name
                continue
            known = {option for parameter in command.params for option in parameter.opts}
            used = {word.partition("=")[0] for word in words if re.match("-+[a-z]", word)}
            assert used <= {*known, "--help", "--version"}, f"{name}: {line}"
            found += 1
    assert found > 60


def test_the_examples_have_less_than_40_lines_of_code():
    names = "ramp_oscillator", "bathe_ode", "euler_dae", "sdirk3", "euler"
    assert list(EXAMPLES) == [f"{name}.py" for name in names]
    for code in EXAMPLES.values():
        assert sum(bool(line.strip()) for line in code.splitlines()) < 40


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("problems", "ramp_oscillator"),
        *(("integrators", name) for name in ("euler_dae", "euler", "bathe_ode", "sdirk3")),
    ],
)
def test_the_examples_pass_every_check(plugins, kind, name):
    registry = Registry([plugins])
    findings = [examine(registry, kind, name, check) for check in CHECKS[kind]]
    assert [finding.text for finding in findings if finding.verdict == FAILED] == []


@pytest.mark.usefixtures("without_processes")
@pytest.mark.parametrize(
    ("integrator", "order"),
    [("euler_dae", 1), *long(("bathe_ode", 2), ("euler", 1), ("sdirk3", 3))],
)
def test_the_examples_have_the_order_that_they_claim(plugins, integrator, order):
    steps = [0.02, 0.01, 0.005, 0.0025]
    found = bench.order("ramp_oscillator", integrator, steps, plugins=[plugins])
    for group in ("q", "v", "a"):
        assert found.orders[group]["max"] == pytest.approx(order, abs=0.1)


# ---- an installed package ----------------------------------------------------------------
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
