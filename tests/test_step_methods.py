"""Methods that users write as step functions: options, solvers, time loops, and faults in words."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
import pytest
from helpers import long, run_of, toy

from bench.plugins.registry import Registry
from bench.plugins.skeletons import integrator as skeleton
from integrators import (
    ErrorControl,
    Errors,
    ImplicitStepMethod,
    Reading,
    StepMethod,
    Steps,
    Tolerances,
    option,
)
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems import State, jnp, parameter
from problems.base.spec import SpecError
from problems.equations.formulations import ode_rate
from problems.equations.initial_values import missing_rank
from problems.scenes.oscillators import Oscillator, SpringMass
from problems.scenes.pendulums import Pendulum
from problems.scenes.slider_crank import SliderCrank


@dataclass(frozen=True)
class Theta(ImplicitStepMethod):
    """The theta rule on [q, v, x], in one stage or by an explicit and an implicit part."""

    formulation: ClassVar = "ode"
    theta: float = option(0.5, "weight of the end", low=0.0, high=1.0)
    form: str = option("one", "one stage, or two", choices=("one", "two"))

    @cached_property
    def other(self):
        """The second weight, a derived value."""
        return 1 - self.theta

    def begin(self, scene, start, h):
        z = start.z
        return jnp.concatenate([z.q, z.v, z.x])

    def step(self, scene, state, t, h, work):
        explicit = state + h * self.other * ode_rate(scene, t - h, state)
        if self.form == "two":  # the same, by two solves
            middle = work.solve(lambda u: u - explicit, state)
            return work.solve(lambda u: u - middle - h * self.theta * ode_rate(scene, t, u), state)
        return work.solve(lambda u: u - explicit - h * self.theta * ode_rate(scene, t, u), state)

    def read(self, scene, state):
        q, v, x = jnp.split(state, [scene.sizes.nq, 2 * scene.sizes.nq])
        return Reading(q, v, 0 * q, jnp.zeros(scene.sizes.nl), x, 0 * x, jnp.zeros(scene.sizes.ny))


@dataclass(frozen=True)
class Careful(ErrorControl, Theta):
    """The trapezoidal rule with the difference to backward Euler as its error."""

    order: ClassVar = 1

    def estimate(self, before, after, h):
        q, v, x = jnp.split(h * (after - before) / 2, [1, 2])
        return Errors(q, v, x)


def end_of(method, scene=None, h=0.05, **steps):
    scene = scene or Oscillator()
    return run_of(method, scene, Steps(h, **steps), scene.interval[0] + 1.0)


# ---- values and programs ---------------------------------------------------------------
def at_one(self):
    assert self.stiffness == self.k  # asked for while it has plain numbers
    return State(q=np.ones(1), v=np.zeros(1))


#: A unit mass on a spring, q(0) = 1, which derives its stiffness and keeps it.
Spring = toy(
    "Spring", k=parameter(1.0, "N/m", "stiffness"), initial_state=at_one,
    stiffness=cached_property(lambda self: 1.0 * self.k),
    force=lambda self, q, v, t: -self.stiffness * q,
)  # fmt: skip


class Keeps:
    """A class that is no scene, whose derived value is made by JAX."""

    @cached_property
    def stiffness(self):
        return jnp.sqrt(self.k) ** 2  # pyright: ignore


@dataclass(frozen=True)
class TracedSpring(Keeps, Spring):
    def initial_state(self):
        return State(q=np.ones(1), v=np.zeros(1))


def test_the_theta_rule_gives_the_powers_of_its_matrix_with_the_numbers_of_each_run():
    h = 0.05
    for scene in (Spring, TracedSpring):
        for k, theta in ((8.0, 0.5), (5.0, 0.5), (5.0, 1.0)):
            method = Theta(theta=theta)
            assert method.other == 1 - theta  # asked for before the method is compiled
            run = end_of(method, scene(k=k), h)
            a = np.array([[0.0, 1.0], [-k, 0.0]])
            one = np.linalg.solve(np.eye(2) - h * theta * a, np.eye(2) + h * (1 - theta) * a)
            wanted = np.linalg.matrix_power(one, 20) @ [1.0, 0.0]
            assert [run.q[-1, 0], run.v[-1, 0]] == pytest.approx(wanted, rel=1e-10)


def test_what_a_scene_writes_down_when_it_is_made_is_refused():
    written = toy(base=Spring, __post_init__=lambda self: vars(self).update(half=self.k / 2))
    with pytest.raises(SpecError, match="keeps half beside its parameters"):
        Theta().prepare(written(k=8.0), 1.0, Steps(0.05))


def test_an_option_that_is_text_makes_another_program_and_a_float_does_not():
    methods = Theta(), Theta(theta=0.7), Theta(newton_tol=1e-9), Theta(form="two")
    programs = [method.program(Oscillator())[0] for method in methods]
    assert programs[0] == programs[1] == programs[2]
    assert programs[3] != programs[0]
    one, two = end_of(Theta(theta=0.7)), end_of(Theta(theta=0.7, form="two"))
    assert two.q[-1] == pytest.approx(one.q[-1], rel=1e-11)
    assert two.work.newton > one.work.newton


def test_modified_newton_and_sparse_tangents_need_no_line_of_the_method(plugins):
    modified, euler = {"newton": "modified"}, Registry([plugins]).integrator("euler_dae")
    for method, scene, options in [
        (Theta(form="two"), Oscillator(), modified),
        (euler, Pendulum(), modified | {"linear_solver": "sparse"}),
    ]:
        full, other = (end_of(m, scene, 0.02) for m in (method, replace(method, **options)))
        assert other.q == pytest.approx(full.q, abs=1e-9 * np.abs(full.q).max())
        assert other.work.jacobians < full.work.jacobians
    with pytest.raises(SpecError, match="linear_solver=dense"):  # its equations have a solve
        Theta(linear_solver="sparse").prepare(Oscillator(), 1.0, Steps(0.1))


# ---- time loops ------------------------------------------------------------------------
def test_a_method_with_an_estimate_follows_the_tolerance():
    scene, errors = Oscillator(), []
    for rtol in (1e-2, 1e-3):
        run = run_of(Careful(theta=1.0), scene, Tolerances(rtol), 1.0)
        errors.append(abs(run.q[-1, 0] - scene.exact(np.array([1.0]))["q"][0, 0]))
    assert errors[1] < 0.3 * errors[0]


def test_a_run_that_ends_with_its_last_allowed_step_is_complete():
    early = toy("Early", base=Oscillator, interval=(-0.3, 1.0))()
    # Across zero the last time and the last step do not sum to the end, by a rounding error.
    for t_end in np.linspace(0.001, 0.1, 300)[[1, 5, 9]]:
        run = Careful(theta=1.0).prepare(early, t_end, Tolerances(10.0)).measure()
        tries = run.work.steps + run.work.rejected
        just, fewer = (
            Careful(theta=1.0, max_steps=most).prepare(early, t_end, Tolerances(10.0)).measure()
            for most in (tries, tries - 1)
        )
        assert (just.status, just.t[-1]) == ("ok", t_end)
        assert fewer.status == "budget_exceeded"


def test_patterns_end_at_exact_times_whatever_the_rounding_of_their_fractions():
    for pattern in [(0.1,) * 10, (0.7, 0.1, 0.1, 0.1)]:
        assert np.cumsum(pattern)[-1] != 1.0
        found = GeneralizedAlpha().prepare(SpringMass(), 1.0, Steps(1 / 8, pattern)).measure()
        assert (found.status, found.t[-1]) == ("ok", 1.0)
        assert set(np.arange(1, 9) / 8) <= set(found.t.tolist())
        assert found.work.steps == 8 * len(pattern)
    run = end_of(Theta(), h=0.1, pattern=(0.3, 0.7))  # every method notes the steps that it took
    assert np.isnan(run.notes["h"][0])
    assert run.notes["h"][1:5] == pytest.approx([0.03, 0.07, 0.03, 0.07])


#: A mass on a spring that a constraint ties to another; the last a and lam get something on.
Losing = toy(
    "Losing", q=[1.0, 1.0], force=lambda self, q, v, t: -q,
    constraint=lambda self, q, t: q[:1] - q[1:],
    more_a=parameter(0.0, "m/s^2", "added to a at the end"),
    more_lam=parameter(0.0, "N", "added to lam at the end"),
)  # fmt: skip


def test_a_run_diverges_where_only_a_or_lam_is_not_finite(monkeypatch):
    def complete(scene, q, v, x, t):
        z, xdot = plain(scene, q, v, x, t)
        ended = t >= 1.0 - 1e-9
        a = z.a + jnp.where(ended, scene.more_a, 0.0)
        return z._replace(a=a, lam=z.lam + jnp.where(ended, scene.more_lam, 0.0)), xdot

    plain = skeleton.complete
    monkeypatch.setattr(skeleton, "complete", complete)
    # The inner stage lies at the middle of the step: at the end q and v are still finite.
    method = skeleton.NewIntegrator(place=0.5)
    assert method.prepare(Losing(), 1.0, Steps(0.1)).measure().status == "ok"
    for name in ("more_a", "more_lam"):
        for lost in (math.nan, math.inf, -math.inf):
            run = method.prepare(Losing(**{name: lost}), 1.0, Steps(0.1)).measure()
            assert (run.status, run.t[-1]) == ("diverged", pytest.approx(0.9))
            assert "t=1 s" in run.message


# ---- dependent constraints -------------------------------------------------------------
NAME = "the tangent is singular"


def ended(method, scene, t_end=0.45, h=0.02):
    method = Registry().integrator(method)
    refined = Steps(h) if method.controls == "step" else Tolerances(1e-4)
    return method.prepare(scene, t_end, refined).measure()


@pytest.mark.parametrize(
    "method",
    [
        "generalized_alpha",
        *long("generalized_alpha[newton=modified]", "bdf2[formulation=stabilised_index2]"),
        *long("generalized_alpha_adaptive", "radau_iia", "rattle", "half_explicit_euler"),
        *long("ali3p[values=equations]"),
    ],
)
def test_a_constraint_that_is_stated_twice_is_named_and_other_failures_keep_their_names(method):
    run = ended(method, Pendulum(copies=2))
    assert run.status == "newton_failed"
    assert NAME in run.message
    assert "ali3p[values=own]" in run.message
    other = ended("generalized_alpha", Pendulum(g=1e12), h=0.1)
    assert other.status != "ok"
    assert NAME not in other.message


def test_rank_does_not_depend_on_the_size_of_constraints():
    start = SliderCrank().initial_state()
    assert missing_rank(SliderCrank(), start.q, 0.0) == 0
    for length in (1e-6, 1.0, 1e6):
        pair = Pendulum(copies=2, length=length)
        assert missing_rank(pair, pair.initial_state().q, 0.0) == 1
        assert missing_rank(Pendulum(length=length), pair.initial_state().q, 0.0) == 0
    assert missing_rank(Pendulum(), np.zeros(2), 0.0) == 1


# ---- refusals --------------------------------------------------------------------------
def test_options_resolutions_and_blocks_are_checked_from_python_too():
    class Wrong(StepMethod):
        formulation = "ode"
        begin, step, read = Theta.begin, Theta.step, Theta.read
        theta, other, form = 0.5, 0.5, "one"

    class Short(Theta):
        def read(self, scene, state):
            return super().read(scene, state)._replace(a=jnp.zeros(3))

    for method, at, words in [
        (Theta(form="three"), Steps(0.1), "form=three is not allowed"),
        (Theta(theta=2.0), Steps(0.1), r"theta=2\.0 lies outside"),
        (Theta(), Tolerances(1e-3), r"takes Steps\(h\)"),
        (Careful(), Steps(0.1), r"takes Tolerances\(rtol\)"),
        (Wrong(), Steps(0.1), "ImplicitStepMethod"),  # it solves equations
        (Short(), Steps(0.1), r"read\(\) returns a of shape \(3,\), expected \(1,\)"),
    ]:
        with pytest.raises(SpecError, match=words):
            method.prepare(Oscillator(), 1.0, at)

    flat = toy(base=Pendulum, output=lambda self, z: z.q[:1], actuation=lambda self: np.ones(2))
    with pytest.raises(SpecError, match=r"shape \(2,\), expected \(2, ny\)"):
        _ = flat().sizes
