"""Checks of the kit on derivatives of runs, and on steps that are called alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import pytest

from bench.conformance import derivatives
from bench.conformance.derivatives import check_budget, check_gradient
from bench.conformance.verdicts import DoesNotApply, Failed
from bench.plugins.registry import Registry
from integrators.methods.explicit_structural import NohBathe
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.methods.half_explicit import HalfExplicitEuler
from integrators.native.lone_steps import LoneStep
from problems import jax

REGISTRY = Registry()


@dataclass(frozen=True)
class Detached(HalfExplicitEuler):
    """A method whose velocities lose their derivatives, as those of a rounded state would."""

    def step(self, scene, state, t, h, work):
        detached = jax.tree.map(jax.lax.stop_gradient, state.z)
        return super().step(scene, state._replace(z=state.z._replace(v=detached.v)), t, h, work)


def test_derivatives_are_quotients_of_differences_and_lost_ones_are_told():
    assert "forward and reverse" in check_gradient(REGISTRY, HalfExplicitEuler())
    # Explicit methods solve for accelerations by eliminations that have no derivative of their own.
    assert "forward and reverse" in check_gradient(REGISTRY, NohBathe())
    with pytest.raises(Failed, match="quotients of differences"):
        check_gradient(REGISTRY, Detached())
    with pytest.raises(DoesNotApply, match="cannot be differentiated"):
        check_gradient(REGISTRY, REGISTRY.integrator("ida"))


def test_steps_alone_make_the_run_of_the_loop_and_few_iterations_come_near(monkeypatch):
    assert "with one iteration" in check_budget(REGISTRY, GeneralizedAlpha())
    with pytest.raises(DoesNotApply, match="no step of constant size"):
        check_budget(REGISTRY, REGISTRY.integrator("ida"))
    # A step with one iteration in place of three, and a step that is not that of the loop.
    swapped = partial(_with_swapped_limits, LoneStep)
    monkeypatch.setattr(derivatives, "LoneStep", swapped)
    with pytest.raises(Failed, match="three iterations"):
        check_budget(REGISTRY, GeneralizedAlpha())
    other = partial(_of_another_method, LoneStep)
    monkeypatch.setattr(derivatives, "LoneStep", other)
    with pytest.raises(Failed, match="away from the run of the loop"):
        check_budget(REGISTRY, GeneralizedAlpha())


def _with_swapped_limits(lone, method, scene, h, steps, limit=None):
    return lone(method, scene, h, steps, limit and 4 - limit)


def _of_another_method(lone, method, *others):
    return lone(GeneralizedAlpha(rho_inf=0.1), *others)
