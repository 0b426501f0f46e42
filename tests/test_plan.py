"""Profiles: combinations of options, tables on request, and refused input."""

from __future__ import annotations

import re
from unittest.mock import Mock

import pytest

from bench.commands.terminal import RunProgress
from bench.results.store import Store
from bench.running.inventory import Inventory
from bench.running.plan import make_suite
from bench.running.process import NoAnswer
from bench.running.profiles import built_in_profiles, read_profile
from bench.running.session import measure_suite
from problems.base.spec import SpecError

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


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("start =", "strat =", "did you mean 'start'"),
        ('"corrected"', '"late"', "start=late is not allowed"),
        ("samples = 0", "samples = -1", "samples=-1 is not allowed; give 0 (no timing) to 1000"),
        ("steps =", 'components = ["q3"]\nsteps =', "pendulum has no component 'q3'"),
        ("steps =", 'components = ["q2:q9"]\nsteps =', "pendulum has no component 'q9'"),
        ("steps =", 'components = ["q1:"]\nsteps =', "pendulum has no component ''"),
        ("steps =", 'components = ["z1"]\nsteps =', "give a group and a number such as q1"),
        ("steps =", 'figures = ["order"]\nsteps =', "did you mean 'orders'"),
    ],
)
def test_a_bad_profile_is_one_sentence(tmp_path, old, new, words):
    with pytest.raises(SpecError) as error:
        suite_of(tmp_path, STUDY.replace(old, new))
    assert words in str(error.value)


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


def test_progress_counts_the_cells_that_the_suite_has(tmp_path, capsys):
    suite, registry = suite_of(tmp_path, STUDY), Inventory()
    lost = NoAnswer(status="crashed", message="Lost.")
    runner = Mock(run=lambda groups, offers: ((task, lost) for group in groups for task in group))
    runner.progress = RunProgress()
    with Store(tmp_path, create=True) as store:
        measure_suite(suite, store, registry, runner)
        RunProgress().advance()  # before a phase there is nothing to count
    said = re.findall(r"(?m)^.*: \d+ of \d+$", capsys.readouterr().err)
    assert said == ["measuring: 0 of 16", "measuring: 16 of 16"]
