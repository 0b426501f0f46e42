"""Houbolt, Park and Wilson-theta: published digits, identities, orders and constraints."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import errors_at, local_slopes, long
from proofs import TWO_RODS, damping_and_period, orders, radii

from bench.conformance.trials import ForcedOscillator
from integrators import Steps
from integrators.methods.early_structural import Houbolt, Park, WilsonTheta
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems.scenes.pendulum import Pendulum


def test_wilson_has_the_digits_of_the_formula():
    wanted = (0.999991720364, 0.967491846228, 0.561980474574, 0.775676799441)
    assert radii(WilsonTheta()) == pytest.approx(wanted, abs=1e-9)
    digits = 0.01398075474, 0.0614622058
    assert damping_and_period(WilsonTheta()) == pytest.approx(digits, abs=1e-9)


@pytest.mark.long
def test_houbolt_has_the_spectral_radii_of_generalized_alpha_that_damps_most():
    wanted = (0.999951917652, 0.906563333305, 0.242535625036, 0.0478312816831)
    assert radii(Houbolt()) == pytest.approx(wanted, abs=1e-9)
    assert radii(GeneralizedAlpha(rho_inf=0.0)) == pytest.approx(wanted, abs=1e-9)
    digits = 0.05498792741, 0.1232057196
    assert damping_and_period(Houbolt()) == pytest.approx(digits, abs=1e-9)


@pytest.mark.long
def test_park_has_the_roots_of_its_polynomial():
    # (10 r^3 - 15 r^2 + 6 r - 1)/(6 r^3) = i omega h: the formula on u' = i omega u.
    wanted = [
        abs(np.roots([10 - 6j * omega_h, -15, 6, -1])).max() for omega_h in (0.1, 1.0, 10.0, 100.0)
    ]
    assert radii(Park()) == pytest.approx(wanted, abs=1e-9)


@pytest.mark.long
@pytest.mark.parametrize(
    "method", [Houbolt(), Park(), *long(WilsonTheta(), WilsonTheta(theta=2.0))]
)
def test_free_systems_are_second_order_from_the_first_step_on(method):
    scene, steps = ForcedOscillator(), [5 / n for n in (200, 400)]
    runs = [errors_at(method, scene, 5.0, h) for h in steps]
    for group in ("q", "v", "a"):
        assert local_slopes(steps, [run[group].max() for run in runs])[0] > 1.9, group


@pytest.mark.parametrize(
    ("method", "formulation"),
    [
        (Park, "index3"),
        *long(
            (Houbolt, "index3"),
            (Houbolt, "index2"),
            (Houbolt, "stabilised_index2"),
            (Park, "index2"),
            (Park, "stabilised_index2"),
        ),
    ],
)
def test_all_groups_are_second_order_with_constraints(method, formulation):
    found = orders(method(formulation=formulation), 400)
    for group in ("q", "v", "a", "lam"):
        assert found[group].order_at_end == pytest.approx(2.0, abs=0.12), group
    # The past before the start is exact enough: no transient but that of Park's a with index 3.
    transient = method is Park and formulation == "index3"
    assert found["lam"].order_of_largest == pytest.approx(1.0 if transient else 2.0, abs=0.12)


@pytest.mark.long
@pytest.mark.parametrize("method", [Houbolt, Park])
@pytest.mark.parametrize("formulation", ["index3", "index2", "stabilised_index2"])
def test_two_rods_are_second_order(method, formulation):
    found = orders(method(formulation=formulation), 400, TWO_RODS)
    assert min(found[group].order_at_end for group in ("q", "v", "a", "lam")) > 1.9


@pytest.mark.long
@pytest.mark.parametrize("pattern", [(0.3, 0.7), (0.6, 0.4)])
def test_varying_steps_keep_the_order(pattern):
    scene = ForcedOscillator()
    for method in (Houbolt(), Park()):
        runs = [errors_at(method, scene, 5.0, 5 / n, pattern)["q"].max() for n in (100, 200)]
        assert local_slopes([2.0, 1.0], runs)[0] > 1.8


@pytest.mark.parametrize("formulation", long("index3", "index2", "stabilised_index2"))
def test_the_constraints_of_the_formulation_hold(formulation):
    for method in (Houbolt, Park):
        run = method(formulation=formulation).prepare(Pendulum(), 1.35, Steps(0.01)).measure()
        positions = abs(0.5 * ((run.q**2).sum(axis=1) - 1)).max()
        velocities = abs((run.q * run.v).sum(axis=1)).max()
        assert (positions < 1e-14) == (formulation != "index2")
        assert (velocities < 1e-13) == (formulation != "index3")


def test_wilson_refuses_constraints_with_a_reason():
    assert "houbolt" in WilsonTheta().supports(Pendulum())
