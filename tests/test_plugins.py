"""Faulty plugins, options and profiles give one sentence and disturb no others."""

from __future__ import annotations

import json
import sys

import pytest
from helpers import cell_of, long

from bench.plugins.registry import Registry, Unavailable
from bench.running import worker
from bench.running.inventory import Inventory
from bench.running.plan import built_in_profiles, make_suite, read_profile
from integrators import Steps
from problems.base.spec import SpecError

HEAD = """
from dataclasses import dataclass
from problems.scenes.pendulums import Pendulum
from problems import parameter
"""
SCENE = """
@dataclass(frozen=True)
class HeavyBob(Pendulum):
    'A heavy bob.'
    m: float = parameter(50.0, 'kg', 'mass')
"""


@pytest.fixture
def listed(stepbench, tmp_path):
    """List a plugin file of this code as JSON: the scenes by name."""

    def call(code: str) -> dict:
        file = tmp_path / "plugin.py"
        file.write_text(HEAD + code)
        result = stepbench("list", "scenes", "--plugins", file, "--json")
        assert result.exit_code == 0, result.output
        return {row["name"]: row for row in json.loads(result.stdout)["problems"]}

    return call


@pytest.mark.parametrize(
    "cases", [("None",), *long(["'two words'", "3", "''", "'a[b=1]'", "'1st'"])]
)
def test_a_name_that_cannot_be_written_is_unavailable_with_its_reason(listed, stepbench, cases):
    for name in cases:
        scenes = listed(f"{SCENE}    name = {name}\n")
        assert not scenes["HeavyBob"]["available"]
        assert "is not a word of letters" in scenes["HeavyBob"]["reason"]
        assert scenes["pendulum"]["available"]
        assert stepbench("list").exit_code == 0


def test_a_numpy_default_is_listed_as_json_without_what_the_plugin_prints_at_import(listed):
    code = "import numpy as np\nprint('hello')\n" + SCENE
    scenes = listed(f"{code}    n: int = parameter(np.int64(3), '', 'links')\n")
    defaults = {option["name"]: option["default"] for option in scenes["heavy_bob"]["options"]}
    assert defaults["n"] == 3


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("from problems import MechatronicSystem\nclass Half(MechatronicSystem):\n    'A half.'\n",
         "it lacks mass, force, initial_state"),
        *long(
            ("raise SystemExit('bye')\n", "SystemExit: bye"),
            ("x = 1\n", "defines no MechatronicSystem"),
            (HEAD + "class Another(Pendulum):\n    'Another.'\n    name = 'pendulum'\n",
             "is taken by stepbench"),
            (HEAD + "class Bare(Pendulum):\n    'Bare.'\n    c = parameter(1.0, 'kg', 'c')\n",
             "decorate Bare"),
        ),
    ],
)  # fmt: skip
def test_a_broken_plugin_is_listed_with_its_reason_and_stops_nothing(
    stepbench, refused, tmp_path, code, words
):
    file = tmp_path / "plug.py"
    file.write_text(code)
    listed = stepbench("list", "--json", "--plugins", file)
    assert listed.exit_code == 0, listed.output
    rows = [row for kind in json.loads(listed.output).values() for row in kind]
    assert any(words in row["reason"] and not row["available"] for row in rows)
    assert {"pendulum", "newmark"} <= {row["name"] for row in rows if row["available"]}
    assert words in refused("solve", "pendulum", "newmark", "--plugins", file)  # to use it
    text = tmp_path / "plug.txt"
    text.write_bytes(bytes(range(256)))
    assert "is not a Python file" in refused("list", "--plugins", text)


@pytest.mark.long
def test_programs_are_forgotten_before_memory_mappings_run_out(monkeypatch):
    bench = worker.Worker(Registry())
    pair = bench.registry, "pendulum", "newmark"
    first, second = (cell_of(*pair, 1.0, Steps(h)) for h in (0.1, 0.05))
    before = bench.measure(first)
    monkeypatch.setattr(worker, "memory_mappings", lambda: worker.MOST_MAPPINGS + 1)
    monkeypatch.setattr(worker, "COUNTED_EVERY", 1)
    bench.measure(second)
    assert set(bench.prepared) == {second.key}
    assert bench.time(first) > 0.0
    assert set(bench.prepared) == {first.key}
    assert bench.measure(first).record.errors == before.record.errors


def test_a_scene_that_cannot_be_planned_costs_its_own_cells(tmp_path):
    """Whatever its facts raise, while the suite is planned in the same process."""
    for interval in ("raise SystemExit(3)", "raise KeyError('t')", "return 1 / 0"):
        (tmp_path / "odd.py").write_text(f"{HEAD}{SCENE}    @property\n    def interval(self):\n"
                                         f"        {interval}\n")  # fmt: skip
        inventory = Inventory([tmp_path / "odd.py"])
        with pytest.raises(Unavailable, match="heavy_bob gives no facts about itself"):
            inventory.problem("heavy_bob")
        assert inventory.problem("pendulum").name == "pendulum"
        for module in [name for name in sys.modules if name.startswith("stepbench_plugin_odd")]:
            del sys.modules[module]


STUDY = """
samples = 0
[[study]]
problems = ["pendulum"]
integrators = ["generalized_alpha[rho_inf=0.5]", "newmark"]
vary = { formulation = ["index3", "stabilised_index2"], start = ["consistent", "corrected"] }
steps = [0.02, 0.01]
"""


def suite_of(tmp_path, text):
    file = tmp_path / "mine.toml"
    file.write_text(text)
    return make_suite(*read_profile(str(file)), Inventory())


def test_varied_options_are_combined_with_every_integrator(tmp_path):
    suite = suite_of(tmp_path, STUDY)
    names = {cell.integrator for cell in suite.cells.values()}
    assert len(names) == 8
    assert len(suite.cells) == 16
    assert "generalized_alpha[rho_inf=0.5,formulation=stabilised_index2,start=corrected]" in names
    assert "newmark[beta=0.25,gamma=0.5]" in names
    assert suite.plan.samples == 0


def test_a_suite_takes_the_studies_of_those_that_it_includes(tmp_path):
    registry = Inventory()
    whole, part = (make_suite(*read_profile(name), registry) for name in ("methods", "orders"))
    assert set(part.cells) < set(whole.cells)
    assert whole.plan.studies[-len(part.plan.studies) :] == part.plan.studies
    assert whole.plan.title != part.plan.title
    for other, words in (("methods", "which includes others"), ("ordes", "did you mean 'orders'")):
        with pytest.raises(SpecError, match=words):
            suite_of(tmp_path, STUDY.replace("samples", f'include = ["{other}"]\nsamples'))


@pytest.mark.parametrize("name", built_in_profiles())
def test_built_in_profiles_name_only_what_there_is(name):
    registry = Inventory()
    suite = make_suite(*read_profile(name), registry)
    for text in {cell.integrator for cell in suite.cells.values()}:
        assert registry.integrator(text).spec == text
    assert suite.plan.title
