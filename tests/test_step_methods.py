"""Methods that users write as step functions: options, solvers, notes, and faults in words."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from helpers import long

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
from integrators.methods.generalized_alpha_adaptive import GeneralizedAlphaAdaptive
from problems import jnp
from problems.formulations import dae_layout, dae_residual, ode_rate
from problems.scenes.chain import Chain
from problems.scenes.oscillator import Oscillator
from problems.scenes.pendulum import Pendulum
from problems.spec import SpecError


@dataclass(frozen=True)
class Theta(ImplicitStepMethod):
    """The theta rule on [q, v, x], in one stage or by an explicit and an implicit part."""

    formulation: ClassVar = "ode"
    theta: float = option(0.5, "weight of the end", low=0.0, high=1.0)
    form: str = option("one", "one stage, or two", choices=("one", "two"))

    def begin(self, scene, start, h):
        z = start.z
        return jnp.concatenate([z.q, z.v, z.x])

    def step(self, scene, state, t, h, work):
        explicit = state + h * (1 - self.theta) * ode_rate(scene, t - h, state)
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


@dataclass(frozen=True)
class BackwardEuler(ImplicitStepMethod):
    """Backward Euler on the stabilised index-2 equations."""

    formulation: ClassVar = "stabilised_index2"

    def begin(self, scene, start, h):
        at, z = dae_layout(scene.sizes, self.formulation), start.z
        return jnp.zeros(at.size).at[at.q].set(z.q).at[at.v].set(z.v).at[at.lam].set(z.lam)

    def step(self, scene, state, t, h, work):
        def residual(w):
            return dae_residual(scene, self.formulation, t, w, (w - state) / h)

        return work.solve(residual, state)

    def read(self, scene, state):
        at, nothing = dae_layout(scene.sizes, self.formulation), jnp.zeros(0)
        a = 0 * state[at.v]
        return Reading(state[at.q], state[at.v], a, state[at.lam], nothing, nothing, nothing)


def end_of(method, scene=None, h=0.05, **steps):
    scene = scene or Oscillator()
    run = method.prepare(scene, scene.interval[0] + 1.0, Steps(h, **steps)).measure()
    assert run.status == "ok", run.message
    return run


def test_the_theta_rule_gives_the_powers_of_its_matrix():
    for theta in [0.5, 1.0]:
        scene, h = Oscillator(), 0.05
        run = end_of(Theta(theta=theta), scene, h)
        a = np.array([[0.0, 1.0], [-(scene.omega**2), 0.0]])
        one = np.linalg.solve(np.eye(2) - h * theta * a, np.eye(2) + h * (1 - theta) * a)
        start = np.array([run.q[0, 0], run.v[0, 0]])
        wanted = np.linalg.matrix_power(one, 20) @ start
        assert [run.q[-1, 0], run.v[-1, 0]] == pytest.approx(wanted, rel=1e-11)


def test_an_option_that_is_text_makes_another_program_and_a_float_does_not():
    scene = Oscillator()
    programs = [
        method.program(scene)[0]
        for method in (Theta(), Theta(theta=0.7), Theta(newton_tol=1e-9), Theta(form="two"))
    ]
    assert programs[0] == programs[1] == programs[2]
    assert programs[3] != programs[0]
    one, two = end_of(Theta(theta=0.7)), end_of(Theta(theta=0.7, form="two"))
    assert two.q[-1] == pytest.approx(one.q[-1], rel=1e-11)
    assert two.work.newton > one.work.newton


def test_modified_newton_and_sparse_tangents_need_no_line_of_the_method():
    for method in [Theta(form="two"), BackwardEuler()]:
        scene = Oscillator() if method.formulation == "ode" else Chain(links=3)
        full = end_of(method, scene, 0.02)
        modified = end_of(replace(method, newton="modified"), scene, 0.02)
        size = np.abs(full.q).max()
        assert modified.q == pytest.approx(full.q, abs=1e-9 * size)
        assert modified.work.jacobians < full.work.jacobians
        if method.formulation == "ode":
            with pytest.raises(
                SpecError, match="linear_solver=dense"
            ):  # its equations have a solve
                replace(method, linear_solver="sparse").prepare(scene, 1.0, Steps(0.1))
            return
        sparse = end_of(replace(method, newton="modified", linear_solver="sparse"), scene, 0.02)
        assert sparse.q == pytest.approx(full.q, abs=1e-9 * size)


def test_a_method_with_an_estimate_follows_the_tolerance():
    scene, errors = Oscillator(), []
    for rtol in (1e-2, 1e-3):
        run = Careful(theta=1.0).prepare(scene, 1.0, Tolerances(rtol)).measure()
        assert run.status == "ok"
        errors.append(abs(run.q[-1, 0] - scene.exact(np.array([1.0]))["q"][0, 0]))
    assert errors[1] < 0.3 * errors[0]


@dataclass(frozen=True)
class Early(Oscillator):
    interval = (-0.3, 1.0)


def test_a_run_that_ends_with_its_last_allowed_step_is_complete():
    # Across zero the last time and the last step do not sum to the end, by a rounding error.
    for t_end in np.linspace(0.001, 0.1, 300)[[1, 3, 5, 7, 9]]:
        run = Careful(theta=1.0).prepare(Early(), t_end, Tolerances(10.0)).measure()
        tries = run.work.steps + run.work.rejected
        just, fewer = (
            Careful(theta=1.0, max_steps=most).prepare(Early(), t_end, Tolerances(10.0)).measure()
            for most in (tries, tries - 1)
        )
        assert (just.status, just.t[-1]) == ("ok", t_end)
        assert fewer.status == "budget_exceeded"


@pytest.mark.long
@pytest.mark.parametrize("newton", ["modified", *long("full")])
def test_chosen_steps_with_sparse_tangents_are_those_with_dense_ones(newton):
    scene = Chain(links=4)
    sparse, dense = (
        GeneralizedAlphaAdaptive(newton=newton, linear_solver=kind)
        .prepare(scene, 0.2, Tolerances(1e-3))
        .measure()
        for kind in ("sparse", "dense")
    )
    assert sparse.work.steps == dense.work.steps
    assert sparse.q[-1] == pytest.approx(dense.q[-1], abs=1e-9)
    assert sparse.work.jacobians == pytest.approx(dense.work.jacobians, abs=2)


def test_every_method_notes_the_steps_that_it_took():
    run = end_of(Theta(), h=0.1, pattern=(0.3, 0.7))
    assert np.isnan(run.notes["h"][0])
    assert run.notes["h"][1:5] == pytest.approx([0.03, 0.07, 0.03, 0.07])


def test_options_and_resolutions_are_checked_from_python_too():
    scene = Oscillator()
    with pytest.raises(SpecError, match="form=three is not allowed"):
        Theta(form="three").prepare(scene, 1.0, Steps(0.1))
    with pytest.raises(SpecError, match=r"theta=2\.0 lies outside"):
        Theta(theta=2.0).prepare(scene, 1.0, Steps(0.1))
    with pytest.raises(SpecError, match=r"takes Steps\(h\)"):
        Theta().prepare(scene, 1.0, Tolerances(1e-3))
    with pytest.raises(SpecError, match=r"takes Tolerances\(rtol\)"):
        Careful().prepare(scene, 1.0, Steps(0.1))


def test_an_explicit_method_that_solves_equations_is_told_its_base():
    class Wrong(StepMethod):
        formulation = "ode"
        begin, step, read = Theta.begin, Theta.step, Theta.read
        theta, form = 0.5, "one"

    with pytest.raises(SpecError, match="ImplicitStepMethod"):
        Wrong().prepare(Oscillator(), 1.0, Steps(0.1))


def test_a_scene_with_an_output_states_how_it_acts():
    class Without(Pendulum):
        def output(self, z):
            return z.q[:1]

    class Flat(Without):
        def actuation(self):
            return np.ones(2)

    with pytest.raises(SpecError, match="output but not actuation"):
        _ = Without().sizes
    with pytest.raises(SpecError, match=r"shape \(2,\), expected \(2, ny\)"):
        _ = Flat().sizes
