"""The generalized-alpha family: digits, orders, and identities of its coefficients."""

from fractions import Fraction
from functools import cache

import numpy as np
import pytest
from helpers import errors_at, forget_programs, long, slope, toy
from hypothesis import given
from hypothesis import strategies as st

from integrators import Steps
from integrators.methods import generalized_alpha_step
from integrators.methods.generalized_alpha import (
    HHT,
    WBZ,
    GeneralizedAlpha,
    GeneralizedAlphaClassical,
    HHTClassical,
    Newmark,
    WBZClassical,
)
from integrators.methods.generalized_alpha_step import (
    first_order_parameters,
    second_order_parameters,
    smallest_safe_ratio,
    updated_weight,
)
from problems import jnp
from problems.equations import formulations
from problems.equations.kinematics import constrained_part, constraint_force
from problems.scenes.oscillators import SpringMass
from problems.scenes.pendulums import Pendulum


@pytest.fixture
def mutant(monkeypatch):
    """Replace a function by a mutant, with programs compiled anew before and after."""

    def plant(module, name, wrong):
        monkeypatch.setattr(module, name, wrong)
        forget_programs()

    yield plant
    monkeypatch.undo()
    forget_programs()


#: q'' = -q - 0.3 q' - 0.5 q^3 + cos 2t from (1, 0.5); with an output of a, or of q.
Duffing = toy(
    "Duffing", v=[0.5], interval=(0.0, 3.0),
    force=lambda self, q, v, t: -q - 0.3 * v - 0.5 * q**3 + jnp.cos(2 * t),
)  # fmt: skip
AccelerationSensed, PositionSensed = (
    toy("Sensed", base=Duffing, output=output, actuation=lambda self: np.ones((1, 1)))
    for output in (lambda self, z: -0.5 * z.a, lambda self, z: -0.5 * z.q)
)


# ---- digits ----------------------------------------------------------------------------
DIGITS = {
    "q": -0.569897683826460, "v": 2.052987649185013, "a": -0.427636884093702,
    "x": -3.348650952505259,
}  # fmt: skip


def paper_run():
    return GeneralizedAlpha(rho_inf=0.8).prepare(SpringMass(), 5.0, Steps(0.1)).measure()


def test_the_spring_mass_gives_the_digits_of_the_method_and_a_flipped_sign_misses_them(mutant):
    # Algorithm 1 of the paper with Newton converged to 1e-13, from an independent program.
    run = paper_run()
    assert (run.status, run.t[-1]) == ("ok", 5.0)
    for group, value in DIGITS.items():
        assert getattr(run, group)[-1, 0] == pytest.approx(value, abs=1e-13)
    right = formulations.dynamics_residual

    def wrong(scene, z):
        return right(scene, z) + 2 * (scene.actuation() @ z.y)

    mutant(formulations, "dynamics_residual", wrong)
    assert abs(paper_run().q[-1, 0] - DIGITS["q"]) > 1e-2


@pytest.mark.long
def test_a_flipped_sign_of_the_constraint_force_spoils_lambda(mutant):
    right = constraint_force
    mutant(formulations, "constraint_force", lambda *given: -right(*given))
    assert errors_at(GeneralizedAlpha(rho_inf=0.8), Pendulum(), 1.35, 0.005)["lam"][-1] > 1.0


# ---- orders ----------------------------------------------------------------------------
errors = cache(errors_at)
PARTS = {"end": lambda e: e[-1], "max": max, "settled": lambda e: e[len(e) // 2 :].max()}
SPRING, SWING, FORCED = (SpringMass(), 5.0), (Pendulum(), 1.35), (Duffing(), 3.0)
#: Steps of Fig. 5 and 6 of Bruels & Arnold (2008), the latter in the asymptotic range.
FIGURE_5 = 0.1, 0.04, 0.02, 0.01, 0.004, 0.002, 0.001, 0.0004
FIGURE_6 = tuple(0.2 * 2.0**-k for k in (5, 6, 7, 8))
COARSE, FINE, FINER = (
    tuple(h * 2.0**-k for k in range(n)) for h, n in ((0.02, 4), (0.01, 3), (0.005, 3))
)
UNEVEN, CUT = (0.3, 0.7), (1 / 1.24, 0.2 / 1.24, 0.04 / 1.24)
STATES, ALL = ("q", "v", "a", "x"), ("q", "v", "a", "lam", "x", "y")
GGL = {"formulation": "stabilised_index2"}


def at(groups, order):
    return dict.fromkeys(groups, order)


TRANSIENT = at("qv", 2) | {"a": 1, "lam": 1}
#: Method, scene and end, steps and pattern, part of the errors, orders, and how far they are off.
ORDERS = [
    (GeneralizedAlpha(), SPRING, FIGURE_5, (1.0,), "end", at(STATES, 2), 0.02),
    # Alternating steps cost an order with fixed gamma; updated gamma and theta win it back.
    (GeneralizedAlpha(gamma="fixed"), SPRING, FIGURE_6, UNEVEN, "end", at(STATES, 1), 0.1),
    (GeneralizedAlpha(gamma="updated"), SPRING, FIGURE_6, UNEVEN, "end", at(STATES, 2), 0.02),
    # Index 3: of second order after the start transient, which is of first order in lam.
    *((GeneralizedAlpha(rho_inf=rho), SWING, tuple(h / 2**k for k in range(4)), (1.0,), *found)
      for rho, h in {0.0: 0.005, 0.5: 0.01, 0.8: 0.005, 0.9: 0.0025}.items()
      for found in (("settled", at(ALL, 2), 0.06), ("max", at("qv", 2), 0.06),
                    ("max", at(("a", "lam"), 1), 0.1))),
    # Without damping lam does not converge.
    (GeneralizedAlpha(rho_inf=1.0), SWING, FINE, (1.0,), "max", {"q": 2, "lam": 0}, 0.05),
    (GeneralizedAlpha(rho_inf=1.0, **GGL, start="corrected"), SWING, FINER, (1.0,), "max",
     at(ALL, 2), 0.05),
    *((GeneralizedAlpha(rho_inf=0.8, **of), SWING, FINER, (1.0,), "max", TRANSIENT, 0.05)
      for of in ({}, GGL)),
    *((GeneralizedAlpha(rho_inf=rho, **of, start="corrected"), SWING, FINER, (1.0,), "max",
       at(ALL, 2), 0.1) for rho in (0.0, 0.5, 0.8) for of in ({}, GGL)),
    (GeneralizedAlpha(start="corrected"), SPRING, COARSE, (1.0,), "max", at(ALL, 2), 0.05),
    (HHT(alpha=0.1), SPRING, COARSE, (1.0,), "max", at(ALL, 2), 0.05),
    (Newmark(beta=0.3, gamma=0.6), SPRING, FINE, (1.0,), "max", {"q": 1}, 0.1),
    # On index 3 the updated weights, restarted or not, show their order at fine steps only.
    *((GeneralizedAlpha(gamma=gamma, start="corrected", **of), SWING, tuple(h / 4 for h in FINER),
       UNEVEN, "settled", wanted, 0.08)
      for of, gamma, wanted in (
          ({}, "updated", TRANSIENT), (GGL, "fixed", at(ALL, 1)), (GGL, "updated", at(ALL, 2)),
          ({}, "guarded", TRANSIENT), (GGL, "guarded", at(ALL, 2)))),
    # 1, 0.2, 0.04: two cuts far below the safe ratio of 0.5, at which gamma would be infinite.
    (GeneralizedAlpha(gamma="guarded"), FORCED, (0.1, 0.05, 0.025), CUT, "max", at(ALL, 2), 0.1),
    # The classical acceleration spares q and v; fed back it spoils everything.
    (GeneralizedAlphaClassical(), FORCED, FINER, (1.0,), "max", at("qv", 2) | {"a": 1}, 0.05),
    *((m(), SPRING, FINE, (1.0,), "max", at(ALL, 1), 0.1)
      for m in (GeneralizedAlphaClassical, HHTClassical, WBZClassical)),
]  # fmt: skip
MORE = [
    *((m, SPRING, COARSE, (1.0,), "max", at(ALL, 2), 0.05) for m in (WBZ(rho_inf=0.8), Newmark())),
    *((m(), FORCED, FINER, (1.0,), "max", at("qv", 2) | {"a": 1}, 0.05)
      for m in (HHTClassical, WBZClassical)),
    *((GeneralizedAlphaClassical(), (s, 1.0), FINER[:2], (1.0,), "max", {"q": order}, 0.1)
      for s, order in ((AccelerationSensed(), 1), (PositionSensed(), 2))),
]  # fmt: skip


@pytest.mark.parametrize("cases", [ORDERS, *long([*MORE])])
def test_orders_are_those_of_the_papers(cases):
    for method, on, steps, pattern, part, wanted, within in cases:
        found = [errors(method, *on, h, pattern) for h in steps]
        for group, order in wanted.items():
            if group in found[0]:
                off = slope([*steps], [PARTS[part](e[group]) for e in found])
                assert off == pytest.approx(order, abs=within), (method.spec, group)


def test_free_parameters_have_the_order_that_they_claim():
    for options, wanted in [
        ({"alpha_m": 0.3, "alpha_f": 0.4, "delta_m": 0.3, "delta_f": 0.4}, 2.0),
        ({"gamma": 0.65}, 1.0),
    ]:
        method = GeneralizedAlpha(**options)
        found = [errors(method, *SPRING, h) for h in FINE]
        for group in found[0]:
            assert method.claims(SpringMass())[group] == wanted
            order = slope([*FINE], [max(e[group]) for e in found])
            assert order == pytest.approx(wanted, abs=0.1), group
    for scene, order in ((AccelerationSensed(), 1), (PositionSensed(), 2)):
        assert GeneralizedAlphaClassical().claims(scene)["q"] == order


@pytest.mark.long
def test_figure_6_is_missed_with_the_step_ratio_upside_down(mutant):
    found, steps = [], FIGURE_6[::3]
    for macro in steps:

        def inverted(alpha_m, alpha_f, shift, h, macro=macro):
            # shift is held in units of the last step, macro - h: 1/s in place of s = h/last
            # turns shift into shift * s^2.
            return updated_weight(alpha_m, alpha_f, shift * (h / (macro - h)) ** 2, h)

        mutant(generalized_alpha_step, "updated_weight", inverted)
        found.append(errors_at(GeneralizedAlpha(gamma="updated"), *SPRING, macro, UNEVEN))
    for group in STATES:
        assert slope([*steps], [e[group][-1] for e in found]) < 1.5


# ---- coefficients ----------------------------------------------------------------------
rho = st.floats(0.0, 1.0)


@given(rho, st.floats(1e-6, 1e3))
def test_the_parameters_meet_the_conditions_of_second_order_and_damping(rho_inf, h):
    alpha_m, alpha_f, beta, gamma = second_order_parameters(rho_inf)
    assert gamma == pytest.approx(0.5 + alpha_f - alpha_m)
    assert beta == pytest.approx(1 / (1 + rho_inf) ** 2)
    # At infinite frequency every root of the recurrence has this size.
    assert alpha_f / (1 - alpha_f) == pytest.approx(rho_inf)
    delta_m, delta_f, theta = first_order_parameters(rho_inf)
    assert theta == pytest.approx(0.5 + delta_f - delta_m)
    assert (1 - theta) / theta == pytest.approx(rho_inf, abs=1e-12)
    # Equal steps leave gamma as it is.
    weight, shift = updated_weight(alpha_m, alpha_f, (alpha_m - alpha_f) * h, h)
    assert weight == pytest.approx(gamma, rel=1e-9)
    assert shift == pytest.approx((alpha_m - alpha_f) * h, rel=1e-9)


def test_members_coincide_where_theory_says_so():
    assert HHT(alpha=1 / 3).second_order() == pytest.approx(second_order_parameters(0.5))
    assert WBZ(rho_inf=0.0).second_order() == pytest.approx(second_order_parameters(0.0))
    assert Newmark().second_order() == pytest.approx(HHT(alpha=0.0).second_order())
    for pair, scene, end, group in [
        ((HHT(alpha=1 / 3), GeneralizedAlpha(rho_inf=0.5)), Pendulum(), 1.35, "lam"),
        # The classical form moves as the true one.
        ((GeneralizedAlpha(), GeneralizedAlphaClassical()), Duffing(), 3.0, "q"),
    ]:
        one, two = (getattr(m.prepare(scene, end, Steps(0.01)).measure(), group) for m in pair)
        assert one == pytest.approx(two, rel=1e-12)
    # Errors of the accelerations, by an independent program.
    for method, error in ((GeneralizedAlpha(), 7.6e-6), (GeneralizedAlphaClassical(), 1.1e-3)):
        assert errors(method, *FORCED, 0.005)["a"][-1] == pytest.approx(error, rel=0.05)


def test_the_update_places_the_auxiliary_acceleration_exactly():
    # With a(t) linear, aux = a(t + shift) satisfies the recurrence and v is exact: in rationals.
    alpha_m, alpha_f = Fraction(1, 3), Fraction(4, 9)
    t, shift, steps = Fraction(0), Fraction(-1, 9), [Fraction(1), Fraction(7, 3), Fraction(3, 2)]
    for h in steps:
        gamma, after = updated_weight(alpha_m, alpha_f, shift, h)
        aux, aux_next = t + shift, t + h + after
        assert (1 - alpha_m) * aux_next + alpha_m * aux == (1 - alpha_f) * (t + h) + alpha_f * t
        v_exact = ((t + h) ** 2 - t**2) / 2
        # 0.5 in the formula is a float; it is exact here all the same.
        assert float(h * ((1 - gamma) * aux + gamma * aux_next)) == pytest.approx(float(v_exact))
        t, shift = t + h, after


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


def test_guarded_ratios_keep_gamma_in_its_proven_interval_and_others_meet_a_pole():
    chance = np.random.default_rng(29)
    for parameters in (second_order_parameters, first_order_parameters):
        alpha_m, alpha_f = parameters(0.8)[:2]
        low, high = (1 - alpha_m) / (2 * (1 - alpha_f)), 1 - alpha_m
        shift = alpha_m - alpha_f
        # Sharp cuts and long growth in turn; s = h/last is all that matters, so h restarts at 1.
        safe = np.log(smallest_safe_ratio(alpha_m))
        for s in np.exp(chance.uniform(safe, np.log(5.0), 5_000)):
            weight, after = updated_weight(alpha_m, alpha_f, shift, s)
            assert low * (1 - 1e-12) <= weight < high
            shift = after / s
    alpha_m, alpha_f, _, _ = second_order_parameters(0.8)
    shift = alpha_m - alpha_f
    for h in (1.0, 0.2):
        _, shift = updated_weight(alpha_m, alpha_f, shift, h)
    weights = [updated_weight(alpha_m, alpha_f, shift, h)[0] for h in np.linspace(0.01, 0.2, 500)]
    assert np.abs(weights).max() > 10


def test_the_projector_keeps_what_constraints_act_on():
    q = np.array([0.6, -0.8])
    part = constrained_part(Pendulum(m=3.0), q, 0.0, np.array([1.0, 2.0]))
    assert part == pytest.approx(q * (q @ [1.0, 2.0]), abs=1e-14)
