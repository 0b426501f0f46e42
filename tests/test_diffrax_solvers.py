"""The diffrax methods: accuracy, counts that agree with hand reasoning, ways to end."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers import Probe, errors_at, long, nothing_compiled, slope, toy, worst

from integrators import Steps, Tolerances
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
from problems import State, jnp
from problems.scenes.oscillators import SpringMass
from problems.scenes.pendulums import Pendulum
from problems.scenes.rolling import ChaplyginSleigh

IMPLICIT = (ImplicitEuler, Kvaerno3, Kvaerno4, Kvaerno5, KenCarp3, KenCarp4, KenCarp5)
#: q'' = 6 q^2 with q = 1/(1-t)^2.
POLE = Probe(k=0.0, c=6.0, v0=2.0)


@dataclass(frozen=True)
class Dopri5(DiffraxSolver):
    """An explicit method, whose evaluations can be counted on the fingers."""

    library_class = "Dopri5"


#: One number of most steps, as each is compiled for itself.
EXPLICIT = Dopri5(max_steps=60)


#: A probe whose force stays while the rate of a state beside it ceases to exist.
Filtered = toy(
    "Filtered", base=Probe, force=lambda self, q, v, t: -self.k * q,
    state_rate=lambda self, z: jnp.where(z.t > self.breaks_at, jnp.nan, -z.x),
    initial_state=lambda self: State(np.ones(1), np.zeros(1), np.ones(1)),
)  # fmt: skip


def run(method, scene, rtol, t_end=0.0):
    return method.prepare(scene, t_end or scene.interval[1], Tolerances(rtol)).measure()


def at_constant_steps(method, scene, h, pattern=(1.0,)):
    resolution = Steps(h, pattern)
    return method.at_constant_steps().prepare(scene, scene.interval[1], resolution).measure()


# ---- accuracy --------------------------------------------------------------------------


# ---- constant steps --------------------------------------------------------------------
# Small enough to be asymptotic, large enough to stay above round-off. The gentler start keeps
# the actuator out of its saturation, whose bend asks for very small steps.
COARSEST = {1: 0.03, 3: 0.15, 4: 0.15, 5: 0.15, 8: 0.14}
CONTROLLED, HELD = (SpringMass(q0=2.0), 5.0), (Pendulum(), 1.35)
MORE = [(cls, *end) for cls in (*IMPLICIT, Dopri8) for end in (CONTROLLED, HELD)]
MORE.remove((Kvaerno3, *HELD))


@pytest.mark.parametrize(("cls", "scene", "t_end"), [(Kvaerno3, *HELD), *long(*MORE)])
def test_the_claimed_order_shows_in_every_group_at_constant_steps(cls, scene, t_end):
    method = cls().at_constant_steps()
    ratio = 2**0.5 if method.orders["q"] == 8 else 2
    length = t_end - scene.interval[0]
    # The pendulum swings three times as fast.
    coarsest = COARSEST[method.orders["q"]] / (3 if scene.sizes.nl else 1)
    steps = [length / round(length / coarsest * ratio**k) for k in range(3)]
    errors = [errors_at(method, scene, t_end, h) for h in steps]
    assert set(errors[0]) == set(method.orders) - ({"x", "y"} if scene.sizes.nl else {"lam"})
    for group in errors[0]:
        order = slope(steps, [np.sqrt(np.mean(e[group] ** 2)) for e in errors])
        assert order == pytest.approx(method.claims(scene)[group], abs=0.2), group


@pytest.mark.parametrize("cls", [Kvaerno3, *long(KenCarp3)])
def test_patterns_of_steps_are_hit_exactly_keep_the_order_and_compile_nothing_new(cls):
    pattern, scene = (0.5, 0.2, 0.3), Pendulum()
    t = at_constant_steps(cls(), scene, 0.02, pattern).t
    m, j = np.divmod(np.arange(16), 3)
    assert t[1:17].tolist() == (0.35 + 1.0 * ((m + np.array([0.5, 0.7, 1.0])[j]) / 50)).tolist()
    assert t[-1] == 1.35
    steps, method = [0.04, 0.02, 0.01], cls().at_constant_steps()
    errors = [errors_at(method, scene, 1.35, h, pattern) for h in steps]
    assert slope(steps, [e["lam"].max() for e in errors]) == pytest.approx(3, abs=0.2)
    with nothing_compiled():
        other = method.prepare(replace(scene, length=1.5), 1.35, Steps(0.02, (0.3, 0.7)))
        assert other.measure().status == "ok"


def test_the_counted_run_takes_the_timed_steps_and_more_of_them_than_max_steps():
    method = replace(Dopri8(max_steps=1), steps="constant")
    prepared = method.prepare(SpringMass(), 5.0, Steps(0.1))
    found, ((rows, _), counts) = prepared.measure(), run_counted(prepared.execute)
    assert counts == (0, 0)  # what is timed counts nothing
    assert (found.status, found.work.steps) == ("ok", 50)
    assert found.q[-1] == pytest.approx(np.asarray(rows)[0, 2], abs=1e-14)
    alone = np.tanh(found.y[:, 0])
    assert found.a[:, 0] == pytest.approx(alone - found.q[:, 0], abs=1e-9)


@pytest.mark.long
def test_a_stiff_equilibrium_whose_rates_are_known_to_few_digits_does_not_stop_newtons_method():
    # The spring force is a difference of terms of 1e10 and rounds to 1e-6.
    found = at_constant_steps(Kvaerno3(), Probe(k=-1e10, c=-1e10, v0=1e-3), 0.05)
    assert found.status == "ok", found.message
    assert np.abs(found.q[-1] - 1) < 1e-8


@pytest.mark.long
def test_constant_steps_take_what_adaptive_ones_take():
    """Kinematics and constraints of velocities, too."""
    scene, method = ChaplyginSleigh(), Dopri8(steps="constant")
    coarse, fine = (errors_at(method, scene, scene.interval[1], h)["q"].max() for h in (1.0, 0.5))
    assert 2**7.5 * fine < coarse < 1e-3


# ---- work ------------------------------------------------------------------------------
# diffrax's first step is 0.01 s; at these tolerances it is not rejected, so that the first
# stage of a method that hands its last stage to the next step is evaluated once in a run.
def test_evaluations_are_those_of_the_stages():
    work = run(EXPLICIT, Probe(), 1e-6).work
    assert work.residuals == 6 * (work.steps + work.rejected) + 1
    assert work.jacobians == 0
    # Newton on a linear system: one iteration solves a stage, a second confirms it; six stages
    # are implicit, and the explicit one is treated likewise at the start.
    work = run(Kvaerno5(), Probe(), 1e-6).work
    each = 2 * (6 * (work.steps + work.rejected) + 1)
    assert work.jacobians == work.factorisations == work.newton == work.solves == each
    assert work.residuals == each


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
    euler = at_constant_steps(ImplicitEuler(), Probe(), 0.1).work
    assert (euler.steps, euler.rejected, euler.newton) == (20, 0, 2 * 20)
    assert euler.jacobians == euler.factorisations == euler.solves == euler.newton
    assert euler.residuals == 20 + 2 * 20
    for steps in (20, 3000):  # however many passes the rows of a long run take
        explicit = at_constant_steps(Dopri8(max_steps=1), SpringMass(), 20.0 / steps).work
        assert (explicit.steps, explicit.residuals) == (steps, 13 * steps + 1)
        assert explicit.jacobians == explicit.newton == explicit.solves == 0


def test_runs_repeat_to_the_bit_take_the_timed_steps_and_other_parameters_compile_nothing_new():
    prepared = Kvaerno5().prepare(Probe(), 2.0, Tolerances(1e-8))
    first, second = prepared.measure(), prepared.measure()
    assert first.work == second.work
    for name in ("t", "q", "v", "a"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()
    t, s, steps, _ = prepared.execute()
    assert [first.work.steps, first.work.rejected] == [int(n) for n in steps]
    assert float(t[-1]) == 2.0
    assert first.q[-1] == pytest.approx(np.asarray(s)[-1, :1], abs=1e-12)
    scene = Probe(k=9.0)
    with nothing_compiled():
        other = run(Kvaerno5(), scene, 1e-9, 0.8)
    assert other.t[-1] == 0.8
    assert worst(other, scene, "q") < 1e-7


# ---- ways to end -----------------------------------------------------------------------
def test_a_budget_of_steps_ends_the_run_and_keeps_its_rows():
    found = run(EXPLICIT, Probe(), 1e-11)
    assert found.status == "budget_exceeded"
    assert "raise max_steps" in found.message
    assert found.work.steps + found.work.rejected == EXPLICIT.max_steps
    assert len(found.t) == found.work.steps + 1
    assert worst(found, Probe(), "q") < 1e-7
    assert f"t={found.t[-1]:.6g} s" in found.message


def test_trouble_is_a_status_with_its_time():
    found = run(Kvaerno5(), Probe(breaks_at=0.5), 1e-6)
    assert (found.status, found.t[-1]) == ("diverged", pytest.approx(0.5, abs=1e-6))
    assert "t=0.5 s of 2 s" in found.message
    assert np.isfinite(found.a).all()
    found = run(Kvaerno5(), POLE, 1e-6)
    assert found.status in ("step_too_small", "newton_failed", "diverged")
    assert found.t[-1] == pytest.approx(1.0, abs=1e-3)
    # Near the pole the quadratic equation of a constant step has no real root.
    found = at_constant_steps(ImplicitEuler(), POLE, 0.125)
    assert (found.status, found.work.steps) == ("newton_failed", 2)
    assert "Ended at t=0.375 s" in found.message
    assert found.t.tolist() == [0.0, 0.125, 0.25]


@pytest.mark.parametrize(
    ("cls", "scene"),
    [(ImplicitEuler, Probe), *long((Dopri8, Probe), (Kvaerno3, Probe), (Dopri8, Filtered))],
)
def test_a_rate_that_becomes_nan_at_constant_steps_ends_the_run_as_diverged(cls, scene):
    found = at_constant_steps(cls(), scene(breaks_at=0.5), 0.1)
    assert (found.status, found.t[-1]) == ("diverged", 0.5)
    assert "Ended at t=0.6 s" in found.message
    assert np.isfinite(found.a).all()
