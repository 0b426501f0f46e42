"""The generalized-alpha family: digits, orders, identities, kernels, counts, statuses, options."""

import math
from fractions import Fraction
from functools import cache

import numpy as np
import pytest
from helpers import Probe, errors_at, long, nothing_compiled, run_of, slope, toy
from hypothesis import given
from hypothesis import strategies as st

from bench.running.measure import stored_rows
from integrators import Steps
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
from integrators.native.loops import constant_steps
from integrators.output_rows import FIRST_ROWS, SPREAD_ROWS, spread_rows
from problems import jax, jnp
from problems.base.spec import SpecError, build
from problems.equations.kinematics import constrained_part
from problems.scenes.contacts import SoftImpact
from problems.scenes.oscillators import SpringMass
from problems.scenes.pendulums import Pendulum

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


def test_the_spring_mass_gives_the_digits_of_the_method():
    # Algorithm 1 of the paper with Newton converged to 1e-13, from an independent program.
    run = run_of(GeneralizedAlpha(rho_inf=0.8), SpringMass(), 0.1, 5.0)
    assert run.t[-1] == 5.0
    for group, value in DIGITS.items():
        assert getattr(run, group)[-1, 0] == pytest.approx(value, abs=1e-13)


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
FREE = GeneralizedAlpha(alpha_m=0.3, alpha_f=0.4, delta_m=0.3, delta_f=0.4)


def of_index3(rho, h):
    """Of second order after the start transient, which is of first order in lam."""
    method, steps = GeneralizedAlpha(rho_inf=rho), tuple(h / 2**k for k in range(4))
    return [
        (method, SWING, steps, (1.0,), *found)
        for found in (
            ("settled", at(ALL, 2), 0.06),
            ("max", at("qv", 2), 0.06),
            ("max", at(("a", "lam"), 1), 0.1),
        )
    ]


def of_updated(options, gamma, wanted):
    method = GeneralizedAlpha(gamma=gamma, start="corrected", **options)
    return [(method, SWING, tuple(h / 4 for h in FINER), UNEVEN, "settled", wanted, 0.08)]


#: Method, scene and end, steps and pattern, part of the errors, orders, and how far they are off.
ORDERS = [
    (GeneralizedAlpha(), SPRING, FIGURE_5, (1.0,), "end", at(STATES, 2), 0.02),
    # Alternating steps cost an order with fixed gamma; updated gamma and theta win it back.
    (GeneralizedAlpha(gamma="fixed"), SPRING, FIGURE_6, UNEVEN, "end", at(STATES, 1), 0.1),
    (GeneralizedAlpha(gamma="updated"), SPRING, FIGURE_6, UNEVEN, "end", at(STATES, 2), 0.02),
    *of_index3(0.5, 0.01),
    # Without damping lam does not converge.
    (GeneralizedAlpha(rho_inf=1.0), SWING, FINE, (1.0,), "max", {"q": 2, "lam": 0}, 0.05),
    *((GeneralizedAlpha(rho_inf=0.8, **of), SWING, FINER, (1.0,), "max", TRANSIENT, 0.05)
      for of in ({}, GGL)),
    *((GeneralizedAlpha(rho_inf=0.8, **of, start="corrected"), SWING, FINER, (1.0,), "max",
       at(ALL, 2), 0.1) for of in ({}, GGL)),
    (GeneralizedAlpha(start="corrected"), SPRING, COARSE, (1.0,), "max", at(ALL, 2), 0.05),
    (HHT(alpha=0.1), SPRING, COARSE, (1.0,), "max", at(ALL, 2), 0.05),
    (Newmark(beta=0.3, gamma=0.6), SPRING, FINE, (1.0,), "max", {"q": 1}, 0.1),
    # On index 3 the updated weights, restarted or not, show their order at fine steps only.
    *of_updated(GGL, "guarded", at(ALL, 2)),
    # 1, 0.2, 0.04: two cuts far below the safe ratio of 0.5, at which gamma would be infinite.
    (GeneralizedAlpha(gamma="guarded"), FORCED, (0.1, 0.05, 0.025), CUT, "max", at(ALL, 2), 0.1),
    # The classical acceleration spares q and v; fed back it spoils everything.
    (GeneralizedAlphaClassical(), FORCED, FINER, (1.0,), "max", at("qv", 2) | {"a": 1}, 0.05),
    *((m(), SPRING, FINE, (1.0,), "max", at(ALL, 1), 0.1)
      for m in (GeneralizedAlphaClassical, HHTClassical, WBZClassical)),
    # Parameters that are given one by one.
    (GeneralizedAlpha(gamma=0.65), SPRING, FINE, (1.0,), "max", at(ALL, 1), 0.1),
    (FREE, SPRING, FINE, (1.0,), "max", at(ALL, 2), 0.1),
]  # fmt: skip
MORE = [
    *(case for rho, h in {0.0: 0.005, 0.8: 0.005, 0.9: 0.0025}.items()
      for case in of_index3(rho, h)),
    (GeneralizedAlpha(rho_inf=1.0, **GGL, start="corrected"), SWING, FINER, (1.0,), "max",
     at(ALL, 2), 0.05),
    *((GeneralizedAlpha(rho_inf=rho, **of, start="corrected"), SWING, FINER, (1.0,), "max",
       at(ALL, 2), 0.1) for rho in (0.0, 0.5) for of in ({}, GGL)),
    *of_updated({}, "updated", TRANSIENT), *of_updated({}, "guarded", TRANSIENT),
    *of_updated(GGL, "fixed", at(ALL, 1)), *of_updated(GGL, "updated", at(ALL, 2)),
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


def test_orders_that_fall_are_claimed():
    for method, scene, order in [
        (FREE, SpringMass(), 2),
        (GeneralizedAlpha(gamma=0.65), SpringMass(), 1),
        (GeneralizedAlphaClassical(), AccelerationSensed(), 1),
        (GeneralizedAlphaClassical(), PositionSensed(), 2),
    ]:
        assert method.claims(scene)["q"] == order
    assert {*GeneralizedAlpha(gamma=0.65).claims(SpringMass()).values()} == {1}


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
    assert HHT(alpha=1 / 3).parameters()[0] == pytest.approx(second_order_parameters(0.5))
    assert WBZ(rho_inf=0.0).parameters()[0] == pytest.approx(second_order_parameters(0.0))
    assert Newmark().parameters()[0] == pytest.approx(HHT(alpha=0.0).parameters()[0])
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


@given(st.fractions(0, 1, max_denominator=20), st.lists(st.fractions("0.7", 3), max_size=8))
def test_the_update_places_the_auxiliary_acceleration_exactly(rho_inf, ratios):
    # With a(t) linear, aux = a(t + shift) satisfies the recurrence and v is exact: in rationals.
    alpha_m, alpha_f = (2 * rho_inf - 1) / (rho_inf + 1), rho_inf / (rho_inf + 1)
    t, shift, h = Fraction(0), alpha_m - alpha_f, Fraction(1)
    for ratio in [1, *ratios]:
        h *= ratio
        gamma, after = updated_weight(alpha_m, alpha_f, shift, h)
        aux, aux_next = t + shift, t + h + after
        assert (1 - alpha_m) * aux_next + alpha_m * aux == (1 - alpha_f) * (t + h) + alpha_f * t
        v_exact = ((t + h) ** 2 - t**2) / 2
        # 0.5 in the formula is a float; it is exact here all the same.
        assert float(h * ((1 - gamma) * aux + gamma * aux_next)) == pytest.approx(float(v_exact))
        t, shift = t + h, after


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
    part = jax.jit(lambda q, w: constrained_part(Pendulum(m=3.0), q, 0.0, w))(
        q, np.array([1.0, 2.0])
    )
    assert part == pytest.approx(q * (q @ [1.0, 2.0]), abs=1e-14)


# ---- the kernel ------------------------------------------------------------------------
#: A force with a needle, on which Newton's method cannot settle at large steps.
Jump = toy(
    "Jump", v=[1.0], force=lambda self, q, v, t: -1e3 * jnp.sign(v - 0.5) * jnp.abs(v - 0.5) ** 0.1
)


def test_schemes_steps_patterns_and_parameters_compile_nothing_new():
    constant_steps.kernel.cache_clear()
    prepared = GeneralizedAlpha().prepare(SpringMass(), 5.0, Steps(0.1))
    prepared.measure()
    with nothing_compiled():
        for other in (SpringMass(k=3.0), SpringMass(b=0.2)):
            for method in (GeneralizedAlpha(rho_inf=0.3, gamma="updated"), HHT(), WBZ(), Newmark()):
                for steps in (Steps(0.01), Steps(0.3), Steps(0.5, (0.3, 0.7))):
                    run = method.prepare(other, 4.0, steps)
                    assert run.kernel is prepared.kernel
                    run.measure()


def test_memory_does_not_grow_with_the_number_of_steps_and_runs_are_the_same_to_the_bit():
    runs = [GeneralizedAlpha().prepare(SpringMass(), 5.0, Steps(h)) for h in (0.1, 1e-4)]
    sizes = [sum(np.asarray(part).nbytes for part in run.execute()[0]) for run in runs]
    assert sizes[0] == sizes[1] < 120_000
    first, second = (runs[0].measure() for _ in range(2))
    for name in ("t", "q", "v", "a", "x"):
        assert np.array_equal(getattr(first, name), getattr(second, name))


@given(st.integers(1, 20_000))
def test_a_trajectory_keeps_enough_rows_whatever_the_number_of_steps(steps):
    rows = spread_rows(steps)
    first = min(steps, FIRST_ROWS) + 1
    assert rows[:first].tolist() == [*range(first)]
    assert rows[-1] == steps
    assert (np.diff(rows) > 0).all()
    assert min(steps, 100) < len(rows) <= FIRST_ROWS + SPREAD_ROWS + 1


def test_newton_work_is_counted():
    work = run_of(GeneralizedAlpha(), Probe(v0=0.5), 0.1, 1.0).work
    # A linear scene: one iteration solves a step, a second one confirms it.
    assert work.steps == 10
    assert work.newton == work.residuals == work.factorisations == 20
    # Central differences are explicit: equations that are linear in a alone.
    work = run_of(Newmark(beta=0.0), Probe(k=1.0, v0=0.5), 0.1, 10.0).work
    assert work.newton <= 2 * work.steps


def test_constraints_hold_to_the_tolerance_that_shrinks_with_the_step():
    for h in (1e-2, 1e-3):
        run = run_of(GeneralizedAlpha(), Pendulum(), h, 1.35)
        assert np.abs((run.q**2).sum(1) - 1).max() < 20 * h**2 * 1e-12 + 1e-15
        assert np.abs((run.q * run.v).sum(1)).max() > 1e-8  # index 3 leaves velocities alone
    both = run_of(GeneralizedAlpha(**GGL), Pendulum(), 1e-2, 1.35)
    assert np.abs((both.q**2).sum(1) - 1).max() < 1e-14
    assert np.abs((both.q * both.v).sum(1)).max() < 1e-13


def test_numerical_trouble_is_a_status_that_names_the_time():
    for scene, h, status, time in [
        (Probe(k=-1e4, v0=0.5), 0.01, "diverged", "0.2"),
        (Probe(k=0.0, breaks_at=0.55), 0.1, "diverged", "0.6"),
        (Jump(), 0.5, "newton_failed", "0.5"),
    ]:
        run = run_of(GeneralizedAlpha(rho_inf=1.0), scene, Steps(h), 1.0, status)
        assert f"t={time}" in run.message
        assert "smaller step" in run.message
        assert run.t[-1] < 1.0
        assert np.isfinite(run.q).all()


# ---- modified Newton -------------------------------------------------------------------
@pytest.mark.parametrize(
    ("scene", "h", "within", "turns", "options"),
    [
        (Pendulum(), 0.001, 1e-8, 3.3, {}),
        *long(
            (Pendulum(), 0.001, 1e-8, 4.2, GGL),
            *((SpringMass(), 0.02, 1e-9, 3.9, of) for of in ({}, GGL)),
            *((SoftImpact(), 1e-4, 1e-9, 2.1, of) for of in ({}, GGL)),
        ),
    ],
)
def test_modified_newton_solves_the_same_with_few_tangents(scene, h, within, turns, options):
    full, modified = (
        run_of(GeneralizedAlpha(newton=kind, **options), scene, h) for kind in ("full", "modified")
    )
    for group in ("q", "v", "a", "lam", "x", "y"):
        a, b = getattr(full, group), getattr(modified, group)
        np.testing.assert_allclose(a, b, rtol=0, atol=within * max(1.0, np.abs(a).max(initial=0)))
    steps = full.work.steps
    assert 2 * steps <= full.work.residuals == full.work.jacobians < 2.01 * steps
    assert modified.work.jacobians == modified.work.factorisations < 0.035 * steps
    assert modified.work.residuals == modified.work.newton == modified.work.solves < turns * steps


# ---- weights ---------------------------------------------------------------------------
def test_steps_and_weights_are_recorded_as_published_and_guarded_ones_restart():
    published = {
        "gamma": [0.611111, 0.605263, 0.625000, 0.600000, 0.627451, 0.598540],
        "theta": [0.555556, 0.552511, 0.564751, 0.548965, 0.567663, 0.547404],
    }
    fixed, updated, guarded = (
        run_of(GeneralizedAlpha(gamma=gamma), SpringMass(), Steps(0.1, UNEVEN))
        for gamma in ("fixed", "updated", "guarded")
    )
    assert math.isnan(fixed.notes["h"][0])  # no step led to the start
    np.testing.assert_allclose(fixed.notes["h"][1:5], [0.03, 0.07, 0.03, 0.07])
    assert np.ptp(fixed.notes["gamma"][1:]) == 0
    rows = stored_rows(fixed)
    assert rows.notes["gamma"][0] is None
    assert rows.notes["gamma"][1:7] == fixed.notes["gamma"][1:7].tolist()
    s = GeneralizedAlpha().scheme()
    for name, m, f in (("gamma", s.alpha_m, s.alpha_f), ("theta", s.delta_m, s.delta_f)):
        np.testing.assert_allclose(updated.notes[name][1:7], published[name], atol=6e-7)
        # 0.03/0.07 is a sharper cut than the guard allows: every other step restarts, shift = 0
        shift, wanted = (m - f) * 0.03, []
        for n in range(6):
            shift = 0.0 if n and n % 2 == 0 else shift
            weight, shift = updated_weight(m, f, shift, (0.03, 0.07)[n % 2])
            wanted.append(weight)
        np.testing.assert_allclose(guarded.notes[name][1:7], wanted, rtol=1e-12)
        assert np.abs(guarded.notes[name] - updated.notes[name])[3:].max() > 0.005


def test_a_cut_restarts_only_the_weight_whose_limit_it_passes():
    """Bruels & Arnold (2008), eqs (28)-(30), worked out by hand for h = 4/5 and h = 1/5."""
    for rho_inf, of_x, gamma, theta in [
        # Smallest safe ratios of steps are alpha_m/(1 - alpha_m) and delta_m/(1 - delta_m):
        # 1/2 and 1/13 here, so that the cut to 1/4 restarts the motion alone,
        (0.8, 0.4, 3 / 5, 247 / 308),
        # and here below zero and 7/11, so that it restarts the controller alone.
        (0.4, 0.8, 124 / 119, 11 / 20),
    ]:
        delta_m, delta_f, _ = first_order_parameters(of_x)
        own = {"delta_m": delta_m, "delta_f": delta_f}
        method = GeneralizedAlpha(rho_inf=rho_inf, **own, gamma="guarded")
        notes = run_of(method, SpringMass(), Steps(0.1, (0.8, 0.2)), 0.1).notes
        assert notes["gamma"][2] == pytest.approx(gamma, rel=1e-12)
        assert notes["theta"][2] == pytest.approx(theta, rel=1e-12)


# ---- refusals ---------------------------------------------------------------------------
def test_members_that_constraints_destabilise_and_values_outside_their_range_are_refused():
    for beta in (0.0, 1 / 12, 1 / 6):
        assert "2 beta >= gamma" in Newmark(beta=beta).supports(Pendulum())
        assert Newmark(beta=beta).supports(SpringMass()) is None
    assert Newmark().supports(Pendulum()) is None
    assert build(Newmark, {"beta": "1/12"}, "newmark") == Newmark(beta=1 / 12)
    with pytest.raises(SpecError, match="beta=1/0 is not a float"):
        build(Newmark, {"beta": "1/0"}, "newmark")
    for member in [HHT, HHTClassical]:
        for alpha in ("0.4", "-0.1"):
            with pytest.raises(SpecError, match=rf"alpha={alpha} .*\[0.0, 0.33"):
                build(member, {"alpha": alpha}, member.name)
        assert build(member, {"alpha": "1/3"}, member.name).parameters()[0].alpha_f == 1 / 3
