"""Backward differences of order two: published digits, orders in each formulation."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import long
from proofs import OMEGA_H, SWING, TWO_RODS, damping_and_period, orders, radii

from integrators import Steps
from integrators.methods.bdf2 import BDF2
from problems import jax
from problems.scenes.car_axis import CarAxis
from problems.scenes.pendulum import Pendulum
from problems.scenes.spring_mass import SpringMass


def test_its_spectrum_has_the_digits_of_the_formula():
    # Independent computation in 50 digits from the formula's own polynomial.
    assert OMEGA_H == (0.1, 1.0, 10.0, 100.0)
    wanted = [0.999975609345, 0.933321058436, 0.300749568269, 0.078110132815]
    assert radii(BDF2()) == pytest.approx(wanted, abs=1e-9)
    assert damping_and_period(BDF2()) == pytest.approx((0.03442589388, 0.1020606581), abs=1e-9)


@pytest.mark.parametrize("formulation", ["index3", *long("index2", "stabilised_index2")])
@pytest.mark.parametrize("on", [SWING, *long((TWO_RODS,))], ids=["one", "two"])
def test_all_is_second_order_and_multipliers_recover_from_the_first_step(formulation, on):
    found = orders(BDF2(formulation=formulation), 400, on)
    if on is TWO_RODS:
        assert min(found[group].order_at_end for group in ("q", "v", "lam")) > 1.8
        return
    for group in ("q", "v", "lam"):
        assert found[group].order_at_end == pytest.approx(2.0, abs=0.12), group
    assert found["lam"].order_of_largest == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("formulation", ["index3", *long("stabilised_index2", "index2")])
def test_the_constraints_of_the_formulation_hold(formulation):
    run = BDF2(formulation=formulation).prepare(Pendulum(), 1.35, Steps(0.01)).measure()
    positions = abs(0.5 * ((run.q**2).sum(axis=1) - 1)).max()
    velocities = abs((run.q * run.v).sum(axis=1)).max()
    assert (positions < 1e-14) == (formulation != "index2")
    assert (velocities < 1e-13) == (formulation != "index3")


def test_controller_states_follow_the_formulas_of_the_first_and_of_later_steps():
    h = 0.1
    run = BDF2().prepare(SpringMass(), 2 * h, Steps(h)).measure()
    (x0, x1, x2), (f0, f1, f2) = run.x, run.xdot
    assert x1 - x0 == pytest.approx(h * (f0 + 3 * f1) / 4, rel=1e-12)
    assert 3 * x2 - 4 * x1 + x0 == pytest.approx(2 * h * f2, rel=1e-12)


def test_positions_are_corrected_in_the_directions_of_the_constraints_before_the_step():
    """On a scene whose directions Phi_q(q, t) move with time: those at the end are others."""
    scene, h = CarAxis(), 0.05
    run = BDF2(formulation="stabilised_index2").prepare(scene, h, Steps(h)).measure()
    corrected = run.q[1] - run.q[0] - h * run.v[0] - h**2 / 2 * run.a[1]

    jacobian = jax.jit(jax.jacfwd(scene.constraint))

    def off(q, t):
        directions = np.asarray(jacobian(q, t)).T
        part = np.linalg.lstsq(directions, corrected)[0]
        return np.linalg.norm(corrected - directions @ part) / np.linalg.norm(corrected)

    assert off(run.q[0], 0.0) < 1e-6
    for elsewhere in ((run.q[0], h), (run.q[1], 0.0)):
        assert off(*elsewhere) > 1e-3
