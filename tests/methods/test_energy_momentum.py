"""The energy-momentum method: exact energy, exact momentum, orders; discrete gradients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from helpers import long
from proofs import SWING, orders

from bench.check.trials import ForcedOscillator
from bench.stability.systems import Oscillator
from integrators import Steps
from integrators.contract import Trajectory
from integrators.methods.energy_momentum import EnergyMomentum
from integrators.methods.generalized_alpha import Newmark
from integrators.native.discrete_gradients import NoDiscreteGradient, discrete_gradient
from problems import MechatronicSystem, State, jax, jnp, parameter
from problems.scenes.chain import Chain
from problems.scenes.double_pendulum import DoublePendulum
from problems.scenes.heavy_top import HeavyTop
from problems.scenes.slider_crank import SliderCrank
from problems.scenes.soft_impact import SoftImpact
from problems.scenes.stiff_bar import StiffBar


class TwoRods(DoublePendulum):
    """The double pendulum with its energy."""

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return 0.5 * (v @ self.mass(q) @ v) + 9.81 * (q[1] + 0.5 * q[3])


class ConservingOscillator(Oscillator):
    """The oscillator with its energy."""

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return 0.5 * (v @ v + q @ q)


@dataclass(frozen=True)
class Damped(MechatronicSystem):
    """States an energy, which its damper does not conserve."""

    c: float = parameter(0.0, "N s/m", "damping")

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.eye(1)

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return -q - self.c * v

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return 0.5 * (q @ q + v @ v)

    def initial_state(self) -> State:
        return State(q=np.ones(1), v=np.zeros(1))


def _change_of_energy(scene: MechatronicSystem, run: Trajectory) -> float:
    """Largest change of the energy, relative to the kinetic or the whole energy."""
    energy = jax.vmap(scene.energy)
    total = np.asarray(energy(run.q, run.v))
    kinetic = total - np.asarray(energy(run.q, 0 * run.v))
    return float(abs(total - total[0]).max() / max(kinetic.max(), abs(total[0])))


@pytest.mark.parametrize(
    ("scene", "t_end"),
    [
        (SWING[0], 1.35),
        *long((Chain(), 1.0), (SliderCrank(), 1.0), (HeavyTop(), 0.1), (SoftImpact(), 1.0)),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
@pytest.mark.parametrize("formulation", ["index3", *long("stabilised_index2")])
def test_the_energy_is_exact(scene, t_end, formulation):
    method = EnergyMomentum(formulation=formulation)
    run = method.prepare(scene, t_end, Steps(scene.nominal_step)).measure()
    assert run.status == "ok"
    assert _change_of_energy(scene, run) < 1e-13


@pytest.mark.long
def test_it_goes_on_where_the_trapezoidal_rule_dies_with_exact_energy_and_momentum():
    scene, end, step = StiffBar(), 10.0, Steps(0.02)
    died = Newmark().prepare(scene, end, step).measure()
    assert died.status == "newton_failed"
    run = EnergyMomentum().prepare(scene, end, step).measure()
    assert run.status == "ok"
    assert _change_of_energy(scene, run) < 1e-12
    momentum = run.q[:, 0] * run.v[:, 1] - run.q[:, 1] * run.v[:, 0]
    assert np.ptp(momentum) < 1e-13 * momentum[0]
    # Trapezoidal errors of phase: 0.5 % after four turns.
    assert abs(run.q - scene.exact(run.t)["q"]).max() < 0.02


@pytest.mark.long
@pytest.mark.parametrize("formulation", ["index3", "stabilised_index2"])
def test_orders_on_two_rods(formulation):
    found = orders(EnergyMomentum(formulation=formulation), 400, (TwoRods(), 1.0))
    for group, claimed in {"q": 2, "v": 2, "lam": 1, "a": 1}.items():
        assert found[group].order_at_end > claimed - 0.1, group


def _potential(q: jax.Array) -> jax.Array:
    """All kinds of operations."""
    far = jnp.concatenate([q[1:], q[:1]])
    waves = jnp.sin(q) @ jnp.cos(far) + jnp.exp(-q[0]) / (2 + q[1]) ** 2
    roots = jnp.sqrt(1 + q @ q) + (3 + q[0]) ** -1.5 + jnp.log(3 + q[2]) + jax.lax.rsqrt(2 + q[0])
    others = jnp.tanh(q[0]) + jnp.arcsin(q[1] / 4) + jnp.linalg.norm(q + 1) + q[2] ** 3
    return waves + roots + others + jnp.square(q[2]) / q.dot(q)


_value, _slope = jax.jit(_potential), jax.jit(jax.grad(_potential))
_gradient = jax.jit(lambda q0, q1: discrete_gradient(_potential, q0, q1, jnp.ones(())))


def test_a_discrete_gradient_gives_the_change_exactly():
    for change in [1.0, 0.1, 1e-2, 1e-6]:
        q0 = np.array([0.3, -0.5, 0.8])
        q1 = q0 + change * np.array([0.5, 1.0, -0.7])
        actual = float(_value(q1) - _value(q0))
        gradient = np.asarray(_gradient(q0, q1))
        assert gradient @ (q1 - q0) == pytest.approx(actual, rel=1e-13, abs=2e-15)
        assert np.asarray(_gradient(q0, q0)) == pytest.approx(np.asarray(_slope(q0)), rel=1e-13)


@pytest.mark.long
def test_a_drive_that_sets_in_later_ends_the_run():
    class Driven(ConservingOscillator):
        def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
            return -q + jnp.where(t > 0.8, 1e-3, 0.0)

    scene = Driven().from_deviation(np.array([1.0, 0.0]))
    run = EnergyMomentum().prepare(scene, 1.0, Steps(0.1)).measure()
    assert (run.status, run.t[-1]) == ("newton_failed", pytest.approx(0.8))


def test_what_it_cannot_take_is_said():
    with pytest.raises(NoDiscreteGradient, match="abs"):
        discrete_gradient(lambda q: jnp.abs(q).sum(), jnp.ones(2), jnp.zeros(2), jnp.ones(()))
    method = EnergyMomentum()
    assert "no energy" in method.supports(ForcedOscillator())
    assert "damping" in method.supports(Damped(c=0.1))
    assert method.supports(Damped()) is None


@dataclass(frozen=True)
class Looped(Damped):
    """Its potential, 6 q^4/4, is a sum in a loop."""

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        loop = jax.lax.fori_loop(0, 3, lambda k, s: s + (k + 1) * q[0] ** 4 / 4, jnp.zeros(()))
        return 0.5 * (v @ v) + loop


def test_a_loop_in_an_energy_is_refused_by_name():
    assert "'scan'" in str(EnergyMomentum().supports(Looped()))
