"""Steps that fail at dependent constraints end with their true name, not with a smaller step."""

from __future__ import annotations

from unittest.mock import Mock

import numpy as np
import pytest
from helpers import long

from bench.commands.single_runs import _end_values
from bench.plugins.registry import Registry
from bench.results.records import Rows
from integrators import Steps, Tolerances
from problems.scenes.pendulum import Pendulum
from problems.scenes.slider_crank import SliderCrank
from problems.start_equations import missing_rank

NAME = "The tangent is singular at t="


def ended(method, scene, t_end=0.45, h=0.02):
    method = Registry().integrator(method)
    refined = Steps(h) if method.controls == "step" else Tolerances(1e-4)
    return method.prepare(scene, t_end, refined).measure()


@pytest.mark.parametrize(
    "method",
    [
        "generalized_alpha",
        *long(
            "generalized_alpha[newton=modified]",
            "bdf2[formulation=stabilised_index2]",
            "generalized_alpha_adaptive",
            "radau_iia",
            "rattle",
            "half_explicit_euler",
            "ali3p[values=equations]",
        ),
    ],
)
def test_a_constraint_that_is_stated_twice_is_named(method):
    run = ended(method, Pendulum(copies=2))
    assert run.status == "newton_failed"
    assert run.message.startswith(NAME)
    assert "ali3p[values=own]" in run.message


@pytest.mark.long
def test_the_remedy_helps_and_fails_under_its_own_name():
    assert ended("ali3p", Pendulum(copies=2)).status == "ok"
    failed = ended("ali3p", Pendulum(copies=2, g=1e12), h=0.1)
    assert failed.status != "ok"
    assert NAME not in failed.message


def test_other_failures_keep_their_names():
    run = ended("generalized_alpha", Pendulum(g=1e12), h=0.1)
    assert run.status != "ok"
    assert NAME not in run.message


def test_rank_does_not_depend_on_the_size_of_constraints():
    start = SliderCrank().initial_state()
    assert missing_rank(SliderCrank(), start.q, 0.0) == 0
    for length in (1e-6, 1.0, 1e6):
        pair = Pendulum(copies=2, length=length)
        assert missing_rank(pair, pair.initial_state().q, 0.0) == 1
        assert missing_rank(Pendulum(length=length), pair.initial_state().q, 0.0) == 0
    assert missing_rank(Pendulum(), np.zeros(2), 0.0) == 1


def test_a_run_without_a_row_has_a_table_without_values():
    record = Mock(components={}, points={}, integrator="ida", problem="pendulum", status="diverged")
    table = _end_values(record, Rows(t=[], values={"q": []}), {"q": ["X [m]"]})
    assert (table.rows, table.head[2]) == ([], "at the end")
