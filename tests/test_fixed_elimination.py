"""Full Newton's elimination of small tangents: its entries, its order, its work, and its failures.

Counts and errors; `make bench` measures times.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import forget_programs, long
from test_sparse_newton import assert_agree

from integrators import Steps
from integrators.lowering.graph import NotLowered
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.native import linear_solvers, small_matrices
from integrators.native.equations import tangent_pattern
from integrators.native.fixed_elimination import EliminationPlan, planned
from integrators.native.step_work import EquationsFinder
from problems.initial_values import consistent_start
from problems.scenes.car_axis import CarAxis
from problems.scenes.chain import Chain
from problems.scenes.heavy_top import HeavyTop
from problems.scenes.pendulum import Pendulum
from problems.scenes.quarter_car import QuarterCar
from problems.scenes.slider_crank import SliderCrank
from problems.scenes.soft_impact import SoftImpact
from problems.scenes.spring_mass import SpringMass

SCENES = [
    SoftImpact(),
    *long(SliderCrank(), QuarterCar(), HeavyTop(), Chain(links=8), Pendulum()),
    *long(CarAxis(), SpringMass()),
]
on_scenes = pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.name)


def tangent(scene, formulation="index3"):
    """Pattern of the tangent of a step, and tangents at random unknowns."""
    program, numbers = GeneralizedAlpha(formulation=formulation).program(scene)
    start, h, found = consistent_start(scene), scene.nominal_step, []

    def sampled(parameters, numbers, scales):
        moved, finder = scene.with_parameters(parameters), EquationsFinder()
        method = program.functions.with_numbers(numbers.method)
        method.step(moved, method.begin(moved, start, h), start.z.t + h, h, finder)
        (equations,) = finder.found
        u = jnp.linspace(0.3, 1.7, equations.size)
        found.append(tangent_pattern(jax.make_jaxpr(equations.residual)(u), equations.size))
        return jax.vmap(lambda scale: jax.jacfwd(equations.residual)(scale * u))(scales)

    scales = jnp.array([-300.0, -1.0, 0.9, 500.0])
    return jax.jit(sampled)(scene.parameters(), numbers, scales), found[0]


@on_scenes
@pytest.mark.parametrize("cases", [("index3",), *long(["stabilised_index2"])])
def test_no_entry_of_a_tangent_is_missed(scene, cases):
    for formulation in cases:
        values, entries = tangent(scene, formulation)
        assert not (values != 0)[:, ~entries].any()
        assert not entries.all() or len(entries) <= 3


@pytest.mark.parametrize(
    "cases",
    [
        ((SliderCrank(), 37, 8, 85),),
        *long([(HeavyTop(), 57, 8, 167), (Chain(links=8), 104, 6, 352)]),
    ],
)
def test_an_elimination_is_a_small_part_of_that_of_a_full_matrix(cases):
    for scene, entries, products, work in cases:
        _, found = tangent(scene)
        plan = planned(found)
        assert plan is not None
        assert (found.sum(), len(plan.seeds), plan.work) == (entries, products, work)


def unknown_steps(u):
    """A loop, a choice, a sort, a gather, and a derivative of one's own."""
    double = jax.custom_jvp(lambda x: 2 * x)
    double.defjvp(lambda given, rates: (double(*given), 2 * rates[0][::-1]))
    looped = jax.lax.fori_loop(0, 2, lambda _, x: x[::-1] * x, u[:2])
    chosen = jax.lax.cond(u[2] > 0, lambda x: x, lambda x: x[::-1], u[2:4])
    return jnp.concatenate([looped, chosen, jnp.sort(u[4:6]), double(u[6:])])


def test_steps_of_a_program_that_are_not_known_hide_nothing():
    u = jnp.arange(1.0, 9.0)
    entries = tangent_pattern(jax.make_jaxpr(unknown_steps)(u), 8)
    for sign in (1, -1):
        assert not (np.asarray(jax.jacfwd(unknown_steps)(sign * u)) != 0)[~entries].any()
    assert entries.sum() == 14


def test_switches_that_are_off_keep_their_entries():
    def residual(u):
        return jnp.stack([u[0] + jnp.maximum(0.0, u[1]), jnp.where(u[0] > 0, u[1], u[2]), u[2]])

    entries = tangent_pattern(jax.make_jaxpr(residual)(-jnp.ones(3)), 3)
    assert entries.tolist() == [[True, True, False], [False, True, True], [False, False, True]]


@pytest.fixture
def fallbacks(monkeypatch):
    """Number of eliminations with pivots that new programs take."""
    count, original = [], small_matrices.solve

    def counted(a, b):
        jax.debug.callback(lambda: count.append(1))
        return original(a, b)

    monkeypatch.setattr(small_matrices, "solve", counted)
    return count


def solved(a, b, plan):
    products = [jnp.asarray(a @ seed) for seed in plan.seeds]
    return map(np.asarray, jax.jit(plan.solve)(products, jnp.asarray(b)))


BORDERED = np.array([[True, False, True], [False, True, True], [True, True, False]])


def test_a_pivot_that_vanishes_is_no_pivot(fallbacks):
    for pivot, falls_back in [(2.0, False), (0.0, True), (1e-17, True), (1e-9, True)]:
        fallbacks.clear()
        a = np.array([[pivot, 0.0, 1.0], [0.0, 3.0, 1.0], [1.0, 2.0, 0.0]])
        b, plan = np.array([1.0, 2.0, 3.0]), planned(BORDERED)
        x, repeated = solved(a, b, plan)
        jax.effects_barrier()
        assert x == pytest.approx(np.linalg.solve(a, b), rel=1e-14)
        assert len(fallbacks) == repeated == falls_back


def test_a_pivot_of_rounding_alone_is_none(fallbacks):
    a = np.array([[0.1, 0.0, 0.1], [0.0, 3.0, 0.0], [0.3, 0.0, 0.3 * (1 + 1e-15)]])
    plan = planned(a != 0)
    solved(a, np.ones(3), plan)
    jax.effects_barrier()
    assert fallbacks


def test_without_the_test_of_a_solution_it_would_be_wrong(monkeypatch):
    monkeypatch.setattr(EliminationPlan, "_solved", lambda *_: jnp.asarray(True))
    a = np.array([[1e-9, 0.0, 1.0], [0.0, 3.0, 1.0], [1.0, 2.0, 0.0]])
    b, plan = np.array([1.0, 2.0, 3.0]), planned(BORDERED)
    x, _ = solved(a, b, plan)
    assert x != pytest.approx(np.linalg.solve(a, b), rel=1e-14)


def test_a_singular_pattern_and_one_of_much_work_have_no_plan():
    assert planned(np.array([[True, True], [False, False]])) is None
    assert planned(np.ones((32, 32), bool)) is None


def test_a_program_that_cannot_be_followed_is_solved_by_pivots(fallbacks, monkeypatch):
    def refused(*_):
        raise NotLowered("it has too many operations")

    monkeypatch.setattr(linear_solvers, "tangent_pattern", refused)
    du = jax.jit(lambda u: linear_solvers.DENSE.once(lambda u: 2 * u - 1, u).update)(jnp.ones(2))
    jax.effects_barrier()
    assert (du.tolist(), len(fallbacks)) == ([0.5, 0.5], 1)


@on_scenes
def test_runs_agree_with_those_by_pivots(scene, fallbacks, monkeypatch):
    h, t0 = scene.nominal_step / 10, scene.interval[0]

    def run():
        forget_programs()
        return GeneralizedAlpha().prepare(scene, t0 + 40 * h, Steps(h)).measure()

    fixed = run()
    jax.effects_barrier()
    # Where all terms of a row are all but zero, its rounding may be that of other rows; car_axis at
    # its start has such rows, 9 of 80 solutions.
    part = 0.15 if scene.name == "car_axis" else 0.1
    assert len(fallbacks) <= part * (fixed.work.newton or 0)
    fallbacks.clear()
    monkeypatch.setattr(linear_solvers, "planned", lambda entries: None)
    by_pivots = run()
    forget_programs()
    jax.effects_barrier()
    assert len(fallbacks) >= (by_pivots.work.newton or 1)
    assert fixed.status == "ok"
    assert_agree(fixed, by_pivots, 40, h)
