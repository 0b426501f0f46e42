"""Steppers of simulators: spectra, orders, drift, and the same work in every step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from helpers import long
from proofs import SWING, damping_and_period, step_of

from bench.check.counts import audited
from bench.check.trials import FiniteTimeBlowUp
from bench.stability.matrices import matrices
from bench.stability.systems import Oscillator, Relaxation
from integrators import Steps
from integrators.methods.simulator_steppers import (
    ImplicitFast,
    LinearlyImplicitEuler,
    SemiImplicitEuler,
)
from problems import MechatronicSystem, State, jax, jnp, parameter
from problems.scenes.slider_crank import SliderCrankMinimal

ALL = SemiImplicitEuler(), ImplicitFast(), LinearlyImplicitEuler()


@pytest.mark.parametrize("cases", [(ALL[0],), *long([ALL[1]])])
def test_semi_implicit_steps_do_not_damp_up_to_their_limit(cases):
    for method in cases:
        assert damping_and_period(method) == pytest.approx((0.0, -0.01693422976), abs=1e-9)
        found = matrices(method, Oscillator(), [0.1, 1.0, 1.999, 2.001]).a
        radii = [float(np.abs(np.linalg.eigvals(a)).max()) for a in found]
        assert radii[:3] == pytest.approx([1.0] * 3, abs=1e-12)
        assert radii[3] > 1.02


@pytest.mark.long
@pytest.mark.parametrize("method", [ALL[0], *long(ALL[1])], ids=lambda m: m.name)
def test_a_controller_is_stable_up_to_twice_its_time(method):
    found = matrices(method, Relaxation(), [1.9, 2.1]).a
    radii = [float(np.abs(np.linalg.eigvals(a)).max()) for a in found]
    assert radii == pytest.approx([0.9, 1.1], abs=1e-12)


@pytest.mark.long
def test_semi_implicit_steps_are_symplectic():
    step = step_of(SemiImplicitEuler(), SoftSpring(), 0.1)
    at, small = np.array([0.7, -0.4]), 1e-4

    def after(q: float, v: float) -> np.ndarray:
        return np.concatenate(step(jnp.array([q]), jnp.array([v])))

    columns = [(after(*at + d) - after(*at - d)) / (2 * small) for d in small * np.eye(2)]
    assert np.linalg.det(np.array(columns)) == pytest.approx(1.0, abs=1e-8)


@dataclass(frozen=True)
class SoftSpring(MechatronicSystem):
    """A mass on a soft nonlinear spring, with a damper if it is asked for."""

    interval = (0.0, 1.0)
    c: float = parameter(0.0, "N s/m", "damping")

    def mass(self, q: jax.Array) -> jax.Array:
        return 2.0 * jnp.eye(1)

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return -jnp.sin(q) - q**3 - self.c * v

    def initial_state(self) -> State:
        return State(q=np.array([0.7]), v=np.array([-0.4]))


@pytest.mark.long
def test_linearly_implicit_steps_are_implicit_euler_on_linear_systems():
    controller = matrices(LinearlyImplicitEuler(), Relaxation(), [3.0]).a[0]
    assert np.abs(np.linalg.eigvals(controller)).max() == pytest.approx(1 / 4, abs=1e-12)


def test_implicit_damping_is_stable_where_explicit_damping_is_not():
    scene = SoftSpring(c=1e4)
    implicit, explicit = (
        method.prepare(scene, 1.0, Steps(0.01)).measure() for method in (ImplicitFast(), ALL[0])
    )
    assert implicit.status == "ok"
    assert abs(implicit.v).max() <= 0.4
    assert explicit.status == "diverged"


@pytest.mark.long
def test_derivatives_of_coriolis_forces_are_left_out():
    # All velocity dependence of this scene comes from M(q): nothing is left to damp implicitly.
    fast, plain = (
        method.prepare(SliderCrankMinimal(), 0.2, Steps(0.01)).measure()
        for method in (ImplicitFast(), SemiImplicitEuler())
    )
    assert fast.v == pytest.approx(plain.v, rel=1e-9)


@dataclass(frozen=True)
class DampedArms(MechatronicSystem):
    """Two arms on one another, whose mass varies; dampers, and a force that is not symmetric."""

    interval = (0.0, 1.0)
    nominal_step = 0.01

    def mass(self, q: jax.Array) -> jax.Array:
        c = jnp.cos(q[1])
        return jnp.array([[3.0 + 2.0 * c, 1.0 + c], [1.0 + c, 1.0]])

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        s, damping = jnp.sin(q[1]), jnp.array([[40.0, 3.0], [-1.0, 20.0]])
        coriolis = s * jnp.stack([v[1] * (2.0 * v[0] + v[1]), -(v[0] ** 2)])
        return coriolis - damping @ v - 9.81 * jnp.sin(q)

    def initial_state(self) -> State:
        return State(q=np.array([0.7, 1.0]), v=np.array([1.0, -2.0]))


class ByProducts(DampedArms):
    """The same, as trees of bodies state their mass."""

    def mass_product(self, q: jax.Array, a: jax.Array) -> jax.Array:
        return self.mass(q) @ a


@pytest.mark.long
def test_the_matrix_of_a_tree_is_that_of_products():
    one, other = (
        ImplicitFast().prepare(scene, 1.0, Steps(0.01)).measure()
        for scene in (DampedArms(), ByProducts())
    )
    assert one.status == other.status == "ok"
    assert other.q == pytest.approx(one.q, rel=1e-11)
    assert other.v == pytest.approx(one.v, rel=1e-9, abs=1e-12)


def test_the_drift_is_what_the_error_reduction_leaves():
    for erp in [1.0, 0.2, 0.1]:
        scene, h = SWING[0], 1e-3
        run = SemiImplicitEuler(erp=erp).prepare(scene, 1.35, Steps(h)).measure()
        drift = 0.5 * ((run.q**2).sum(axis=1) - 1)
        # Phi grows by h^2 v.v/2 in a step and loses its part erp; it follows v.v with a lag.
        v = run.v[-1 - round((1 - erp) / erp)]
        assert drift[-1] == pytest.approx(h**2 * (v @ v) / (2 * erp), rel=0.02)


@pytest.mark.long
def test_no_step_leads_across_a_pole():
    scene = FiniteTimeBlowUp()
    run = LinearlyImplicitEuler().prepare(scene, 1.5, Steps(0.01)).measure()
    assert run.status == "newton_failed"
    assert run.t[-1] == pytest.approx(0.98, abs=0.03)


@pytest.mark.parametrize("cases", [(ALL[0],), *long([*ALL[1:]])])
def test_the_work_of_all_steps_is_the_same_and_there_is_no_iteration(cases):
    for method in cases:
        run = method.prepare(*SWING, Steps(0.01))
        work, steps = run.measure().work, 100
        assert work.newton == 0
        assert (work.residuals, work.jacobians) == (steps, steps)
        assert (work.factorisations, work.solves) == (steps, steps)
        declared, counted = audited(method, SWING[0])
        assert counted <= declared
        bill = run.bill(run.measure())
        # Three unknowns in a fixed order (`tests/test_operations.py`).
        assert (bill["factorisations"], bill["solves"]) == (steps * 10, steps * 41)
