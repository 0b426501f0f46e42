"""Runs of the generalized-alpha family: compiled programs, rows, counts, statuses, options."""

import math

import numpy as np
import pytest
from helpers import long, nothing_compiled, toy
from hypothesis import given
from hypothesis import strategies as st

from bench.running.measure import stored_rows
from integrators import Steps
from integrators.methods.generalized_alpha import HHT, WBZ, GeneralizedAlpha, HHTClassical, Newmark
from integrators.methods.generalized_alpha_step import first_order_parameters, updated_weight
from integrators.native.loops import constant_steps
from integrators.output_rows import FIRST_ROWS, SPREAD_ROWS, spread_rows
from problems import State, jax, jnp, parameter
from problems.base.spec import SpecError, build
from problems.equations.initial_values import consistent_start
from problems.scenes.contacts import SoftImpact
from problems.scenes.oscillators import SpringMass
from problems.scenes.pendulums import Pendulum

GGL = {"formulation": "stabilised_index2"}


def run_of(method, scene, h, pattern=(1.0,), t_end=None):
    run = method.prepare(scene, t_end or scene.interval[1], Steps(h, pattern)).measure()
    assert run.status == "ok", run.message
    return run


# ---- the kernel ------------------------------------------------------------------------
#: q'' = growth q, with a force that is NaN after t_nan; and a force with a needle, on which
#: Newton's method cannot settle at large steps.
Blowing = toy(
    "Blowing", interval=(0.0, 4000.0), growth=parameter(-1.0, "1/s^2", "negative stiffness"),
    t_nan=parameter(1e9, "s", "time after which the force is NaN"),
    v0=parameter(0.5, "m/s", "velocity at the start"),
    force=lambda self, q, v, t: jnp.where(t > self.t_nan, jnp.nan, self.growth) * q,
    initial_state=lambda self: State(np.ones(1), np.array([self.v0])),
)  # fmt: skip
Jump = toy(
    "Jump", base=Blowing,
    force=lambda self, q, v, t: -1e3 * jnp.sign(v - 0.5) * jnp.abs(v - 0.5) ** 0.1,
)  # fmt: skip


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


def test_rows_start_with_the_first_steps_and_end_at_the_end():
    run = run_of(GeneralizedAlpha(), Pendulum(), 1e-3, (0.25, 0.75), 1.35)
    assert run.t[:4] == pytest.approx([0.35, 0.35025, 0.351, 0.35125], abs=1e-12)
    assert run.t[-1] == pytest.approx(1.35, abs=1e-15)
    assert (np.diff(run.t) > 0).all()
    assert run.work.steps == 2000
    assert (Steps(0.1).count(0.0, 5.0), Steps(0.3).count(0.0, 1.0)) == (50, 4)


@given(st.integers(1, 20_000))
def test_a_trajectory_keeps_enough_rows_whatever_the_number_of_steps(steps):
    rows = spread_rows(steps)
    assert (rows[0], rows[-1]) == (0, steps)
    assert (np.diff(rows) > 0).all()
    assert min(steps, 100) < len(rows) <= FIRST_ROWS + SPREAD_ROWS + 1


def test_newton_work_is_counted():
    work = run_of(GeneralizedAlpha(), Blowing(growth=-4.0), 0.1, t_end=1.0).work
    # A linear scene: one iteration solves a step, a second one confirms it.
    assert work.steps == 10
    assert work.newton == work.residuals == work.factorisations == 20
    # Central differences are explicit: equations that are linear in a alone.
    work = run_of(Newmark(beta=0.0), Blowing(), 0.1, t_end=10.0).work
    assert work.newton <= 2 * work.steps


def test_constraints_hold_to_the_tolerance_that_shrinks_with_the_step():
    for h in (1e-2, 1e-3):
        run = run_of(GeneralizedAlpha(), Pendulum(), h, t_end=1.35)
        assert np.abs((run.q**2).sum(1) - 1).max() < 20 * h**2 * 1e-12 + 1e-15
        assert np.abs((run.q * run.v).sum(1)).max() > 1e-8  # index 3 leaves velocities alone
    both = run_of(GeneralizedAlpha(**GGL), Pendulum(), 1e-2, t_end=1.35)
    assert np.abs((both.q**2).sum(1) - 1).max() < 1e-14
    assert np.abs((both.q * both.v).sum(1)).max() < 1e-13


def test_numerical_trouble_is_a_status_that_names_the_time():
    for scene, h, status, time in [
        (Blowing(growth=1e4), 0.01, "diverged", "0.2"),
        (Blowing(growth=0.0, t_nan=0.55), 0.1, "diverged", "0.6"),
        (Jump(v0=1.0), 0.5, "newton_failed", "0.5"),
    ]:
        run = GeneralizedAlpha(rho_inf=1.0).prepare(scene, 1.0, Steps(h)).measure()
        assert run.status == status
        assert f"t={time}" in run.message
        assert "smaller step" in run.message
        assert run.t[-1] < 1.0
        assert np.isfinite(run.q).all()


# ---- modified Newton -------------------------------------------------------------------
@pytest.mark.parametrize(
    ("scene", "h", "within", "options"),
    [
        (Pendulum(), 0.001, 1e-8, {}),
        *long(
            (Pendulum(), 0.001, 1e-8, GGL),
            *((SpringMass(), 0.02, 1e-9, of) for of in ({}, GGL)),
            *((SoftImpact(), 1e-4, 1e-9, of) for of in ({}, GGL)),
        ),
    ],
)
def test_modified_newton_solves_the_same_equations_with_few_tangents(scene, h, within, options):
    full, modified = (
        run_of(GeneralizedAlpha(newton=kind, **options), scene, h) for kind in ("full", "modified")
    )
    for group in ("q", "v", "a", "lam", "x", "y"):
        a, b = getattr(full, group), getattr(modified, group)
        np.testing.assert_allclose(a, b, rtol=0, atol=within * max(1.0, np.abs(a).max(initial=0)))
    assert modified.work.jacobians < full.work.jacobians / 5
    assert modified.work.jacobians == modified.work.factorisations
    assert modified.work.residuals == modified.work.newton == modified.work.solves


def test_an_old_tangent_is_given_up_where_it_stops_contracting():
    method, scene = GeneralizedAlpha(newton="modified"), SpringMass()
    program, numbers = method.program(scene)
    h = jnp.asarray(0.05)
    begin = jax.jit(lambda start: program.begin(scene, numbers, start, h))
    step = jax.jit(lambda state, t: program.step(scene, numbers, state, t, h))
    state, first = step(begin(consistent_start(scene)), 0.05)
    assert first.jacobians >= 1  # none was there
    _, with_kept = step(state, 0.1)
    spoiled, report = step(state._replace(kept=(-3.0 * state.kept[0],)), 0.1)
    assert report.converged
    assert report.jacobians > with_kept.jacobians
    assert np.isfinite(program.read(scene, spoiled).q).all()


# ---- weights ---------------------------------------------------------------------------
def test_steps_and_weights_are_recorded_as_published_and_guarded_ones_restart():
    published = {
        "gamma": [0.611111, 0.605263, 0.625000, 0.600000, 0.627451, 0.598540],
        "theta": [0.555556, 0.552511, 0.564751, 0.548965, 0.567663, 0.547404],
    }
    fixed, updated, guarded = (
        run_of(GeneralizedAlpha(gamma=gamma), SpringMass(), 0.1, (0.3, 0.7))
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
        notes = run_of(method, SpringMass(), 0.1, (0.8, 0.2), 0.1).notes
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
        assert build(member, {"alpha": "1/3"}, member.name).second_order().alpha_f == 1 / 3
