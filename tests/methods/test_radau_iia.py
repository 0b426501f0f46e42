"""Radau IIA: published digits, orders in each formulation, split tangents, tolerances."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers import errors_at, local_slopes, long, reference
from proofs import TWO_RODS, Bent, Coupled, orders

from integrators import Steps, Tolerances
from integrators.methods.radau_iia import RadauIIA, collocation
from integrators.native.step_work import EquationsFinder
from problems import jax, jnp
from problems.initial_values import consistent_start
from problems.scenes.double_pendulum import DoublePendulum, DoublePendulumControlled
from problems.scenes.driven_springs import DrivenSprings
from problems.scenes.heavy_top import HeavyTop
from problems.scenes.pendulum import Pendulum
from problems.scenes.slider_crank import SliderCrank
from problems.scenes.stiff_bar import StiffBar

FORMULATIONS = "index3", "index2", "stabilised_index2"
#: Errors at the end of the swing (largest entry) in q, v and lam, and the largest of lam, from an
#: independent program with 400 steps of two stages, or 80 of three.
ERRORS = {
    (2, "index3"): (2.27e-7, 3.20e-5, 7.83e-2, 0.135),
    (2, "index2"): (2.31e-7, 4.26e-7, 1.86e-4, 4.00e-4),
    (2, "stabilised_index2"): (2.81e-7, 4.93e-7, 1.86e-4, 3.99e-4),
    (3, "index3"): (5.68e-9, 6.40e-6, 3.05e-3, 1.36e-2),
    (3, "index2"): (2.96e-9, 5.36e-9, 1.42e-5, 1.35e-4),
    (3, "stabilised_index2"): (3.75e-9, 6.58e-9, 1.43e-5, 1.36e-4),
}
SHORT = {(3, "stabilised_index2")}
CASES = [case if case in SHORT else pytest.param(*case, marks=pytest.mark.long) for case in ERRORS]


def constant(stages: int = 3, **options: Any) -> RadauIIA:
    return RadauIIA(stages=stages, steps="constant", **options)


def test_the_coefficients_are_the_published_ones():
    root = 6**0.5
    rows = [
        [(88 - 7 * root) / 360, (296 - 169 * root) / 1800, (-2 + 3 * root) / 225],
        [(296 + 169 * root) / 1800, (88 + 7 * root) / 360, (-2 - 3 * root) / 225],
        [(16 - root) / 36, (16 + root) / 36, 1 / 9],
    ]
    three, two = collocation(3), collocation(2)
    np.testing.assert_allclose(three.a, rows, atol=1e-15)
    np.testing.assert_allclose(two.a, [[5 / 12, -1 / 12], [3 / 4, 1 / 4]], atol=1e-15)
    # The error estimate of RADAU5, in rates instead of increments.
    assert 1 / three.filter == pytest.approx(3 + 3 ** (2 / 3) - 3 ** (1 / 3), abs=1e-13)
    of_increments = np.array([-13 - 7 * root, -13 + 7 * root, -1]) / 3
    np.testing.assert_allclose(of_increments @ three.a, -three.to_powers[0], atol=1e-13)


@pytest.mark.long
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_steps_may_vary(formulation):
    method, (scene, t_end) = constant(formulation=formulation), TWO_RODS
    steps = [1 / 20, 1 / 40]
    errors = [errors_at(method, scene, t_end, h, (0.3, 0.7))["q"][-1] for h in steps]
    assert local_slopes(steps, errors)[0] == pytest.approx(5, abs=0.3)


# ---- split tangents ----------------------------------------------------------------------------
@pytest.mark.long
@pytest.mark.parametrize(("stages", "formulation"), ERRORS)
def test_a_controller_that_sees_multipliers_has_the_claimed_order(stages, formulation):
    method = constant(stages, formulation=formulation)
    found = orders(method, 80 if stages == 2 else 20, (Bent(), 1.0))
    for group, claimed in method.claims(Bent()).items():
        assert found[group].order_of_largest == pytest.approx(claimed, abs=0.2), group


@pytest.mark.long
@pytest.mark.parametrize(
    ("stages", "formulation", "scene"),
    [
        (3, "stabilised_index2", Coupled()),
        *long(
            (2, "stabilised_index2", Coupled()),
            (3, "index3", Coupled()),
            (3, "index2", Coupled()),
        ),
    ],
)
def test_split_tangents_solve_linear_equations_at_once(stages, formulation, scene):
    method, finder, h = constant(stages, formulation=formulation), EquationsFinder(), 0.3
    start = jax.tree.map(jnp.asarray, consistent_start(scene))
    method.step(scene, method.begin(scene, start, h), start.z.t + h, h, finder)
    residual, size, split = finder.found[0]
    assert split is not None
    u = jnp.linspace(-1.0, 2.0, size)
    assert abs(residual(u)).max() > 1
    after = jax.jit(lambda u: residual(u - split.once(residual, u).update))(u)
    assert abs(after).max() < 1e-11


@pytest.mark.parametrize("formulation", long(*FORMULATIONS))
def test_modified_newton_finds_the_same_steps_with_fewer_tangents(formulation):
    full = constant(formulation=formulation)
    one, two = (
        method.prepare(SliderCrank(), 0.2, Steps(0.005)).measure()
        for method in (full, replace(full, newton="modified"))
    )
    np.testing.assert_allclose(two.q, one.q, atol=1e-11)
    assert two.work.factorisations < one.work.factorisations / 2
    assert two.work.jacobians == two.work.factorisations  # at one point each
    assert one.work.jacobians == 3 * one.work.factorisations


# ---- tolerances --------------------------------------------------------------------------------
@pytest.mark.long
@pytest.mark.parametrize(
    ("scene", "t_end", "formulation", "stages"),
    [
        (Pendulum(), 1.35, "index3", 3),
        *long(
            (Pendulum(), 1.35, "index2", 3),
            (Pendulum(), 1.35, "stabilised_index2", 3),
            (Pendulum(), 1.35, "stabilised_index2", 2),
            (Pendulum(), 1.35, "index3", 2),
            (SliderCrank(), 0.5, "index3", 3),
            (SliderCrank(), 0.5, "stabilised_index2", 3),
            (StiffBar(), 2.0, "index3", 3),
            (DrivenSprings(), 2.0, "index3", 3),
        ),
    ],
)
def test_errors_follow_the_tolerance(scene, t_end, formulation, stages):
    method, errors = RadauIIA(stages=stages, formulation=formulation), []
    for rtol in (1e-3, 1e-5, 1e-7):
        run = method.prepare(scene, t_end, Tolerances(rtol)).measure()
        assert run.status == "ok", run.message
        exact = reference(scene, t_end)(run.t)["q"]
        errors.append(abs(run.q - exact).max() / abs(exact).max())
        assert errors[-1] < 100 * rtol
    # Far below the tolerance the phase of a vibration that no step resolves remains.
    assert errors[1] < errors[0] / 7
    assert errors[2] < max(errors[1] / 7, 1e-7)


@pytest.mark.long
@pytest.mark.parametrize(
    ("scene", "t_end"), [(Pendulum(), 1.35), (HeavyTop(), 0.2), (SliderCrank(), 2.0)], ids=str
)
def test_the_default_holds_accelerations_far_better_than_index_3_at_the_same_tolerance(
    scene, t_end
):
    def error(method: RadauIIA) -> float:
        run = method.prepare(scene, t_end, Tolerances(1e-6)).measure()
        assert run.status == "ok", run.message
        exact = reference(scene, t_end)(run.t)["a"]
        return abs(run.a - exact).max() / abs(exact).max()

    assert error(RadauIIA()) < error(RadauIIA(formulation="index3")) / 10


@pytest.mark.long
def test_the_stabilised_form_keeps_its_tangents_at_small_steps():
    # b follows positions: an iteration that asks for less than their rounding never contracts.
    method = RadauIIA(formulation="stabilised_index2", steps="constant", newton="modified")
    run = method.prepare(SliderCrank(), 0.5, Steps(2.5e-4)).measure()
    assert run.status == "ok"
    assert run.work.factorisations < 0.2 * run.work.steps
    assert run.work.residuals < 15 * run.work.steps


@pytest.mark.long
def test_a_controller_with_an_acceleration_sensor_takes_small_steps():
    # Accelerations of index 3 round like eps q/h^2, and the controller's values with them.
    method = constant(formulation="index3")
    run = method.prepare(DoublePendulumControlled(), 0.02, Steps(1e-4)).measure()
    assert run.status == "ok", run.message


@pytest.mark.long
@pytest.mark.parametrize("formulation", ["index3", "index2", "stabilised_index2"])
def test_modified_newton_keeps_its_tangent_over_steps(formulation):
    method = RadauIIA(formulation=formulation, steps="constant", newton="modified")
    work = method.prepare(DoublePendulum(), 0.1, Steps(0.002)).measure().work
    assert work.factorisations < 0.3 * work.steps
