"""Counts that a method declares, compared with those of its compiled steps; and its bill."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import pytest

from bench.check import integrators
from bench.check.integrators import audited, check_counts
from bench.check.trials import TRIAL_STEPS, ForcedOscillator, Trial
from bench.check.verdicts import Failed
from bench.plugins.registry import Registry
from integrators import ImplicitStepMethod, Reading, StepMethod, Steps, option
from integrators.adapters.ida import IDA
from integrators.program_costs import NotCounted
from problems import jax, jnp
from problems.equations.formulations import ode_rate
from problems.scenes.spring_mass import SpringMass


class _OfODE:
    """A state of q and v as it stands."""

    def begin(self, scene, start, h):
        return jnp.concatenate([start.z.q, start.z.v])

    def read(self, scene, state):
        q, v = jnp.split(state, 2)
        nothing = jnp.zeros(0)
        return Reading(q, v, 0 * q, nothing, nothing, nothing, nothing)


@dataclass(frozen=True)
class Heun(_OfODE, StepMethod):
    """Two stages, of which it counts as many as it says."""

    formulation: ClassVar[str] = "ode"
    counted: int = option(2, "stages counted in each step", low=0)
    looping: bool = option(False, "the second stage again and again, until it stands still")

    def step(self, scene, state, t, h, work):
        work.count(residuals=self.counted)
        first = ode_rate(scene, t - h, state)

        def corrected(after):
            return state + h / 2 * (first + ode_rate(scene, t, after))

        if not self.looping:
            return corrected(state + h * first)
        return jax.lax.while_loop(
            lambda after: jnp.abs(corrected(after) - after).max() > 1e-3, corrected, state
        )


@dataclass(frozen=True)
class Midpoint(_OfODE, ImplicitStepMethod):
    """The implicit midpoint rule, and a further stage that it does not count."""

    formulation: ClassVar[str] = "ode"
    further: bool = option(False, "evaluate once more")

    def step(self, scene, state, t, h, work):
        if self.further:
            state = state + 1e-9 * ode_rate(scene, t, state)
        return work.solve(
            lambda u: u - state - h * ode_rate(scene, t - h / 2, (state + u) / 2), state
        )


def test_two_stages_that_are_counted_as_one_are_found_out():
    assert audited(Heun(), ForcedOscillator()) == (2 * TRIAL_STEPS, 2 * TRIAL_STEPS)
    with pytest.raises(Failed, match=r"counts 50 residuals and Jacobians.*linearised 100 times"):
        check_counts(Heun(counted=1), ForcedOscillator())


def test_counts_of_newtons_method_are_true_and_one_evaluation_more_is_found():
    declared, counted = audited(Midpoint(), ForcedOscillator())
    assert declared == counted > 2 * TRIAL_STEPS
    with pytest.raises(Failed, match=r"count them by work\.count"):
        check_counts(Midpoint(further=True), ForcedOscillator())


def test_methods_of_other_libraries_have_no_steps_to_look_into():
    assert not check_counts(IDA(), ForcedOscillator())
    assert not check_counts(Heun(counted=0), SpringMass())  # an unknown number of inner iterations


def test_a_lie_in_the_counts_does_not_change_the_bill():
    scene, bills = ForcedOscillator(), []
    for counted in (2, 1):
        prepared = Heun(counted=counted).prepare(scene, 3.0, Steps(0.1))
        run = prepared.measure()
        assert run.work.residuals == 10 * counted
        bills.append(prepared.bill(run))
    assert bills[0] == bills[1]
    # A stage: the force cos(1.5 t) - q - 0.3 q^3, and M a. M = 1 is known beforehand, so that its
    # factors cost nothing, and two substitutions with one unknown remain.
    stage = 1 + 10 + 1 + 2 + 1 + 1 + 1
    assert bills[0]["residuals"] == pytest.approx(10 * 2 * stage, rel=0.2)
    assert bills[0]["inner solves"] == pytest.approx(10 * 2 * 2)


def test_a_loop_of_its_own_has_no_bill_instead_of_a_guess():
    prepared = Heun(looping=True).prepare(ForcedOscillator(), 3.0, Steps(0.1))
    run = prepared.measure()
    assert run.status == "ok"
    with pytest.raises(NotCounted, match="turns"):
        prepared.bill(run)


def test_the_check_of_the_work_finds_a_lie(monkeypatch):
    monkeypatch.setattr(
        integrators, "trials", lambda registry, method: [Trial(method, ForcedOscillator())]
    )
    told = integrators.check_runs(Registry([]), Heun())
    assert "Counts are true on forced_oscillator" in told
    with pytest.raises(Failed, match="force was evaluated"):
        integrators.check_runs(Registry([]), Heun(counted=1))
