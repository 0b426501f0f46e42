"""Formulations, starts, step-size policy and classical forms of the generalized-alpha family."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from helpers import errors_at, long, slope
from hypothesis import given
from hypothesis import strategies as st

from integrators import Steps
from integrators.methods.generalized_alpha import (
    GeneralizedAlpha,
    GeneralizedAlphaClassical,
    HHTClassical,
    WBZClassical,
)
from integrators.methods.generalized_alpha_parameters import (
    first_order_parameters,
    second_order_parameters,
    smallest_safe_ratio,
    updated_weight,
)
from problems import MechatronicSystem, State, jnp
from problems.projections import constrained_part
from problems.scenes.pendulum import Pendulum
from problems.scenes.spring_mass import SpringMass

STEPS = [0.005, 0.0025, 0.00125]


@dataclass(frozen=True)
class Duffing(MechatronicSystem):
    """q'' = -q - 0.3 q' - 0.5 q^3 + cos 2t from (1, 0.5)."""

    interval = (0.0, 3.0)

    def mass(self, q):
        return jnp.eye(1)

    def force(self, q, v, t):
        return -q - 0.3 * v - 0.5 * q**3 + jnp.cos(2 * t)

    def initial_state(self):
        return State(q=np.array([1.0]), v=np.array([0.5]))


def orders(method, scene=None, t_end=1.35, pattern=(1.0,), part=max, steps=STEPS):
    scene = scene or Pendulum()
    errors = [errors_at(method, scene, t_end, h, pattern) for h in steps]
    return {group: slope(steps, [part(e[group]) for e in errors]) for group in errors[0]}


def settled(errors):
    return errors[len(errors) // 2 :].max()


def test_the_corrected_start_is_second_order_from_the_first_step():
    for rho_inf in [0.0, 0.5, 0.8]:
        for formulation in ["index3", "stabilised_index2"]:
            method = GeneralizedAlpha(rho_inf=rho_inf, formulation=formulation, start="corrected")
            for group, order in orders(method).items():
                assert order == pytest.approx(2.0, abs=0.1), group


def test_the_consistent_start_leaves_a_first_order_transient():
    for formulation in ["index3", "stabilised_index2"]:
        found = orders(GeneralizedAlpha(rho_inf=0.8, formulation=formulation))
        for group, order in {"q": 2.0, "v": 2.0, "a": 1.0, "lam": 1.0}.items():
            assert found[group] == pytest.approx(order, abs=0.05), group


def test_stabilised_index_2_converges_even_without_damping():
    method = GeneralizedAlpha(rho_inf=1.0, formulation="stabilised_index2", start="corrected")
    for order in orders(method).values():
        assert order == pytest.approx(2.0, abs=0.05)


def test_stabilised_index_2_holds_both_constraints():
    method = GeneralizedAlpha(formulation="stabilised_index2")
    run = method.prepare(Pendulum(), 1.35, Steps(0.01)).measure()
    assert np.abs((run.q**2).sum(1) - 1).max() < 1e-14
    assert np.abs((run.q * run.v).sum(1)).max() < 1e-13
    index3 = GeneralizedAlpha().prepare(Pendulum(), 1.35, Steps(0.01)).measure()
    assert np.abs((index3.q * index3.v).sum(1)).max() > 1e-6


def test_alternating_steps_on_a_constraint():
    for formulation, gamma, wanted in [
        ("index3", "updated", {"q": 2.0, "v": 2.0, "a": 1.0, "lam": 1.0}),
        ("stabilised_index2", "fixed", {"q": 1.0, "v": 1.0, "a": 1.0, "lam": 1.0}),
        ("stabilised_index2", "updated", {"q": 2.0, "v": 2.0, "a": 2.0, "lam": 2.0}),
        ("index3", "guarded", {"q": 2.0, "v": 2.0, "a": 1.0, "lam": 1.0}),
        ("stabilised_index2", "guarded", {"q": 2.0, "v": 2.0, "a": 2.0, "lam": 2.0}),
    ]:
        method = GeneralizedAlpha(formulation=formulation, gamma=gamma, start="corrected")
        # On index 3 the updated weights, restarted or not, show their order at fine steps only.
        found = orders(method, pattern=(0.3, 0.7), part=settled, steps=[h / 4 for h in STEPS])
        for group, order in wanted.items():
            assert found[group] == pytest.approx(order, abs=0.08), group


def test_free_parameters_have_the_order_that_they_claim():
    for options, wanted in [
        ({"alpha_m": 0.3, "alpha_f": 0.4, "delta_m": 0.3, "delta_f": 0.4}, 2.0),
        ({"gamma": 0.65}, 1.0),
        ({"theta": 0.6}, 1.0),
    ]:
        method = GeneralizedAlpha(**options)
        found = orders(method, SpringMass(), 5.0, steps=[0.01, 0.005, 0.0025])
        claimed = method.claims(SpringMass())
        for group, order in found.items():
            assert order == pytest.approx(wanted, abs=0.1), group
            assert claimed[group] == wanted


def test_a_corrected_start_on_a_controlled_scene_keeps_order_two():
    found = orders(GeneralizedAlpha(start="corrected"), SpringMass(), 5.0, steps=[0.04, 0.02, 0.01])
    for order in found.values():
        assert order == pytest.approx(2.0, abs=0.05)


# ---- the update of gamma ---------------------------------------------------------------
def paper_gamma(alpha_m, alpha_f, gamma, s):
    """The next gamma by eq. (29) of Bruels & Arnold (2008), from the shift in units of h.

    The shift after a step with weight gamma follows from eq. (28); dividing by the new step
    turns it into units of that.
    """
    shift = ((1 - alpha_f) * gamma - (1 - alpha_m) / 2) / (gamma - (1 - alpha_m))
    after = ((alpha_m - alpha_f) - alpha_m * shift) / (1 - alpha_m) / s
    return (1 - alpha_m) * (0.5 - after) / ((1 - alpha_f) - after)


@given(st.floats(0.05, 0.95), st.lists(st.floats(0.7, 3.0), min_size=1, max_size=12))
def test_the_linear_form_equals_the_recursion_from_gamma_to_gamma(rho_inf, ratios):
    alpha_m, alpha_f, _, gamma = second_order_parameters(rho_inf)
    h, shift, recursion = 1.0, alpha_m - alpha_f, gamma
    weight, shift = updated_weight(alpha_m, alpha_f, shift, h)
    for s in ratios:
        if s < smallest_safe_ratio(alpha_m):
            continue
        h *= s
        weight, shift = updated_weight(alpha_m, alpha_f, shift, h)
        recursion = paper_gamma(alpha_m, alpha_f, recursion, s)
        assert weight == pytest.approx(recursion, rel=1e-10)


def test_guarded_ratios_keep_gamma_in_its_proven_interval():
    chance = np.random.default_rng(29)
    for parameters in (second_order_parameters, lambda rho: first_order_parameters(rho)):
        alpha_m, alpha_f = parameters(0.8)[:2]
        low, high = (1 - alpha_m) / (2 * (1 - alpha_f)), 1 - alpha_m
        shift = alpha_m - alpha_f
        # Sharp cuts and long growth in turn; s = h/last is all that matters, so h restarts at 1.
        for s in np.exp(chance.uniform(np.log(smallest_safe_ratio(alpha_m)), np.log(5.0), 20_000)):
            weight, after = updated_weight(alpha_m, alpha_f, shift, s)
            assert low * (1 - 1e-12) <= weight < high
            shift = after / s


def test_sharp_cuts_survive_by_a_restart_with_order_two():
    for pattern in [(1 / 1.24, 0.2 / 1.24, 0.04 / 1.24)]:
        # 1, 0.2, 0.04: two cuts far below the safe ratio of 0.5, at which gamma would be infinite.
        found = orders(
            GeneralizedAlpha(gamma="guarded"), Duffing(), 3.0, pattern, steps=[0.1, 0.05, 0.025]
        )
        for order in found.values():
            assert order == pytest.approx(2.0, abs=0.1)


def test_without_the_guard_gamma_has_a_pole():
    alpha_m, alpha_f, _, _ = second_order_parameters(0.8)
    shift = alpha_m - alpha_f
    _, shift = updated_weight(alpha_m, alpha_f, shift, 1.0)
    _, shift = updated_weight(alpha_m, alpha_f, shift, 0.2)
    weights = [updated_weight(alpha_m, alpha_f, shift, h)[0] for h in np.linspace(0.01, 0.2, 500)]
    assert np.abs(weights).max() > 10


# ---- classical forms -------------------------------------------------------------------
@pytest.mark.parametrize(
    "cases", [(GeneralizedAlphaClassical(),), *long([HHTClassical(), WBZClassical()])]
)
def test_the_classical_acceleration_is_first_order_and_spares_q_and_v(cases):
    for method in cases:
        found = orders(method, Duffing(), 3.0)
        for group, order in {"q": 2.0, "v": 2.0, "a": 1.0}.items():
            assert found[group] == pytest.approx(order, abs=0.05)


def test_the_classical_form_moves_as_the_true_one():
    runs = [
        m.prepare(Duffing(), 3.0, Steps(0.005)).measure()
        for m in (GeneralizedAlpha(), GeneralizedAlphaClassical())
    ]
    assert runs[0].q == pytest.approx(runs[1].q, abs=1e-14)
    errors = [
        errors_at(m, Duffing(), 3.0, 0.005)["a"][-1]
        for m in (GeneralizedAlpha(), GeneralizedAlphaClassical())
    ]
    # Measured with an independent program: 7.6e-6 against 1.1e-3.
    assert errors[0] == pytest.approx(7.6e-6, rel=0.05)
    assert errors[1] == pytest.approx(1.1e-3, rel=0.05)


def test_the_classical_acceleration_fed_back_spoils_everything():
    for method in [GeneralizedAlphaClassical(), HHTClassical(), WBZClassical()]:
        for order in orders(method, SpringMass(), 5.0, steps=[0.01, 0.005, 0.0025]).values():
            assert order == pytest.approx(1.0, abs=0.1)


class AccelerationSensed(Duffing):
    """Its output sees the acceleration; there is no controller state."""

    def output(self, z):
        return -0.5 * z.a

    def actuation(self):
        return np.ones((1, 1))


class PositionSensed(AccelerationSensed):
    """Its output sees the position alone."""

    def output(self, z):
        return -0.5 * z.q


@pytest.mark.parametrize("scene", long(AccelerationSensed(), PositionSensed()))
def test_the_classical_acceleration_fed_back_by_an_output_alone_spoils_everything(scene):
    method = GeneralizedAlphaClassical()
    found = orders(method, scene, 1.0, steps=STEPS[:2])
    assert found["q"] == pytest.approx(method.claims(scene)["q"], abs=0.1)
    assert found["q"] == pytest.approx(1 if type(scene) is AccelerationSensed else 2, abs=0.1)


def test_the_projector_keeps_what_constraints_act_on():
    scene = Pendulum(m=3.0)
    q = np.array([0.6, -0.8])
    part = constrained_part(scene, q, 0.0, np.array([1.0, 2.0]))
    assert part == pytest.approx(q * (q @ [1.0, 2.0]), abs=1e-14)
