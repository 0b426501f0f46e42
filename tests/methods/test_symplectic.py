"""Invariants: forms that symplectic steps keep, exact energy and momentum, discrete gradients."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import long, run_of, toy
from proofs import SWING, TWO_RODS, ConservingOscillator, step_of

from bench.check.trials import ForcedOscillator
from bench.running.measure import invariant_changes
from integrators import Integrator, Steps
from integrators.methods.energy_momentum import (
    EnergyMomentum,
    NoDiscreteGradient,
    discrete_gradient,
)
from integrators.methods.generalized_alpha import Newmark
from integrators.methods.simulator_steppers import SemiImplicitEuler
from integrators.methods.symplectic import (
    RATTLE,
    SHAKE,
    LobattoPair,
    StormerVerlet,
    VariationalMidpoint,
)
from problems import MechatronicSystem, jax, jnp, parameter
from problems.equations.kinematics import constraint_velocity
from problems.scenes.contacts import SoftImpact
from problems.scenes.heavy_top import HeavyTop
from problems.scenes.pendulums import Chain, Pendulum, StiffBar
from problems.scenes.slider_crank import SliderCrank

SOFT_BAR = StiffBar(ea=200.0)


def turning_force(self, q, v, t):
    turning = -2 * q[1] * v[0] * v[1] + jnp.sin(q[0])
    return jnp.stack([turning, q[1] * v[0] ** 2 - 2 * (q[1] - 1) - q[1] ** 3])


def turning_energy(self, q, v):
    return 0.5 * (v @ self.mass(q) @ v) + jnp.cos(q[0]) + (q[1] - 1) ** 2 + q[1] ** 4 / 4


#: Polar coordinates beside a hard spring: the mass matrix depends on q.
#: L = (1 + r^2) p'^2/2 + r'^2/2 - V with V = cos(p) + (r - 1)^2 + r^4/4.
TurningMass = toy(
    "TurningMass", q=[0.3, 0.9], v=[1.0, -0.5], force=turning_force,
    mass=lambda self, q: jnp.diag(jnp.stack([1 + q[1] ** 2, 1.0])), energy=turning_energy,
)  # fmt: skip


# ---- the symplectic form -----------------------------------------------------------------
def change_of_form(method: Integrator, scene: MechatronicSystem, h: float) -> float:
    """Largest change of dq ^ dp by a step, over directions tangential to the constraints."""
    step, (q, v, _) = step_of(method, scene, h), scene.initial_state()
    n = len(q)

    def momenta(q, v):
        return jnp.concatenate([q, scene.mass(q) @ v])

    def consistent(s):
        q, v = jnp.split(s, 2)
        t = jnp.asarray(scene.interval[0])
        return jnp.concatenate([scene.constraint(q, t), constraint_velocity(scene, q, v, t)])

    start = np.concatenate([q, v])
    tangents = np.eye(2 * n)
    if scene.has("constraint"):
        rows = jax.jit(jax.jacfwd(consistent))(start)
        tangents = np.linalg.svd(rows)[2][len(rows) :].T
    slopes = jax.jit(jax.jacfwd(lambda s: momenta(*jnp.split(s, 2))))(start)
    before = np.asarray(slopes) @ tangents

    @jax.jit  # one direction at a time: those of Newton's method lie side by side already
    def moved(direction):
        return jax.jvp(lambda s: momenta(*step(*jnp.split(s, 2))), (start,), (direction,))[1]

    after = np.stack([moved(direction) for direction in tangents.T], axis=1)
    form = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    return float(abs(after.T @ form @ after - before.T @ form @ before).max())


@pytest.mark.parametrize(
    ("method", "scene"),
    [
        (RATTLE(), Pendulum()),
        *long(
            *((m(), SOFT_BAR) for m in (StormerVerlet, RATTLE, SHAKE, VariationalMidpoint)),
            *((m(), SOFT_BAR) for m in (LobattoPair, SemiImplicitEuler)),
            *((m(), TWO_RODS[0]) for m in (RATTLE, VariationalMidpoint, LobattoPair)),
            *((VariationalMidpoint(), TurningMass()), (Newmark(beta=0.25, gamma=0.5), SOFT_BAR)),
        ),
    ],
)
def test_a_step_keeps_the_symplectic_form_and_one_of_the_trapezoidal_rule_does_not(method, scene):
    change = change_of_form(method, scene, 0.05)
    assert change > 1e-9 if isinstance(method, Newmark) else change < 1e-13


@pytest.mark.long
@pytest.mark.parametrize(
    ("method", "scene", "h"),
    [
        (RATTLE(), Pendulum(), 0.05),
        (LobattoPair(), Pendulum(), 0.05),
        (VariationalMidpoint(), TurningMass(), 0.05),
        (StormerVerlet(), SOFT_BAR, 0.02),
    ],
)
def test_the_error_of_energy_does_not_grow(method, scene, h):
    # 10 000 periods of about 2.4 s
    run = method.prepare(scene, scene.interval[0] + 24_000.0, Steps(h)).measure()
    energy = np.asarray(jax.vmap(scene.energy)(run.q, run.v))
    error = abs(energy - energy[0])
    tenth = len(error) // 10
    assert error[-tenth:].max() < 1.05 * error[:tenth].max() + 1e-10
    assert error.max() < 0.1 * max(1.0, abs(energy[0]))


def test_the_multiplier_averaged_from_both_sides_has_the_digits_of_an_independent_program():
    wanted = {50: 0.0343, 100: 8.56e-3, 200: 2.14e-3, 400: 5.35e-4}
    scene, t_end = SWING
    for steps, error in wanted.items():
        run = RATTLE().prepare(scene, t_end, Steps(1 / steps)).measure()
        found = abs(run.lam - scene.exact(run.t)["lam"]).max()
        assert found == pytest.approx(error, rel=5e-3), steps
    ends = {group: abs(getattr(run, group) - scene.exact(run.t)[group])[-1] for group in "qv"}
    assert ends["q"].max() == pytest.approx(7.88e-6, rel=2e-3)
    assert ends["v"].max() == pytest.approx(8.59e-5, rel=2e-3)
    # Looking ahead costs one solve in the run.
    one_sided = RATTLE(multiplier="one_sided").prepare(scene, t_end, Steps(1 / steps)).measure()
    assert run.work.newton - one_sided.work.newton < 6


# ---- energy and momentum -----------------------------------------------------------------
@pytest.mark.parametrize(
    ("scene", "t_end", "formulation"),
    [
        (*SWING, "index3"),
        *long(
            (*SWING, "stabilised_index2"),
            *((Chain(), 1.0, f) for f in ("index3", "stabilised_index2")),
            *((s, t, "index3") for s, t in ((SliderCrank(), 1.0), (HeavyTop(), 0.1))),
            (SoftImpact(), 1.0, "index3"),
        ),
    ],
    ids=lambda of: getattr(of, "name", ""),
)
def test_energy_momentum_keeps_the_energy_exactly(scene, t_end, formulation):
    method = EnergyMomentum(formulation=formulation)
    run = run_of(method, scene, Steps(scene.nominal_step), t_end)
    assert abs(invariant_changes(scene, run)["energy"]).max() < 1e-13


@pytest.mark.long
def test_momenta_are_exact():
    for method, scene, h in (
        (EnergyMomentum(), StiffBar(), 0.02),
        (VariationalMidpoint(), SOFT_BAR, 0.05),
    ):
        run = method.prepare(scene, 10.0, Steps(h)).measure()
        assert abs(invariant_changes(scene, run)["momentum"]).max() < 1e-12
        # Phases of the trapezoidal rule are off by 0.5 % after four turns.
        assert scene is SOFT_BAR or abs(run.q - scene.exact(run.t)["q"]).max() < 0.02


@pytest.mark.long
def test_a_drive_that_sets_in_later_ends_the_run():
    late = lambda self, q, v, t: -q + jnp.where(t > 0.8, 1e-3, 0.0)  # noqa: E731
    driven = toy("Driven", base=ConservingOscillator, force=late)()
    scene = driven.from_deviation(np.array([1.0, 0.0]))
    run = EnergyMomentum().prepare(scene, 1.0, Steps(0.1)).measure()
    assert (run.status, run.t[-1]) == ("newton_failed", pytest.approx(0.8))


def potential(q):
    """All kinds of operations."""
    far = jnp.concatenate([q[1:], q[:1]])
    waves = jnp.sin(q) @ jnp.cos(far) + jnp.exp(-q[0]) / (2 + q[1]) ** 2
    roots = jnp.sqrt(1 + q @ q) + (3 + q[0]) ** -1.5 + jnp.log(3 + q[2]) + jax.lax.rsqrt(2 + q[0])
    others = jnp.tanh(q[0]) + jnp.arcsin(q[1] / 4) + jnp.linalg.norm(q + 1) + q[2] ** 3
    return waves + roots + others + jnp.square(q[2]) / q.dot(q)


def test_a_discrete_gradient_gives_the_change_exactly():
    value, slope = jax.jit(potential), jax.jit(jax.grad(potential))
    of = jax.jit(lambda q0, q1: discrete_gradient(potential, q0, q1, jnp.ones(())))
    for change in [1.0, 0.1, 1e-2, 1e-6]:
        q0 = np.array([0.3, -0.5, 0.8])
        q1 = q0 + change * np.array([0.5, 1.0, -0.7])
        actual = float(value(q1) - value(q0))
        assert np.asarray(of(q0, q1)) @ (q1 - q0) == pytest.approx(actual, rel=1e-13, abs=2e-15)
        assert np.asarray(of(q0, q0)) == pytest.approx(np.asarray(slope(q0)), rel=1e-13)
    with pytest.raises(NoDiscreteGradient, match="abs"):
        discrete_gradient(lambda q: jnp.abs(q).sum(), jnp.ones(2), jnp.zeros(2), jnp.ones(()))


def looped(self, q, v):
    loop = jax.lax.fori_loop(0, 3, lambda k, s: s + (k + 1) * q[0] ** 4 / 4, jnp.zeros(()))
    return 0.5 * (v @ v) + loop


#: It states an energy, which its damper does not conserve; its potential is a sum in a loop.
Damped = toy(
    "Damped", c=parameter(0.0, "N s/m", "damping"),
    force=lambda self, q, v, t: -q - self.c * v, energy=lambda self, q, v: 0.5 * (q @ q + v @ v),
)  # fmt: skip
Looped = toy("Looped", base=Damped, energy=looped)


def test_what_they_cannot_take_is_refused_with_the_way_out():
    for method, scene, words in [
        (RATTLE(), TurningMass(), "variational_midpoint"),
        (LobattoPair(), TurningMass(), "needs a constant mass matrix"),
        (StormerVerlet(), Pendulum(), "rattle"),
        (EnergyMomentum(), ForcedOscillator(), "no energy"),
        (EnergyMomentum(), Damped(c=0.1), "damping"),
        (EnergyMomentum(), Looped(), "'scan'"),
    ]:
        assert words in str(method.supports(scene))
    assert VariationalMidpoint().supports(TurningMass()) is None
    assert EnergyMomentum().supports(Damped()) is None
