"""The generalized-alpha family: digits, orders, identities of coefficients, statuses."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest
from helpers import errors_at, forget_programs, local_slopes, long, nothing_compiled, slope
from hypothesis import given
from hypothesis import strategies as st

from integrators import Steps
from integrators.kept_rows import FIRST_ROWS, SPREAD_ROWS, spread_rows
from integrators.methods import generalized_alpha_step
from integrators.methods.generalized_alpha import HHT, WBZ, GeneralizedAlpha, Newmark
from integrators.methods.generalized_alpha_parameters import (
    first_order_parameters,
    second_order_parameters,
    updated_weight,
)
from integrators.native import constant_steps
from problems import MechatronicSystem, State, formulations, jnp, parameter
from problems.constraints import constraint_force
from problems.scenes.pendulum import Pendulum
from problems.scenes.spring_mass import SpringMass
from problems.spec import SpecError

# Steps of Fig. 6 of Bruels & Arnold (2008) that are in the asymptotic range.
FINE_MACRO_STEPS = [0.2 * 2.0**-k for k in (5, 6, 7, 8)]


@pytest.fixture
def mutant(monkeypatch):
    """Replace a function by a mutant, with programs compiled anew before and after."""

    def plant(module, name, wrong):
        monkeypatch.setattr(module, name, wrong)
        forget_programs()

    yield plant
    monkeypatch.undo()
    forget_programs()


# ---- digits ----------------------------------------------------------------------------
def paper_run():
    return GeneralizedAlpha(rho_inf=0.8).prepare(SpringMass(), 5.0, Steps(0.1)).measure()


def test_the_spring_mass_gives_the_digits_of_the_method():
    # Algorithm 1 of the paper with Newton converged to 1e-13, from an independent program.
    run = paper_run()
    assert run.status == "ok"
    assert run.t[-1] == 5.0
    assert run.q[-1, 0] == pytest.approx(-0.569897683826460, abs=1e-13)
    assert run.v[-1, 0] == pytest.approx(2.052987649185013, abs=1e-13)
    assert run.a[-1, 0] == pytest.approx(-0.427636884093702, abs=1e-13)
    assert run.x[-1, 0] == pytest.approx(-3.348650952505259, abs=1e-13)


def test_a_flipped_sign_of_the_actuation_misses_the_digits(mutant):
    right = formulations.dynamics_residual

    def wrong(scene, z):
        return right(scene, z) + 2 * (scene.actuation() @ z.y)

    mutant(formulations, "dynamics_residual", wrong)
    assert abs(paper_run().q[-1, 0] + 0.569897683826460) > 1e-2


# ---- orders ----------------------------------------------------------------------------
def test_figure_5_second_order_in_q_v_a_and_x():
    steps = [0.1, 0.04, 0.02, 0.01, 0.004, 0.002, 0.001, 0.0004]
    errors = [errors_at(GeneralizedAlpha(), SpringMass(), 5.0, h) for h in steps]
    for group in ("q", "v", "a", "x"):
        assert slope(steps, [e[group][-1] for e in errors]) == pytest.approx(2.0, abs=0.02)


def alternating_slopes(gamma):
    errors = [
        errors_at(GeneralizedAlpha(gamma=gamma), SpringMass(), 5.0, h, (0.3, 0.7))
        for h in FINE_MACRO_STEPS
    ]
    return {g: slope(FINE_MACRO_STEPS, [e[g][-1] for e in errors]) for g in ("q", "v", "a", "x")}


def test_figure_6_alternating_steps_cost_an_order_with_fixed_gamma():
    for order in alternating_slopes("fixed").values():
        assert 0.9 < order < 1.1


def test_figure_6_updated_gamma_and_theta_win_it_back():
    for order in alternating_slopes("updated").values():
        assert 1.98 < order < 2.02


@pytest.mark.long
def test_figure_6_is_missed_with_the_step_ratio_upside_down(mutant):
    errors, steps = [], FINE_MACRO_STEPS[::3]
    for macro in steps:

        def inverted(alpha_m, alpha_f, shift, h, macro=macro):
            # shift is held in units of the last step, macro - h: 1/s in place of s = h/last
            # turns shift into shift * s^2.
            return updated_weight(alpha_m, alpha_f, shift * (h / (macro - h)) ** 2, h)

        mutant(generalized_alpha_step, "updated_weight", inverted)
        method = GeneralizedAlpha(gamma="updated")
        errors.append(errors_at(method, SpringMass(), 5.0, macro, (0.3, 0.7)))
    for group in ("q", "v", "a", "x"):
        assert slope(steps, [e[group][-1] for e in errors]) < 1.5


RHO_STEPS = {0.0: 0.005, 0.5: 0.01, 0.8: 0.005, 0.9: 0.0025}


def pendulum_errors(rho_inf, coarsest, count=4):
    steps = [coarsest * 2.0**-k for k in range(count)]
    scene = Pendulum()
    return steps, [
        errors_at(GeneralizedAlpha(rho_inf=rho_inf), scene, scene.interval[1], h) for h in steps
    ]


def test_index_3_is_second_order_after_the_start_transient():
    for rho_inf, coarsest in RHO_STEPS.items():
        steps, errors = pendulum_errors(rho_inf, coarsest)
        for group in ("q", "v", "a", "lam"):
            settled = [e[group][len(e[group]) // 2 :].max() for e in errors]
            assert slope(steps, settled) == pytest.approx(2.0, abs=0.06), group


def test_index_3_is_first_order_in_lambda_with_the_start_transient():
    for rho_inf, coarsest in RHO_STEPS.items():
        steps, errors = pendulum_errors(rho_inf, coarsest)
        for group in ("a", "lam"):
            assert slope(steps, [e[group].max() for e in errors]) == pytest.approx(1.0, abs=0.1)
        for group in ("q", "v"):
            assert slope(steps, [e[group].max() for e in errors]) == pytest.approx(2.0, abs=0.06)


def test_without_damping_lambda_does_not_converge_on_index_3():
    steps, errors = pendulum_errors(1.0, 0.01)
    assert np.abs(local_slopes(steps, [e["lam"].max() for e in errors])).max() < 0.05
    assert slope(steps, [e["q"].max() for e in errors]) == pytest.approx(2.0, abs=0.05)


@pytest.mark.long
def test_a_flipped_sign_of_the_constraint_force_spoils_lambda(mutant):
    right = constraint_force
    mutant(formulations, "constraint_force", lambda *given: -right(*given))
    _, errors = pendulum_errors(0.8, 0.005, count=1)
    assert errors[0]["lam"][-1] > 1.0


@pytest.mark.parametrize("cases", [(HHT(alpha=0.1),), *long([WBZ(rho_inf=0.8), Newmark()])])
def test_every_member_is_second_order_on_the_spring_mass(cases):
    for method in cases:
        steps = [0.02, 0.01, 0.005, 0.0025]
        errors = [errors_at(method, SpringMass(), 5.0, h) for h in steps]
        for group in ("q", "v", "a", "x", "y"):
            assert slope(steps, [e[group].max() for e in errors]) == pytest.approx(2.0, abs=0.05)


def test_newmark_with_another_gamma_is_first_order():
    steps = [0.01, 0.005, 0.0025, 0.00125]
    errors = [errors_at(Newmark(beta=0.3, gamma=0.6), SpringMass(), 5.0, h) for h in steps]
    assert slope(steps, [e["q"].max() for e in errors]) == pytest.approx(1.0, abs=0.1)


# ---- coefficients ----------------------------------------------------------------------
rho = st.floats(0.0, 1.0)


@given(rho)
def test_the_parameters_meet_the_conditions_of_second_order_and_damping(rho_inf):
    alpha_m, alpha_f, beta, gamma = second_order_parameters(rho_inf)
    assert gamma == pytest.approx(0.5 + alpha_f - alpha_m)
    assert beta == pytest.approx(1 / (1 + rho_inf) ** 2)
    # At infinite frequency every root of the recurrence has this size.
    assert alpha_f / (1 - alpha_f) == pytest.approx(rho_inf)
    delta_m, delta_f, theta = first_order_parameters(rho_inf)
    assert theta == pytest.approx(0.5 + delta_f - delta_m)
    assert (1 - theta) / theta == pytest.approx(rho_inf, abs=1e-12)


def test_members_coincide_where_theory_says_so():
    assert HHT(alpha=1 / 3).second_order() == pytest.approx(second_order_parameters(0.5))
    assert WBZ(rho_inf=0.0).second_order() == pytest.approx(second_order_parameters(0.0))
    newmark, undamped = Newmark().second_order(), HHT(alpha=0.0).second_order()
    assert newmark == pytest.approx(undamped)
    run = [
        m.prepare(Pendulum(), 1.35, Steps(0.01)).measure()
        for m in (HHT(alpha=1 / 3), GeneralizedAlpha(rho_inf=0.5))
    ]
    assert run[0].lam == pytest.approx(run[1].lam, rel=1e-12)


def test_the_update_gives_the_published_sequences():
    # rho_inf = 0.8 with steps 0.3 H, 0.7 H in turn.
    gammas = [0.611111, 0.605263, 0.625000, 0.600000, 0.627451, 0.598540]
    thetas = [0.555556, 0.552511, 0.564751, 0.548965, 0.567663, 0.547404]
    alpha_m, alpha_f, _, _ = second_order_parameters(0.8)
    delta_m, delta_f, _ = first_order_parameters(0.8)
    for m, f, wanted in ((alpha_m, alpha_f, gammas), (delta_m, delta_f, thetas)):
        shift, ours = (m - f) * 0.3, []
        for k in range(6):
            weight, shift = updated_weight(m, f, shift, (0.3, 0.7)[k % 2])
            ours.append(weight)
        assert ours == pytest.approx(wanted, abs=6e-7)


@given(rho, st.floats(1e-6, 1e3))
def test_equal_steps_leave_gamma_as_it_is(rho_inf, h):
    alpha_m, alpha_f, _, gamma = second_order_parameters(rho_inf)
    weight, shift = updated_weight(alpha_m, alpha_f, (alpha_m - alpha_f) * h, h)
    assert weight == pytest.approx(gamma, rel=1e-9)
    assert shift == pytest.approx((alpha_m - alpha_f) * h, rel=1e-9)


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


# ---- the kernel ------------------------------------------------------------------------
@dataclass(frozen=True)
class Blowing(MechatronicSystem):
    """q'' = growth q, with a force that is NaN after t_nan."""

    growth: float = parameter(0.0, "1/s^2", "negative stiffness")
    t_nan: float = parameter(9.0, "s", "time after which the force is NaN")

    def mass(self, q):
        return jnp.eye(1)

    def force(self, q, v, t):
        return jnp.where(t > self.t_nan, jnp.nan, self.growth) * q

    def initial_state(self):
        return State(q=np.ones(1), v=np.zeros(1))


@dataclass(frozen=True)
class Jump(MechatronicSystem):
    """q'' = -sign(v) |v|^0.2 with a needle: Newton's method cannot settle at large steps."""

    def mass(self, q):
        return jnp.eye(1)

    def force(self, q, v, t):
        return -1e3 * jnp.sign(v - 0.5) * jnp.abs(v - 0.5) ** 0.1

    def initial_state(self):
        return State(q=np.zeros(1), v=np.ones(1))


def kernel_of(method, scene):
    return method.prepare(scene, 5.0, Steps(0.1)).kernel


def test_schemes_steps_patterns_and_parameters_compile_nothing_new():
    constant_steps.kernel.cache_clear()
    scene = SpringMass()
    GeneralizedAlpha().prepare(scene, 5.0, Steps(0.1)).measure()
    compiled = kernel_of(GeneralizedAlpha(), scene)
    updated = GeneralizedAlpha(gamma="updated")
    with nothing_compiled():
        for other in (SpringMass(k=3.0), SpringMass(b=0.2)):
            for method in (GeneralizedAlpha(rho_inf=0.3), updated, HHT(), WBZ(), Newmark()):
                assert kernel_of(method, other) is compiled
                for steps in (Steps(0.01), Steps(0.3), Steps(0.5, (0.3, 0.7))):
                    method.prepare(other, 4.0, steps).measure()


def test_memory_does_not_grow_with_the_number_of_steps():
    sizes = []
    for h in (0.1, 1e-4):
        output = GeneralizedAlpha().prepare(SpringMass(), 5.0, Steps(h)).execute()
        sizes.append(sum(np.asarray(part).nbytes for part in output[0]))
    assert sizes[0] == sizes[1] < 120_000


def test_runs_are_the_same_to_the_bit():
    first, second = (
        GeneralizedAlpha().prepare(Pendulum(), 1.35, Steps(0.01)).measure() for _ in range(2)
    )
    for name in ("t", "q", "v", "a", "lam"):
        assert np.array_equal(getattr(first, name), getattr(second, name))


def test_rows_start_with_the_first_steps_and_end_at_the_end():
    run = GeneralizedAlpha().prepare(Pendulum(), 1.35, Steps(1e-3, (0.25, 0.75))).measure()
    assert run.t[:4] == pytest.approx([0.35, 0.35025, 0.351, 0.35125], abs=1e-12)
    assert run.t[-1] == pytest.approx(1.35, abs=1e-15)
    assert (np.diff(run.t) > 0).all()
    assert run.work.steps == 2000


def test_newton_work_is_counted():
    run = GeneralizedAlpha().prepare(Blowing(growth=-4.0), 1.0, Steps(0.1)).measure()
    # A linear scene: one iteration solves a step, a second one confirms it.
    assert run.work.steps == 10
    assert run.work.newton == run.work.residuals == run.work.factorisations == 20


def test_constraints_hold_to_the_tolerance_that_shrinks_with_the_step():
    for h in (1e-2, 1e-3):
        run = GeneralizedAlpha().prepare(Pendulum(), 1.35, Steps(h)).measure()
        assert np.abs((run.q**2).sum(1) - 1).max() < 20 * h**2 * 1e-12 + 1e-15


def test_numerical_trouble_is_a_status_that_names_the_time():
    for scene, t_end, h, status, time in [
        (Blowing(growth=1e4), 1.0, 0.01, "diverged", "0.2"),
        (Blowing(t_nan=0.55), 1.0, 0.1, "diverged", "0.6"),
        (Jump(), 1.0, 0.5, "newton_failed", "0.5"),
    ]:
        run = GeneralizedAlpha(rho_inf=1.0).prepare(scene, t_end, Steps(h)).measure()
        assert run.status == status
        assert f"t={time}" in run.message
        assert "smaller step" in run.message
        assert run.t[-1] < t_end
        assert np.isfinite(run.q).all()


def test_a_step_must_be_positive_and_fit_the_interval():
    with pytest.raises(SpecError, match="positive"):
        Steps(0.0)
    with pytest.raises(SpecError, match="positive"):
        Steps(float("nan"))
    with pytest.raises(SpecError, match="sum to 1"):
        Steps(0.1, (0.3, 0.3))
    with pytest.raises(SpecError, match="larger than the interval"):
        Steps(2.0).count(0.0, 1.0)
    assert Steps(0.1).count(0.0, 5.0) == 50
    assert Steps(0.3).count(0.0, 1.0) == 4


@given(st.integers(1, 20_000))
def test_a_trajectory_keeps_enough_rows_whatever_the_number_of_steps(steps):
    rows = spread_rows(steps)
    assert rows[0] == 0
    assert rows[-1] == steps
    assert (np.diff(rows) > 0).all()
    assert min(steps, 100) < len(rows) <= FIRST_ROWS + SPREAD_ROWS + 1


def test_constraints_need_positions_in_the_step():
    assert "beta" in Newmark(beta=0.0).supports(Pendulum())
    assert Newmark(beta=0.0).supports(SpringMass()) is None
