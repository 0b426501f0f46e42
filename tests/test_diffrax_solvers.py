"""The diffrax methods: accuracy, counts that agree with hand reasoning, ways to end."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers import errors_at, long, nothing_compiled, slope
from probe import Probe, worst

from integrators import Steps, Tolerances, Trajectory
from integrators.adapters.counting import run_counted
from integrators.adapters.diffrax_methods import (
    DiffraxSolver,
    Dopri8,
    ImplicitEuler,
    KenCarp3,
    KenCarp4,
    KenCarp5,
    Kvaerno3,
    Kvaerno4,
    Kvaerno5,
)
from problems import MechatronicSystem, jnp
from problems.scenes.chaplygin_sleigh import ChaplyginSleigh
from problems.scenes.pendulum import Pendulum
from problems.scenes.spring_mass import SpringMass

IMPLICIT = (ImplicitEuler, Kvaerno3, Kvaerno4, Kvaerno5, KenCarp3, KenCarp4, KenCarp5)


@dataclass(frozen=True)
class Dopri5(DiffraxSolver):
    """An explicit method, whose evaluations can be counted on the fingers."""

    library_class = "Dopri5"


#: One number of most steps, as each is compiled for itself.
EXPLICIT = Dopri5(max_steps=60)


@dataclass(frozen=True)
class Filtered(Probe):
    """A probe whose force stays while the rate of a state beside it ceases to exist."""

    def force(self, q, v, t):
        return -self.k * q

    def state_rate(self, z):
        return jnp.where(z.t > self.breaks_at, jnp.nan, -z.x)

    def initial_state(self):
        return super().initial_state()._replace(x=np.ones(1))


def run(
    method: DiffraxSolver, scene: MechatronicSystem, rtol: float, t_end: float = 0.0
) -> Trajectory:
    return method.prepare(scene, t_end or scene.interval[1], Tolerances(rtol)).measure()


def at_constant_steps(
    method: DiffraxSolver, scene: MechatronicSystem, h: float, pattern: tuple[float, ...] = (1.0,)
) -> Trajectory:
    resolution = Steps(h, pattern)
    return method.at_constant_steps().prepare(scene, scene.interval[1], resolution).measure()


# ---- accuracy --------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("method", "scene"),
    long((Kvaerno5(), SpringMass()), (Kvaerno5(), Pendulum()), (KenCarp4(), Pendulum())),
    ids=lambda p: p.spec,
)
def test_errors_fall_with_the_tolerance_to_eight_digits_in_every_group(method, scene):
    assert method.supports(scene) is None
    t_end = 5.0 if scene.name == "spring_mass" else 1.35
    loose, tight = (run(method, scene, rtol, t_end) for rtol in (1e-7, 1e-11))
    assert loose.status == tight.status == "ok", tight.message
    assert tight.t[[0, -1]].tolist() == [scene.interval[0], t_end]
    for group in ("q", "v", "a", "lam" if scene.sizes.nl else "x"):
        assert worst(tight, scene, group) < 1e-8
        assert worst(tight, scene, group) < worst(loose, scene, group) / 100


@pytest.mark.long
@pytest.mark.parametrize("cls", [Dopri8, *long(ImplicitEuler, Kvaerno3, KenCarp3)])
def test_the_error_falls_with_the_tolerance(cls):
    rtols = (1e-3, 1e-5) if cls is ImplicitEuler else (1e-5, 1e-9)
    loose, tight = (run(cls(), Pendulum(), rtol) for rtol in rtols)
    assert loose.status == tight.status == "ok", tight.message
    assert worst(tight, Pendulum(), "q") < worst(loose, Pendulum(), "q") / 8
    assert worst(loose, Pendulum(), "q") < 0.1


# ---- constant steps --------------------------------------------------------------------
# Small enough to be asymptotic, large enough to stay above round-off. The gentler start keeps
# the actuator out of its saturation, whose bend asks for very small steps.
COARSEST = {1: 0.03, 3: 0.15, 4: 0.15, 5: 0.15, 8: 0.14}
CONTROLLED, HELD = (SpringMass(q0=2.0), 5.0), (Pendulum(), 1.35)
#: One implicit method in the short tests; others have counts and endings there.
PAIRS = [(Kvaerno3, *HELD)]
MORE = [
    pair
    for cls in (*IMPLICIT, Dopri8)
    for end in (CONTROLLED, HELD)
    if (pair := (cls, *end)) not in PAIRS
]


@pytest.mark.parametrize(
    ("cls", "scene", "t_end"),
    [*PAIRS, *long(*MORE)],
    ids=lambda part: getattr(part, "name", None),
)
def test_the_claimed_order_shows_in_every_group_at_constant_steps(cls, scene, t_end):
    method = cls().at_constant_steps()
    ratio = 2**0.5 if method.orders["q"] == 8 else 2
    length = t_end - scene.interval[0]
    # The pendulum swings three times as fast.
    coarsest = COARSEST[method.orders["q"]] / (3 if scene.sizes.nl else 1)
    counts = [round(length / coarsest * ratio**k) for k in range(3)]
    steps = [length / count for count in counts]
    errors = [errors_at(method, scene, t_end, h) for h in steps]
    assert set(errors[0]) == set(method.orders) - ({"x", "y"} if scene.sizes.nl else {"lam"})
    for group in errors[0]:
        order = slope(steps, [np.sqrt(np.mean(e[group] ** 2)) for e in errors])
        assert order == pytest.approx(method.claims(scene)[group], abs=0.2), group


@pytest.mark.parametrize("cls", [Kvaerno3, *long(KenCarp3)])
def test_a_pattern_of_steps_is_hit_exactly_and_keeps_the_order(cls):
    pattern, scene = (0.5, 0.2, 0.3), Pendulum()
    t = at_constant_steps(cls(), scene, 0.02, pattern).t
    m, j = np.divmod(np.arange(16), 3)
    assert t[1:17].tolist() == (0.35 + 1.0 * ((m + np.array([0.5, 0.7, 1.0])[j]) / 50)).tolist()
    assert t[-1] == 1.35
    steps = [0.04, 0.02, 0.01]
    errors = [errors_at(cls().at_constant_steps(), scene, 1.35, h, pattern) for h in steps]
    assert slope(steps, [e["lam"].max() for e in errors]) == pytest.approx(3, abs=0.2)


def test_other_steps_patterns_and_parameters_compile_nothing_new():
    method, scene = Kvaerno3().at_constant_steps(), Pendulum()
    assert method.prepare(scene, 1.35, Steps(0.1)).measure().status == "ok"
    with nothing_compiled():
        other = method.prepare(replace(scene, length=1.5), 1.35, Steps(0.02, (0.3, 0.7)))
        assert other.measure().status == "ok"


def test_the_counted_run_takes_the_timed_steps_and_more_of_them_than_max_steps():
    method = replace(Dopri8(max_steps=1), steps="constant")
    prepared = method.prepare(SpringMass(), 5.0, Steps(0.1))
    trajectory, ((rows, _), counts) = prepared.measure(), run_counted(prepared.execute)
    assert counts == (0, 0)  # what is timed counts nothing
    assert (trajectory.status, trajectory.work.steps) == ("ok", 50)
    assert trajectory.q[-1] == pytest.approx(np.asarray(rows)[0, 2], abs=1e-14)
    alone = np.tanh(trajectory.y[:, 0])
    assert trajectory.a[:, 0] == pytest.approx(alone - trajectory.q[:, 0], abs=1e-9)


@pytest.mark.long
def test_a_stiff_equilibrium_whose_rates_are_known_to_few_digits_does_not_stop_newtons_method():
    # The spring force is a difference of terms of 1e10 and rounds to 1e-6.
    trajectory = at_constant_steps(Kvaerno3(), Probe(k=-1e10, c=-1e10, v0=1e-3), 0.05)
    assert trajectory.status == "ok", trajectory.message
    assert np.abs(trajectory.q[-1] - 1) < 1e-8


def test_constant_steps_are_refined_by_steps_and_adaptive_ones_by_tolerances():
    assert Kvaerno5().controls == Dopri8().controls == "tolerance"
    assert Kvaerno5(steps="constant").controls == "step"
    assert Dopri8(max_steps=9).at_constant_steps() == Dopri8(max_steps=9, steps="constant")


def test_another_end_and_other_parameters_are_taken_without_compiling_again():
    method = Kvaerno5()
    run(method, Probe(), 1e-6)
    scene = Probe(k=9.0)
    with nothing_compiled():
        trajectory = run(method, scene, 1e-9, 0.8)
    assert trajectory.t[-1] == 0.8
    assert worst(trajectory, scene, "q") < 1e-7


# ---- work ------------------------------------------------------------------------------
# diffrax's first step is 0.01 s; at these tolerances it is not rejected, so that the first
# stage of a method that hands its last stage to the next step is evaluated once in a run.
def test_an_explicit_method_takes_six_evaluations_a_step_and_one_more_at_the_start():
    work = run(EXPLICIT, Probe(), 1e-6).work
    assert work.residuals == 6 * (work.steps + work.rejected) + 1
    assert work.jacobians == 0


def test_newton_on_a_linear_system_takes_two_linearisations_in_each_implicit_stage():
    # One iteration solves a linear stage, a second confirms it; six stages are implicit, and
    # the explicit one is treated likewise at the start.
    work = run(Kvaerno5(), Probe(), 1e-6).work
    linearisations = 2 * (6 * (work.steps + work.rejected) + 1)
    assert work.jacobians == work.factorisations == work.newton == work.solves == linearisations
    assert work.residuals == linearisations


@pytest.mark.long
def test_an_implicit_explicit_method_starts_every_step_anew():
    # No stage is handed on: one evaluation gives the explicit stage, one iteration confirms it,
    # and five stages are implicit.
    work = run(KenCarp4(), Probe(), 1e-6).work
    attempts = work.steps + work.rejected
    assert work.jacobians == (1 + 2 * 5) * attempts
    assert work.residuals == work.jacobians + attempts


def test_at_constant_steps_the_stages_are_counted_to_the_last():
    # Newton's method solves a linear stage and confirms it; implicit Euler evaluates its
    # predictor besides, and the last of Dopri8's stages is the first of the next step.
    euler, explicit = (
        at_constant_steps(cls(), Probe(), 0.1).work for cls in (ImplicitEuler, Dopri8)
    )
    assert (euler.steps, euler.rejected, euler.newton) == (20, 0, 2 * 20)
    assert euler.jacobians == euler.factorisations == euler.solves == euler.newton
    assert euler.residuals == 20 + 2 * 20
    assert (explicit.steps, explicit.residuals) == (20, 13 * 20 + 1)
    assert explicit.jacobians == explicit.newton == explicit.solves == 0
    # However many passes the rows of a long run take.
    assert at_constant_steps(Dopri8(), Probe(), 2 / 3000).work.residuals == 13 * 3000 + 1


def test_the_counted_run_is_the_timed_run():
    prepared = Kvaerno5().prepare(Probe(), 2.0, Tolerances(1e-8))
    trajectory = prepared.measure()
    t, s, steps, _ = prepared.execute()
    assert [trajectory.work.steps, trajectory.work.rejected] == [int(n) for n in steps]
    assert float(t[-1]) == 2.0
    assert trajectory.q[-1] == pytest.approx(np.asarray(s)[-1, :1], abs=1e-12)


def test_runs_are_equal_to_the_bit():
    prepared = Kvaerno5().prepare(Probe(), 2.0, Tolerances(1e-7))
    first, second = prepared.measure(), prepared.measure()
    assert first.work == second.work
    for name in ("t", "q", "v", "a"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


# ---- ways to end -----------------------------------------------------------------------
def test_a_budget_of_steps_ends_the_run_and_keeps_its_rows():
    trajectory = run(EXPLICIT, Probe(), 1e-11)
    assert trajectory.status == "budget_exceeded"
    assert "raise max_steps" in trajectory.message
    assert trajectory.work.steps + trajectory.work.rejected == EXPLICIT.max_steps
    assert len(trajectory.t) == trajectory.work.steps + 1
    assert worst(trajectory, Probe(), "q") < 1e-7
    assert f"t={trajectory.t[-1]:.6g} s" in trajectory.message


def test_a_force_that_becomes_nan_ends_the_run_as_diverged_and_names_the_time():
    trajectory = run(Kvaerno5(), Probe(breaks_at=0.5), 1e-6)
    assert trajectory.status == "diverged"
    assert trajectory.t[-1] == pytest.approx(0.5, abs=1e-6)
    assert "t=0.5 s of 2 s" in trajectory.message
    assert np.isfinite(trajectory.a).all()


def test_a_pole_of_the_solution_ends_the_run_near_it():
    # q'' = 6 q^2 with q = 1/(1-t)^2.
    trajectory = run(Kvaerno5(), Probe(k=0.0, c=6.0, v0=2.0), 1e-6)
    assert trajectory.status in ("step_too_small", "newton_failed", "diverged")
    assert trajectory.t[-1] == pytest.approx(1.0, abs=1e-3)


def test_a_root_finder_that_fails_at_a_constant_step_ends_the_run_there():
    # Near the pole of q'' = 6 q^2 the quadratic equation of a step has no real root.
    trajectory = at_constant_steps(ImplicitEuler(), Probe(k=0.0, c=6.0, v0=2.0), 0.125)
    assert trajectory.status == "newton_failed"
    assert "in the step to t=0.375 s; take a smaller step" in trajectory.message
    assert trajectory.t.tolist() == [0.0, 0.125, 0.25]
    assert trajectory.work.steps == 2  # accepted ones


@pytest.mark.parametrize(
    ("cls", "scene"), [(Dopri8, Probe), *long((Kvaerno3, Probe), (Dopri8, Filtered))]
)
def test_a_rate_that_becomes_nan_at_constant_steps_ends_the_run_as_diverged(cls, scene):
    trajectory = at_constant_steps(cls(), scene(breaks_at=0.5), 0.1)
    assert trajectory.status == "diverged"
    assert "in the step to t=0.6 s" in trajectory.message
    assert trajectory.t[-1] == 0.5
    assert np.isfinite(trajectory.a).all()


@pytest.mark.long
def test_implicit_euler_ends_where_newton_fails_instead_of_taking_a_smaller_step():
    trajectory = run(ImplicitEuler(), Probe(k=0.0, c=6.0, v0=2.0), 1e-3)
    assert trajectory.status in ("newton_failed", "step_too_small", "diverged")
    assert 0.5 < trajectory.t[-1] < 1.5
    assert f"t={trajectory.t[-1]:.6g} s" in trajectory.message


# ---- options ---------------------------------------------------------------------------
def test_printed_names_hold_what_was_changed():
    assert Dopri8(steps="constant").spec == "dopri8[steps=constant]"
    assert KenCarp4(max_steps=9).spec == "kencarp4[max_steps=9]"
    assert Kvaerno5().spec == "kvaerno5"


def test_constant_steps_take_what_adaptive_ones_take():
    """Kinematics and constraints of velocities, too."""
    scene, method = ChaplyginSleigh(), Dopri8(steps="constant")
    found = (errors_at(method, scene, scene.interval[1], h)["q"].max() for h in (1.0, 0.5))
    coarse, fine = found
    assert 2**7.5 * fine < coarse < 1e-3
