"""Half-explicit methods: conditions of the tableau, digits, constraints of velocities, steps."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import errors_at, long
from proofs import SWING
from scipy.integrate import RK45

from bench.check.trials import ForcedOscillator
from integrators import Steps, Tolerances
from integrators.methods import half_explicit
from integrators.methods.half_explicit import PHEM56, HalfExplicitEuler
from problems.scenes.pendulum import Pendulum
from problems.scenes.spring_mass import SpringMass

CONSTANT = PHEM56(steps="constant")


def test_the_tableau_satisfies_the_order_conditions():
    a, ahead = np.zeros((7, 7)), np.zeros((7, 7))
    for i, row in enumerate((*half_explicit._A, half_explicit._B), start=1):
        a[i, : len(row)] = row
    for i, row in enumerate(half_explicit._A_AHEAD, start=1):
        ahead[i, : len(row)] = row
    c, c_ahead = np.array([0.0, *half_explicit._C, 1.0]), np.array([0.0, *half_explicit._C_AHEAD])
    c_ahead = c_ahead[-7:]
    powers = np.arange(5)
    # Explicit weights: order five, and stages of order three from the third on.
    assert a[6] @ c[:, None] ** powers == pytest.approx(1 / (powers + 1), abs=1e-15)
    assert a.sum(axis=1) == pytest.approx(c, abs=1e-15)
    for k in (1, 2):
        assert a[2:] @ c**k == pytest.approx(c[2:] ** (k + 1) / (k + 1), abs=1e-14)
    # Points ahead: order three, whose last but one is the end of the step.
    for k in (0, 1, 2):
        wanted = c_ahead[1:] ** (k + 1) / (k + 1)
        assert ahead[1:] @ c**k == pytest.approx(wanted, abs=1e-14)
    assert ahead[5] == pytest.approx(a[6], abs=0)
    embedded = np.array(half_explicit._B_EMBEDDED)
    assert embedded @ c[:, None] ** powers[:4] == pytest.approx(1 / (powers[:4] + 1), abs=1e-15)
    assert abs(embedded @ c**4 - 1 / 5) > 1e-4


@pytest.mark.long
def test_without_constraints_a_step_is_that_of_dormand_and_prince():
    scene, h = ForcedOscillator(), 0.1
    run = CONSTANT.prepare(scene, 2 + h, Steps(h)).measure()
    start = np.array([1.0, 0.5])

    def rate(t, s):
        return np.array([s[1], np.cos(1.5 * t) - s[0] - 0.3 * s[0] ** 3])

    rates = []
    for c, row in zip(RK45.C, RK45.A, strict=True):
        rates.append(rate(c * h, start + h * sum(w * r for w, r in zip(row, rates, strict=False))))
    end = start + h * RK45.B @ rates
    assert [run.q[-1, 0], run.v[-1, 0]] == pytest.approx(end, abs=1e-14)
    assert run.a[-1, 0] == pytest.approx(rate(h, end)[1], abs=1e-14)


@pytest.mark.long
def test_phem56_has_the_digits_of_an_independent_program():
    scene, t_end = SWING
    run = CONSTANT.prepare(scene, t_end, Steps(1 / 80)).measure()
    exact = scene.exact(run.t)
    assert abs(run.lam - exact["lam"]).max() == pytest.approx(1.3e-6, rel=0.05)
    assert abs((run.q * run.v).sum(axis=1)).max() < 2e-15
    assert run.work.residuals == run.work.solves == 6 * 80


@pytest.mark.long
def test_a_controller_with_implicit_outputs_is_integrated_in_full_order():
    scene = SpringMass()
    h = scene.nominal_step
    one, two = (errors_at(CONSTANT, scene, 50 * h, h / n) for n in (1, 2))
    for group in ("q", "v", "a", "x", "y"):
        assert np.log2(one[group][-1] / two[group][-1]) > 4.7, group


class Held(ForcedOscillator):
    """Its output sees q and v alone."""

    def output(self, z):
        return -z.q - 0.2 * z.v

    def actuation(self):
        return np.ones((1, 1))


class HeldByAcceleration(Held):
    """Its output sees the acceleration, too."""

    def output(self, z):
        return super().output(z) - 0.1 * z.a


@pytest.mark.long
def test_outputs_are_iterated_only_where_they_depend_on_what_a_stage_solves_for():
    plain, sensed = (
        HalfExplicitEuler().prepare(scene, 3.0, Steps(0.1)).measure().work
        for scene in (Held(), HeldByAcceleration())
    )
    assert (plain.newton, plain.residuals, plain.solves) == (0, 10, 10)
    assert sensed.newton == sensed.residuals >= 10


@pytest.mark.long
def test_steps_follow_the_tolerance():
    errors = []
    for rtol in (1e-4, 1e-6, 1e-8):
        run = PHEM56().prepare(Pendulum(), 1.35, Tolerances(rtol)).measure()
        assert run.status == "ok"
        exact = Pendulum().exact(run.t)
        errors.append(abs(run.q - exact["q"]).max())
        assert errors[-1] < 30 * rtol
        assert abs((run.q * run.v).sum(axis=1)).max() < 5e-15
    assert errors[0] > 300 * errors[2]


@pytest.mark.parametrize("projection", long("positions", "none"))
def test_a_projection_holds_positions_to_rounding(projection):
    run = PHEM56(steps="constant", projection=projection).prepare(*SWING, Steps(0.05)).measure()
    positions = abs(0.5 * ((run.q**2).sum(axis=1) - 1)).max()
    assert (positions < 1e-15) == (projection == "positions")
    assert abs((run.q * run.v).sum(axis=1)).max() < 1e-15
