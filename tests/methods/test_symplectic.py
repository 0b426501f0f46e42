"""Symplectic methods: forms that steps keep, published digits, multipliers of both sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from helpers import long
from proofs import SWING, TWO_RODS, damping_and_period, step_of

from bench.check.trials import ForcedOscillator
from bench.stability.matrices import matrices
from bench.stability.systems import Oscillator
from integrators import Integrator, Steps
from integrators.methods.generalized_alpha import Newmark
from integrators.methods.lobatto_iiia_iiib import LobattoPair
from integrators.methods.rattle import RATTLE, SHAKE, VariationalMidpoint
from integrators.methods.stormer_verlet import StormerVerlet
from problems import MechatronicSystem, State, jax, jnp
from problems.constraints import constraint_velocity
from problems.scenes.pendulum import Pendulum
from problems.scenes.stiff_bar import StiffBar
from problems.spec import SpecError

ONE_SIDED = RATTLE(multiplier="one_sided")


@dataclass(frozen=True)
class TurningMass(MechatronicSystem):
    """Polar coordinates beside a hard spring: the mass matrix depends on q.

    L = (1 + r^2) p'^2/2 + r'^2/2 - V with V = cos(p) + (r - 1)^2 + r^4/4
    """

    def mass(self, q):
        return jnp.diag(jnp.stack([1 + q[1] ** 2, 1.0]))

    def force(self, q, v, t):
        turning = -2 * q[1] * v[0] * v[1] + jnp.sin(q[0])
        return jnp.stack([turning, q[1] * v[0] ** 2 - 2 * (q[1] - 1) - q[1] ** 3])

    def energy(self, q, v):
        kinetic = 0.5 * (v @ self.mass(q) @ v)
        return kinetic + jnp.cos(q[0]) + (q[1] - 1) ** 2 + q[1] ** 4 / 4

    def initial_state(self):
        return State(q=np.array([0.3, 0.9]), v=np.array([1.0, -0.5]))


SOFT_BAR = StiffBar(ea=200.0)


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
    "cases",
    [
        ((RATTLE(), Pendulum()),),
        *long(
            [
                (StormerVerlet(), SOFT_BAR),
                (RATTLE(), TWO_RODS[0]),
                (VariationalMidpoint(), TurningMass()),
                (RATTLE(), SOFT_BAR),
                (SHAKE(), SOFT_BAR),
                (VariationalMidpoint(), SOFT_BAR),
                (VariationalMidpoint(), TWO_RODS[0]),
                (LobattoPair(), SOFT_BAR),
                (LobattoPair(), TWO_RODS[0]),
            ]
        ),
    ],
)
def test_a_step_keeps_the_symplectic_form(cases):
    for method, scene in cases:
        assert change_of_form(method, scene, 0.05) < 1e-13


@pytest.mark.long
def test_the_trapezoidal_rule_does_not_keep_it():
    assert change_of_form(Newmark(beta=0.25, gamma=0.5), SOFT_BAR, 0.05) > 1e-9


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


def test_averages_hold_their_order_in_patterns_of_steps():
    scene, t_end = SWING
    largest = []
    for steps in (100, 200):
        run = RATTLE().prepare(scene, t_end, Steps(1 / steps, (0.3, 0.7))).measure()
        largest.append(abs(run.lam - scene.exact(run.t)["lam"]).max())
    assert np.log2(largest[0] / largest[1]) == pytest.approx(2.0, abs=0.1)


@pytest.mark.long
def test_shake_has_the_positions_of_rattle_and_central_differences_as_velocities():
    one, two = (m.prepare(*SWING, Steps(0.01)).measure() for m in (SHAKE(), RATTLE()))
    assert one.q == pytest.approx(two.q, abs=1e-12)
    assert one.lam == pytest.approx(two.lam, abs=1e-9)
    assert one.v[1:-1] == pytest.approx((one.q[2:] - one.q[:-2]) / 0.02, abs=1e-11)


@pytest.mark.long
def test_looking_ahead_costs_one_solve_in_the_run():
    averaged, one_sided = (
        m.prepare(*SWING, Steps(0.01)).measure().work.newton for m in (RATTLE(), ONE_SIDED)
    )
    assert averaged - one_sided < 6


def test_stormer_verlet_is_explicit_and_the_central_difference_method():
    run = StormerVerlet().prepare(ForcedOscillator(), 7.0, Steps(0.1)).measure()
    assert run.work.residuals == run.work.solves == 50
    other = Newmark(beta=0.0).prepare(ForcedOscillator(), 7.0, Steps(0.1)).measure()
    assert run.q == pytest.approx(other.q, abs=1e-12)
    assert run.v == pytest.approx(other.v, abs=1e-12)


@pytest.mark.long
def test_with_damping_stormer_verlet_is_the_implicit_central_difference_method():
    # q'' + 0.4 q' + q = 0, whose differences give a recurrence for q alone.
    h, scene = 0.1, Oscillator(zeta=0.2).from_deviation(np.array([1.0, 0.0]))
    run = StormerVerlet().prepare(scene, 1.0, Steps(h)).measure()
    q = run.q[:, 0]
    left = (q[2:] - 2 * q[1:-1] + q[:-2]) / h**2 + 0.4 * (q[2:] - q[:-2]) / (2 * h) + q[1:-1]
    assert abs(left).max() < 1e-12


@pytest.mark.long
@pytest.mark.parametrize("method", [StormerVerlet(), *long(RATTLE(), SHAKE())])
def test_the_limit_of_stability_is_two(method):
    steps = [0.1, 1.0, 1.999, 2.01]
    radii = [abs(np.linalg.eigvals(a)).max() for a in matrices(method, Oscillator(), steps).a]
    half = 2.01**2 / 2 - 1  # minus the roots' mean
    wanted = [1.0, 1.0, 1.0, half + np.sqrt(half**2 - 1)]
    assert radii == pytest.approx(wanted, abs=1e-9)
    damping, period = damping_and_period(method)
    assert (damping, period) == pytest.approx((0.0, -0.01693422976), abs=1e-9)


@pytest.mark.long
def test_the_midpoint_rule_keeps_angular_momentum():
    run = VariationalMidpoint().prepare(SOFT_BAR, 10.0, Steps(0.05)).measure()
    spin = run.q[:, 0] * run.v[:, 1] - run.q[:, 1] * run.v[:, 0]
    assert abs(spin / spin[0] - 1).max() < 1e-12


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


def test_a_run_that_is_not_supported_cannot_be_prepared():
    for method in (RATTLE(), LobattoPair()):
        with pytest.raises(SpecError, match=r"does not take turning_mass: .* constant mass matrix"):
            method.prepare(TurningMass(), 1.0, Steps(0.01))


def test_refusals_name_the_way_out():
    assert "variational_midpoint" in RATTLE().supports(TurningMass())
    assert VariationalMidpoint().supports(TurningMass()) is None
    assert "is symplectic with a constant mass matrix alone" in LobattoPair().supports(
        TurningMass()
    )
    assert "rattle" in StormerVerlet().supports(Pendulum())
