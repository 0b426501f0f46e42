"""Composite methods: published digits, the loss of multipliers with index 3, and its cure."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers import long
from proofs import TWO_RODS, damping_and_period, orders, radii

from bench.stability.matrices import matrices
from bench.stability.systems import Oscillator
from integrators import Steps
from integrators.methods.composite import TRBDF2, Bathe, RhoInfBathe
from problems.scenes.double_pendulum import DoublePendulumControlled
from problems.scenes.pendulum import Pendulum


@pytest.mark.parametrize(
    ("method", "wanted", "damping", "period"),
    [
        *long(
            (
                Bathe(),
                (0.99999965338, 0.997054485502, 0.457286606856, 0.0499519610314),
                0.0008186670143,
                0.01617937436,
            ),
            (
                TRBDF2(),
                (0.999999632665, 0.996873936516, 0.44485806001, 0.0482421051467),
                0.0008678050247,
                0.01571442413,
            ),
        ),
        (
            RhoInfBathe(rho_inf=0.5),
            (0.999999806973, 0.998315845021, 0.649747454588, 0.502080545025),
            0.0004587631855,
            0.01148896615,
        ),
    ],
)
def test_spectra_have_the_digits_of_the_formulas(method, wanted, damping, period):
    assert radii(method) == pytest.approx(wanted, abs=1e-9)
    assert damping_and_period(method) == pytest.approx((damping, period), abs=1e-9)


def test_rho_inf_is_the_radius_at_infinite_frequency():
    for rho in (0.0, 0.3, 0.8, 1.0):
        a = matrices(RhoInfBathe(rho_inf=rho), Oscillator(), [1e7]).a[0]
        assert np.abs(np.linalg.eigvals(a)).max() == pytest.approx(rho, abs=1e-6)


@pytest.mark.long
def test_tr_bdf2_is_the_undamped_limit_of_bathe_and_has_the_roots_of_sdirk2():
    # Amplification of the L-stable SDIRK method of two stages, gamma = 1 - 1/sqrt(2).
    gamma = 1 - 1 / math.sqrt(2)
    steps = (0.1, 1.0, 10.0, 100.0)
    z = 1j * np.array(steps)
    wanted = np.abs((1 + (1 - 2 * gamma) * z) / (1 - gamma * z) ** 2)
    assert radii(TRBDF2()) == pytest.approx(wanted, abs=1e-12)
    assert radii(RhoInfBathe(rho_inf=0.0)) == pytest.approx(wanted, abs=1e-12)


@pytest.mark.parametrize("method", [*long(Bathe(), TRBDF2(), RhoInfBathe(rho_inf=0.5))])
def test_with_index_3_a_and_lam_stay_first_order(method):
    found = orders(method, 400)
    assert found["q"].order_at_end == pytest.approx(2.0, abs=0.1)
    assert found["v"].order_at_end == pytest.approx(2.0, abs=0.1)
    for group in ("a", "lam"):
        assert found[group].order_at_end == pytest.approx(1.0, abs=0.1)
        assert found[group].order_of_largest == pytest.approx(1.0, abs=0.1)


class Weighed(Pendulum):
    """Its output is the multiplier, which nothing sees."""

    def exact(self, t):
        values = super().exact(t)
        return values | {"y": values["lam"]}

    def output(self, z):
        return z.lam

    def actuation(self):
        return np.zeros((2, 1))


@pytest.mark.long
@pytest.mark.parametrize("method", [TRBDF2(), *long(Bathe(), RhoInfBathe())])
def test_an_output_that_sees_the_multiplier_of_index_3_is_first_order(method):
    scene = Weighed()
    order = orders(method, 400, (scene, 1.35))["y"].order_at_end
    assert order == pytest.approx(method.claims(scene)["y"], abs=0.1)
    # Its output sees a controller state alone.
    assert method.claims(DoublePendulumControlled())["y"] == 2


@pytest.mark.parametrize(
    ("formulation", "method", "lam"),
    [
        ("stabilised_index2", Bathe, 5.4e-4),
        *long(
            ("index2", Bathe, 5.1e-4),
            ("stabilised_index2", TRBDF2, 5.0e-4),
            ("stabilised_index2", RhoInfBathe, 3.9e-4),
            ("index2", RhoInfBathe, 3.7e-4),
        ),
    ],
)
def test_velocity_constraints_cure_a_and_lam_from_the_first_step_on(formulation, method, lam):
    found = orders(method(formulation=formulation), 400)
    assert found["lam"].at_end == pytest.approx(lam, rel=0.02)
    for group in ("q", "v", "a", "lam"):
        assert found[group].order_of_largest == pytest.approx(2.0, abs=0.05), group


@pytest.mark.long
@pytest.mark.parametrize("method", [Bathe, TRBDF2, RhoInfBathe])
@pytest.mark.parametrize("formulation", ["index3", "index2", "stabilised_index2"])
def test_orders_on_two_rods_are_those_claimed(method, formulation):
    method = method(formulation=formulation)
    found, claims = orders(method, 400, TWO_RODS), method.claims(TWO_RODS[0])
    for group in ("q", "v", "a", "lam"):
        assert found[group].order_at_end == pytest.approx(claims[group], abs=0.12), group


@pytest.mark.parametrize("formulation", ["stabilised_index2", *long("index3", "index2")])
def test_the_constraints_of_the_formulation_hold(formulation):
    run = Bathe(formulation=formulation).prepare(Pendulum(), 1.35, Steps(0.01)).measure()
    positions = abs(0.5 * ((run.q**2).sum(axis=1) - 1)).max()
    velocities = abs((run.q * run.v).sum(axis=1)).max()
    assert (positions < 1e-14) == (formulation != "index2")
    assert (velocities < 1e-13) == (formulation != "index3")


@pytest.mark.long
def test_values_of_the_equations_are_second_order_with_index_3_too():
    found = orders(Bathe(values="equations"), 200)
    assert found["lam"].order_at_end == pytest.approx(2.0, abs=0.1)


@pytest.mark.long
def test_modified_newton_and_sparse_tangents_change_nothing():
    scene, steps = TWO_RODS[0], Steps(0.01)
    runs = [
        Bathe(newton=newton, linear_solver=solver).prepare(scene, 0.5, steps).measure()
        for newton, solver in (("full", "dense"), ("modified", "dense"), ("modified", "sparse"))
    ]
    for run in runs[1:]:
        np.testing.assert_allclose(run.q, runs[0].q, atol=1e-11)
        np.testing.assert_allclose(run.lam, runs[0].lam, rtol=1e-7, atol=1e-8)
