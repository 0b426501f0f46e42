"""The check of the kit on steps that are called alone."""

from __future__ import annotations

from functools import partial

import pytest

from bench.conformance import budgets
from bench.conformance.budgets import check_budget
from bench.conformance.verdicts import DoesNotApply, Failed
from bench.plugins.registry import Registry
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.native.lone_steps import LoneStep

REGISTRY = Registry()


def test_steps_alone_make_the_run_of_the_loop_and_few_iterations_come_near(monkeypatch):
    assert "with one iteration" in check_budget(REGISTRY, GeneralizedAlpha())
    with pytest.raises(DoesNotApply, match="no step of constant size"):
        check_budget(REGISTRY, REGISTRY.integrator("ida"))
    # A step with one iteration in place of three, and a step that is not that of the loop.
    swapped = partial(_with_swapped_limits, LoneStep)
    monkeypatch.setattr(budgets, "LoneStep", swapped)
    with pytest.raises(Failed, match="three iterations"):
        check_budget(REGISTRY, GeneralizedAlpha())
    other = partial(_of_another_method, LoneStep)
    monkeypatch.setattr(budgets, "LoneStep", other)
    with pytest.raises(Failed, match="away from the run of the loop"):
        check_budget(REGISTRY, GeneralizedAlpha())


def _with_swapped_limits(lone, method, scene, h, steps, limit=None):
    return lone(method, scene, h, steps, limit and 4 - limit)


def _of_another_method(lone, method, *others):
    return lone(GeneralizedAlpha(rho_inf=0.1), *others)
