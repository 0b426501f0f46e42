"""HHT-I3: orders, the spectrum of HHT, and its two ways to choose steps."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import long, reference
from proofs import SWING, orders

from integrators import Steps, Tolerances
from integrators.methods.hht_i3 import HHTI3
from integrators.native.step_records import Attempt
from problems import MechatronicSystem, State, jax, jnp, lagrange
from problems.scenes.double_pendulum import DoublePendulumControlled
from problems.scenes.heavy_top import HeavyTop
from problems.scenes.pendulum import Pendulum
from problems.scenes.slider_crank import SliderCrankMinimal
from problems.spec import SpecError


@pytest.mark.parametrize("cases", [(("accelerations", 2),), *long([("forces", 1)])])
def test_forces_of_both_ends_cost_an_order_where_the_mass_varies(cases):
    for mixed, order in cases:
        method, crank = HHTI3(steps="constant", mixed=mixed), (SliderCrankMinimal(), 1.0)
        # Errors of the second-order form still fall faster at these steps.
        assert order - 0.1 < orders(method, 400, crank)["q"].order_at_end < order + 0.6
        assert method.claims(SliderCrankMinimal())["q"] == method.claims(HeavyTop())["q"] == order
        assert method.claims(Pendulum())["q"] == 2


@pytest.mark.long
def test_the_heavy_top_follows_the_tolerance():
    scene, t_end = HeavyTop(), 0.2
    end = reference(scene, t_end)(np.array([t_end]))["q"][0]
    errors = []
    for rtol in (1e-5, 1e-7):
        run = HHTI3().prepare(scene, t_end, Tolerances(rtol)).measure()
        assert run.status == "ok"
        errors.append(abs(run.q[-1] - end).max())
    assert errors[0] < 0.1
    assert errors[1] < 0.1 * errors[0]


@dataclass(frozen=True)
class AbsoluteAngles(MechatronicSystem):
    """A double pendulum in absolute angles: M depends on their difference alone."""

    interval = (0.0, 0.2)

    def _kinetic(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return v[0] ** 2 + v[1] ** 2 / 2 + v[0] * v[1] * jnp.cos(q[0] - q[1])

    def _potential(self, q: jax.Array) -> jax.Array:
        return -9.81 * (2 * jnp.cos(q[0]) + jnp.cos(q[1]))

    def mass(self, q: jax.Array) -> jax.Array:
        return lagrange.mass(self._kinetic, q)

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return lagrange.force(self._kinetic, self._potential, q, v)

    def initial_state(self) -> State:
        return State(q=np.array([1.5, 0.3]), v=np.array([1.0, -2.0]))


@pytest.mark.long
def test_a_mass_that_depends_on_a_difference_of_angles_costs_an_order():
    method, scene = HHTI3(steps="constant", mixed="forces"), AbsoluteAngles()
    found = orders(method, 400, (scene, 0.2))
    assert found["q"].order_at_end == pytest.approx(method.claims(scene)["q"], abs=0.1)


@pytest.mark.long
def test_the_published_control_holds_the_local_error():
    errors, steps = [], []
    for rtol in (1e-4, 1e-6, 1e-8):
        run = HHTI3().prepare(*SWING, Tolerances(rtol)).measure()
        assert run.status == "ok"
        errors.append(abs(run.q - SWING[0].exact(run.t)["q"]).max())
        steps.append(run.work.steps)
    slopes = -np.diff(np.log10(errors)) / 2, np.diff(np.log10(steps)) / 2
    assert slopes[0] == pytest.approx([2 / 3, 2 / 3], abs=0.03)
    assert slopes[1] == pytest.approx([1 / 3, 1 / 3], abs=0.03)


@pytest.mark.long
def test_chronos_rule_halves_on_failure_and_doubles_after_five_quick_steps():
    method = HHTI3(control="chrono", newton_tol=1e-3, newton_max=2)
    step = Steps(0.25)
    run = method.prepare(Pendulum(), 4.35, step).measure()
    sizes = np.diff(run.t)
    assert run.status == "ok"
    assert run.work.rejected > 0
    assert sizes.max() <= 0.25 * 1.001
    ratios = sizes[1:-2] / sizes[:-3]  # the last two steps are fitted to the end
    grown = np.flatnonzero(ratios > 1.01)
    assert ratios[grown] == pytest.approx(np.full(len(grown), 2.0))
    assert len(grown) > 0
    assert all(np.ptp(sizes[k - 4 : k + 1]) < 1e-12 for k in grown)
    assert (ratios <= 2.0 + 1e-9).all()


@pytest.mark.long
def test_chronos_rule_does_not_know_of_errors():
    run = HHTI3(control="chrono").prepare(Pendulum(), 1.35, Steps(0.1)).measure()
    assert run.status == "ok"
    assert np.diff(run.t) == pytest.approx(np.full(10, 0.1))
    with pytest.raises(SpecError, match="no pattern"):
        HHTI3(control="chrono").prepare(Pendulum(), 1.35, Steps(0.1, (0.3, 0.7)))


@pytest.mark.long
def test_no_step_is_so_small_that_a_is_rounding_of_positions():
    # The controller's state is 0 at the start: a step that follows it has 2e-8 s at most.
    scene = DoublePendulumControlled()
    run = HHTI3().prepare(scene, 0.01, Tolerances(1e-8)).measure()
    assert run.status == "ok"
    assert np.finfo(float).eps / np.diff(run.t).min() ** 2 < 1e-6
    assert abs(run.a[1:] - run.a[0]).max() < 1.0


def test_a_step_in_which_rounding_of_q_makes_a_is_not_accepted():
    def chosen(h, a):
        before, after = (SimpleNamespace(a=np.array([x]), weights=np.ones(1)) for x in (1.0, a))
        return HHTI3().choose(Attempt(before, after, h, True, 1e-6))

    assert chosen(1e-6, 2.0).accepted
    tiny = chosen(1e-10, 1e5)
    assert not tiny.accepted
    assert tiny.ratio < 1
