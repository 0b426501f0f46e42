"""The adaptive generalized-alpha method: tolerance, estimates, steps, statuses."""

from functools import partial

import numpy as np
import pytest
from helpers import Probe, long, nothing_compiled, run_of, slope, worst
from scipy.integrate import solve_ivp

from integrators import Tolerances
from integrators.methods.generalized_alpha_adaptive import (
    AdaptiveAlphaStep,
    GeneralizedAlphaAdaptive,
)
from problems import jax, jnp
from problems.equations.formulations import ode_rate
from problems.equations.initial_values import consistent_start
from problems.scenes.contacts import SoftImpact
from problems.scenes.oscillators import Duffing, SpringMass
from problems.scenes.pendulums import Pendulum

TOLERANCES = [1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8]
SWING = Pendulum(th0=3.1)  # released close to the upright position: slow, fast, slow again


def adaptive(scene, rtol, t_end=0.0, **options):
    return run_of(GeneralizedAlphaAdaptive(**options), scene, Tolerances(rtol), t_end)


# ---- errors ----------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("scene", "options", "tolerances"),
    [
        *((Pendulum(), of, TOLERANCES[:4]) for of in ({}, {"rho_inf": 0.0}, {"rho_inf": 1.0})),
        *long(*((s, {}, TOLERANCES) for s in (Pendulum(), Duffing(), SpringMass(), SWING))),
    ],
    ids=str,
)
def test_the_achieved_error_follows_the_tolerance_with_any_damping(scene, options, tolerances):
    t_end = 3.2 if scene is SWING else 0.0
    runs = [adaptive(scene, tol, t_end, **options) for tol in tolerances]
    for group in filter(scene.sizes.of, ("q", "v", "a", "lam", "x")):
        errors = [worst(run, scene, group) for run in runs]
        within = 0.15 if "rho_inf" in options else 0.1
        assert slope(tolerances, errors) == pytest.approx(1.0, abs=within), group
        assert all(e < 2 * tol for e, tol in zip(errors, tolerances, strict=True)), group


RATIOS = [1.0, 1.0, 1.3, 0.8, 1.6, 0.4, 1.0, 0.7, 1.2]  # 0.4 restarts gamma and theta


def off(method, scene, h=0.001):
    """Relative distances of estimated errors from those of the truth that starts with a step."""
    program, numbers = method.program(scene)
    rate = jax.jit(partial(ode_rate, scene))
    step = jax.jit(lambda state, t, h: program.step(scene, numbers, state, t, h)[0])
    begin = jax.jit(lambda start, h: program.begin(scene, numbers, start, h))
    estimate = jax.jit(program.method(numbers).estimate)
    t, state = scene.interval[0], begin(consistent_start(scene), h)
    for ratio in RATIOS:
        h *= ratio
        new = step(state, t + h, h)
        estimated = estimate(state.state, new.state, h)
        old, now = program.read(scene, state), program.read(scene, new)
        s0 = np.concatenate([old.q, old.v, old.x])
        exact = solve_ivp(rate, (t, t + h), s0, method="DOP853", rtol=3e-14, atol=1e-15).y[:, -1]
        true = np.concatenate([now.q, now.v, now.x]) - exact
        found = np.concatenate([estimated.q, estimated.v, estimated.x])
        yield np.abs(found - true).max() / np.abs(true).max()
        state, t = new, t + h


@pytest.mark.parametrize(
    ("scene", "options"),
    [
        (Duffing(), {}),
        *long(
            (SpringMass(), {}),
            *((Duffing(), of) for of in ({"gamma": "fixed"}, {"rho_inf": 0.2})),
            (SpringMass(), {"gamma": "updated"}),
        ),
    ],
)
def test_the_estimates_are_the_local_errors(scene, options):
    method = GeneralizedAlphaAdaptive(**{"rho_inf": 0.8, "gamma": "guarded"} | options)
    assert max(off(method, scene)) < 0.1


# ---- steps -----------------------------------------------------------------------------
def test_steps_shrink_in_the_impact_and_keep_gamma_in_its_proven_interval():
    method, run = GeneralizedAlphaAdaptive(rho_inf=0.8), adaptive(SoftImpact(), 1e-3, rho_inf=0.8)
    s = method.scheme()
    h, gamma = run.notes["h"], run.notes["gamma"]
    assert len(run.t) == run.work.steps + 1  # every step is kept in a short run
    np.testing.assert_allclose(np.diff(run.t), h[1:], rtol=1e-9)
    assert h[1:].max() > 1000 * h[1:].min()
    assert (gamma[1:] >= (1 - s.alpha_m) / (2 * (1 - s.alpha_f)) - 1e-12).all()
    assert (gamma[1:] < 1 - s.alpha_m).all()
    assert np.ptp(gamma[1:]) > 0.01


def test_accepted_steps_keep_to_the_guarded_ratios():
    method, run = GeneralizedAlphaAdaptive(rho_inf=0.8), adaptive(Pendulum(), 1e-3, rho_inf=0.8)
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


def test_counts_add_up():
    work = adaptive(SoftImpact(), 1e-4).work
    assert work.rejected > 0
    assert work.newton >= work.steps + work.rejected
    assert work.residuals == work.jacobians == work.factorisations == work.newton


def test_an_old_tangent_from_within_a_wall_is_not_believed():
    for rtol in [0.05, 1e-2, 1e-4]:
        # A step far into the wall meets forces of e^300, and comes back to where they are none:
        # there such a tangent makes as good as nothing of the residual, and no solution.
        scene = SoftImpact(d=1e-4)
        full, modified = (adaptive(scene, rtol, newton=kind) for kind in ("full", "modified"))
        assert modified.work.steps == full.work.steps
        assert modified.work.factorisations < full.work.factorisations
        assert modified.work.jacobians < modified.work.newton == modified.work.residuals
        assert modified.q[-1] == pytest.approx(full.q[-1], rel=1e-6)


def test_new_tolerances_and_schemes_compile_nothing():
    scene = Pendulum()
    first = GeneralizedAlphaAdaptive().prepare(scene, 3.0, Tolerances(1e-3))
    assert first.measure().status == "ok"
    with nothing_compiled():
        for rho_inf, rtol, t_end in ((0.3, 1e-5, 3.0), (0.9, 1e-4, 2.0)):
            run = GeneralizedAlphaAdaptive(rho_inf=rho_inf).prepare(scene, t_end, Tolerances(rtol))
            assert run.kernel is first.kernel
            run.measure()


# ---- ways to end -----------------------------------------------------------------------
def test_trouble_is_a_status_with_a_time_and_a_cure():
    for trouble, rtol, options, status, words in [
        ({"c": 0.3}, 1e-4, {"max_steps": 20}, "budget_exceeded",
         "the budget of 20 steps is exceeded; raise max_steps"),
        ({"breaks_at": 1.0}, 1e-4, {}, "diverged",
         "Ended at t=1 s of 2 s: the solution grew"),
        ({"c": 2.0}, 1e-4, {}, "diverged", "grew beyond all bounds"),
        ({"c": 2.0}, 1e-12, {"max_steps": 3000}, "budget_exceeded", "a larger rtol or step"),
    ]:  # fmt: skip
        method = GeneralizedAlphaAdaptive(**options)
        run = method.prepare(
            Probe(**{"k": 0.0, "v0": 1.0} | trouble), 2.0, Tolerances(rtol)
        ).measure()
        assert (run.status, words in run.message) == (status, True), run.message
        assert np.isfinite(run.q).all()
        assert len(run.t) > 5


def test_a_test_that_cannot_be_passed_ends_as_step_too_small():
    # The estimate is made to fail at any step size from t = 1 on.
    class Hopeless(AdaptiveAlphaStep):
        def estimate(self, before, after, h):
            errors = super().estimate(before, after, h)
            return errors._replace(q=jnp.where(after.shown.q > 2.0, 1e6, errors.q))

    class Planted(GeneralizedAlphaAdaptive):
        def functions(self):
            return Hopeless(super().functions().stabilised)

    run = run_of(Planted(), Probe(k=0.0, v0=1.0), Tolerances(1e-4), 2.0, "step_too_small")
    assert "Ended at t=1 s" in run.message
