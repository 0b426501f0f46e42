"""The adaptive generalized-alpha method: tolerance, estimates, steps, statuses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest
from helpers import long, nothing_compiled, reference, slope
from scipy.integrate import solve_ivp

from integrators import Steps, Tolerances
from integrators.kept_rows import FIRST_ROWS, MOST_ROWS
from integrators.methods import generalized_alpha_adaptive
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.methods.generalized_alpha_adaptive import (
    AdaptiveAlphaStep,
    GeneralizedAlphaAdaptive,
)
from problems import MechatronicSystem, State, jax, jnp, parameter
from problems.formulations import ode_rate
from problems.initial_values import consistent_start
from problems.scenes.duffing import Duffing
from problems.scenes.pendulum import Pendulum
from problems.scenes.soft_impact import SoftImpact
from problems.scenes.spring_mass import SpringMass

TOLERANCES = [1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8]
GROUPS = ("q", "v", "a", "lam", "x")
SWING = Pendulum(th0=3.1)  # released close to the upright position: slow, fast, slow again
SWING_END = 3.2


def run_of(method, scene, rtol):
    t_end = SWING_END if scene is SWING else scene.interval[1]
    run = method.prepare(scene, t_end, Tolerances(rtol)).measure()
    assert run.status == "ok", run.message
    return run


def errors_of(run, scene):
    exact = reference(scene, float(run.t[-1]))(run.t)
    return {
        g: np.linalg.norm(getattr(run, g) - exact[g], axis=1).max()
        / np.linalg.norm(exact[g], axis=1).max()
        for g in GROUPS
        if exact[g].shape[1]
    }


@pytest.mark.parametrize(
    "scene", [Pendulum(), *long(Duffing(), SpringMass(), SWING)], ids=lambda s: s.spec
)
def test_the_achieved_error_follows_the_tolerance(scene):
    method = GeneralizedAlphaAdaptive()
    errors = [errors_of(run_of(method, scene, tol), scene) for tol in TOLERANCES]
    for group in errors[0]:
        assert 0.9 < slope(TOLERANCES, [e[group] for e in errors]) < 1.1, group
        assert all(e[group] < 2 * tol for e, tol in zip(errors, TOLERANCES, strict=True)), group


def test_it_does_so_with_any_damping():
    for rho_inf in [0.0, 0.5, 1.0]:
        method, scene = GeneralizedAlphaAdaptive(rho_inf=rho_inf), Pendulum()
        tols = TOLERANCES[:4]
        errors = [errors_of(run_of(method, scene, tol), scene) for tol in tols]
        for group in errors[0]:
            assert 0.85 < slope(tols, [e[group] for e in errors]) < 1.15, group


def local_errors(method, scene, ratios, h):
    """Estimated and true errors of each of some steps: the truth starts from the same q, v, x."""
    program, numbers = method.program(scene)
    start = consistent_start(scene)
    rate = jax.jit(partial(ode_rate, scene))
    step = jax.jit(lambda state, t, h: program.step(scene, numbers, state, t, h)[0])
    t, state, pairs = scene.interval[0], program.begin(scene, numbers, start, jnp.asarray(h)), []
    for ratio in ratios:
        h *= ratio
        new = step(state, t + h, h)
        estimated = program.method(numbers).estimate(state.state, new.state, h)
        old, now = program.read(scene, state), program.read(scene, new)
        s0 = np.concatenate([old.q, old.v, old.x])
        exact = solve_ivp(rate, (t, t + h), s0, method="DOP853", rtol=3e-14, atol=1e-15).y[:, -1]
        true = np.concatenate([now.q, now.v, now.x]) - exact
        pairs.append((np.concatenate([estimated.q, estimated.v, estimated.x]), true))
        state, t = new, t + h
    return pairs


RATIOS = [1.0, 1.0, 1.3, 0.8, 1.6, 0.4, 1.0, 0.7, 1.2]  # 0.4 restarts gamma and theta


@pytest.mark.parametrize("scene", [Duffing(), *long(SpringMass())], ids=lambda s: s.name)
@pytest.mark.parametrize(
    ("gamma", "rho_inf"),
    [("guarded", 0.8), *long(("fixed", 0.8), ("guarded", 0.2), ("updated", 0.8))],
)
def test_the_estimates_are_the_local_errors(scene, gamma, rho_inf):
    method = GeneralizedAlphaAdaptive(rho_inf=rho_inf, gamma=gamma)
    for estimated, true in local_errors(method, scene, RATIOS, h=0.001):
        assert np.abs(estimated - true).max() < 0.1 * np.abs(true).max()


@pytest.mark.long
def test_a_wrong_estimate_would_be_seen(monkeypatch):
    right = generalized_alpha_adaptive.bend_after
    monkeypatch.setattr(generalized_alpha_adaptive, "bend_after", lambda *args: -right(*args))
    pairs = local_errors(GeneralizedAlphaAdaptive(), Duffing(), RATIOS, h=0.001)
    assert any(np.abs(e - t).max() > 0.1 * np.abs(t).max() for e, t in pairs)


def steps_of_fixed(scene, t_end, wanted):
    """Equal steps with which no group is worse than wanted, found by doubling then halving."""
    method = GeneralizedAlpha(rho_inf=0.5, formulation="stabilised_index2", start="corrected")

    def good(n):
        h = (t_end - scene.interval[0]) / n
        run = method.prepare(scene, t_end, Steps(h)).measure()
        errors = errors_of(run, scene) if run.status == "ok" else {}
        return bool(errors) and all(errors[g] <= wanted[g] for g in wanted)

    high = 64
    while not good(high):
        high *= 2
    low = high // 2
    while high - low > high // 50:
        middle = (low + high) // 2
        low, high = (low, middle) if good(middle) else (middle, high)
    return high


@pytest.mark.long
@pytest.mark.parametrize(("scene", "factor"), [(SWING, 1.4), (SoftImpact(), 15.0)])
def test_it_needs_fewer_steps_than_equal_ones_at_equal_error(scene, factor):
    run = run_of(GeneralizedAlphaAdaptive(), scene, 1e-5)
    tries = run.work.steps + run.work.rejected
    assert steps_of_fixed(scene, run.t[-1], errors_of(run, scene)) > factor * tries


def test_steps_shrink_in_the_impact_and_keep_gamma_in_its_proven_interval():
    method = GeneralizedAlphaAdaptive(rho_inf=0.8)
    run = run_of(method, SoftImpact(), 1e-3)
    h, gamma = run.notes["h"], run.notes["gamma"]
    assert len(run.t) == run.work.steps + 1  # every step is kept in a short run
    np.testing.assert_allclose(np.diff(run.t), h[1:], rtol=1e-9)
    assert h[1:].max() > 1000 * h[1:].min()
    s = method.scheme()
    assert (gamma[1:] >= (1 - s.alpha_m) / (2 * (1 - s.alpha_f)) - 1e-12).all()
    assert (gamma[1:] < 1 - s.alpha_m).all()
    assert np.ptp(gamma[1:]) > 0.01


def test_accepted_steps_keep_to_the_guarded_ratios():
    method = GeneralizedAlphaAdaptive(rho_inf=0.8)
    run = run_of(method, Pendulum(), 1e-3)
    assert run.work.rejected <= 2
    ratios = run.notes["h"][2:] / run.notes["h"][1:-1]
    program, numbers = method.program(Pendulum())
    lowest, highest = program.method(numbers).ratios()
    assert lowest == pytest.approx(1 / highest)  # what is safe up is safe down
    assert highest == pytest.approx(1.15)
    # a rejected step, and the last ones that meet the end, may be cut sharper
    assert (ratios[:-2] < lowest - 1e-9).sum() <= run.work.rejected
    assert ratios.max() <= highest + 1e-9
    assert GeneralizedAlphaAdaptive(rho_inf=0.3).numbers().growth == 2.0


@pytest.mark.long
def test_rows_do_not_grow_with_the_number_of_steps():
    scene, end = Pendulum(), 10.35
    run = GeneralizedAlphaAdaptive().prepare(scene, end, Tolerances(1e-7)).measure()
    assert run.work.steps > 20_000
    assert run.t[[0, -1]].tolist() == [0.35, end]
    assert (np.diff(run.t) > 0).all()
    # The first step after each of a quarter of as many equally spaced times, and no other.
    passed = (run.t[FIRST_ROWS + 1 :] - 0.35) / (end - 0.35)
    reached = np.floor(passed * (MOST_ROWS // 4) + 1e-6)
    np.testing.assert_array_equal(reached, np.arange(reached[0], MOST_ROWS // 4 + 1))
    assert len(reached) > MOST_ROWS // 4 - FIRST_ROWS
    np.testing.assert_allclose(np.diff(run.t[:FIRST_ROWS]), run.notes["h"][1:FIRST_ROWS])
    assert np.abs(run.q - scene.exact(run.t)["q"]).max() < 1e-5


def test_counts_add_up():
    run = run_of(GeneralizedAlphaAdaptive(), SoftImpact(), 1e-4)
    work = run.work
    assert work.rejected > 0
    assert work.newton >= work.steps + work.rejected
    assert work.residuals == work.jacobians == work.factorisations == work.newton
    modified = run_of(GeneralizedAlphaAdaptive(newton="modified"), SoftImpact(), 1e-4).work
    assert modified.jacobians < modified.newton == modified.residuals


@dataclass(frozen=True)
class Trouble(MechatronicSystem):
    """A free mass whose force goes wrong in the chosen way."""

    interval = (0.0, 2.0)
    nan_after: float = parameter(1e9, "s", "time after which the force is not a number")
    growth: float = parameter(0.0, "1/(m^2 s^2)", "cubic push that blows up in finite time")
    kick: float = parameter(0.0, "N", "size of a force that jumps to and fro ever faster")

    def mass(self, q):
        return jnp.eye(1)

    def force(self, q, v, t):
        jump = self.kick * jnp.sign(jnp.sin(1.0 / jnp.abs(1.0 - t + 1e-300)))
        force = self.growth * q**3 + jnp.where(self.kick > 0, jump, 0.0)
        return jnp.where(t > self.nan_after, jnp.nan, force)

    def initial_state(self):
        return State(q=np.ones(1), v=np.ones(1))


def test_trouble_is_a_status_with_a_time_and_a_cure():
    for trouble, options, status, words in [
        (
            {"growth": 0.5},
            {"max_steps": 20},
            "budget_exceeded",
            "20 steps were used up; raise max_steps",
        ),
        ({"nan_after": 1.0}, {}, "diverged", "Ended at t=1 s of 2 s: the equations are not finite"),
        ({"growth": 2.0}, {}, "diverged", "grew beyond all bounds"),
        ({"growth": 2.0}, {"max_steps": 3000}, "budget_exceeded", "a larger rtol or step"),
    ]:
        scene, rtol = Trouble(**trouble), 1e-12 if options.get("max_steps") == 3000 else 1e-4
        run = GeneralizedAlphaAdaptive(**options).prepare(scene, 2.0, Tolerances(rtol)).measure()
        assert (run.status, words in run.message) == (status, True), run.message
        assert np.isfinite(run.q).all()
        assert len(run.t) > 5


def test_a_test_that_cannot_be_passed_ends_as_step_too_small():
    # The estimate is made to fail at any step size from t = 1 on.
    class Hopeless(AdaptiveAlphaStep):
        def estimate(self, before, after, h):
            errors = super().estimate(before, after, h)
            return errors._replace(q=jnp.where(after.alpha.q > 2.0, 1e6, errors.q))

    class Planted(GeneralizedAlphaAdaptive):
        def functions(self):
            return Hopeless(super().functions().step_of)

    run = Planted().prepare(Trouble(), 2.0, Tolerances(1e-4)).measure()
    assert run.status == "step_too_small", run.message
    assert "Ended at t=1 s" in run.message


def test_new_tolerances_and_schemes_compile_nothing():
    scene = Pendulum()
    first = GeneralizedAlphaAdaptive().prepare(scene, 3.0, Tolerances(1e-3))
    assert first.measure().status == "ok"
    with nothing_compiled():
        for rho_inf, rtol, t_end in ((0.3, 1e-5, 3.0), (0.9, 1e-4, 2.0)):
            run = GeneralizedAlphaAdaptive(rho_inf=rho_inf).prepare(scene, t_end, Tolerances(rtol))
            assert run.kernel is first.kernel
            run.measure()


def test_an_old_tangent_from_within_a_wall_is_not_believed():
    for rtol in [0.05, 1e-2, 1e-4]:
        # A step far into the wall meets forces of e^300, and comes back to where they are none:
        # there such a tangent makes as good as nothing of the residual, and no solution.
        scene = SoftImpact(d=1e-4)
        full, modified = (
            run_of(GeneralizedAlphaAdaptive(newton=newton), scene, rtol)
            for newton in ("full", "modified")
        )
        assert modified.work.steps == full.work.steps
        assert modified.work.factorisations < full.work.factorisations
        assert modified.q[-1] == pytest.approx(full.q[-1], rel=1e-6)


@pytest.mark.long
def test_what_is_not_a_number_is_left_at_once():
    class Broken(SoftImpact):
        def force(self, q, v, t):
            return jnp.where(t > 0.1, jnp.nan, super().force(q, v, t))

    run = GeneralizedAlpha(newton="modified").prepare(Broken(), 1.0, Steps(0.01)).measure()
    assert run.status in ("diverged", "newton_failed")
    assert run.work.newton <= 3 * (run.work.steps + 1)  # the step that failed does not count
