"""The formulations that are derived from a scene's blocks."""

import numpy as np
import pytest
from helpers import toy
from scipy.optimize import brentq

from problems import State, jax, jnp, parameter
from problems.equations import formulations as form
from problems.equations.compiled import compiled
from problems.equations.initial_values import InconsistentStart, consistent_start
from problems.scenes.ivp_test_set import CarAxis
from problems.scenes.oscillators import SpringMass
from problems.scenes.pendulums import Pendulum

#: m a + k q = y, xdot = a^3 - x, 0 = y - c tanh(x + a - y): implicit in y, nonlinear in a.
NonlinearFeedback = toy(
    "NonlinearFeedback", q=[0.7], v=[0.2], x=[0.4], c=parameter(2.0, "N", "limit of the actuator"),
    force=lambda self, q, v, t: -3.0 * q, state_rate=lambda self, z: z.a**3 - z.x,
    output=lambda self, z: self.c * jnp.tanh(z.x + z.a - z.y), actuation=lambda self: np.eye(1),
)  # fmt: skip
#: A bead on a parabola that time moves: rheonomic, its mass depends on q.
DrivenBead = toy(
    "DrivenBead", interval=(0.3, 1.0), q=[0.5, 0.25 + np.sin(0.6)],
    v=[-0.4, -0.4 + 2 * np.cos(0.6)],
    mass=lambda self, q: jnp.diag(jnp.stack([1.0 + q[0] ** 2, jnp.asarray(2.0)])),
    force=lambda self, q, v, t: jnp.stack([-q[0] * v[0] ** 2, -9.81 * jnp.cos(t)]),
    constraint=lambda self, q, t: (q[1] - q[0] ** 2 - jnp.sin(2 * t))[None],
)  # fmt: skip
#: Two coordinates of which one has no mass: only the augmented matrix is regular.
MasslessAlone = toy(
    "MasslessAlone", q=[1.0, 1.0], v=[0.5, 0.5],
    mass=lambda self, q: jnp.diag(jnp.array([1.0, 0.0])),
    force=lambda self, q, v, t: jnp.stack([-2.0 * q[0], jnp.asarray(0.0)]),
    constraint=lambda self, q, t: (q[1] - q[0])[None],
)  # fmt: skip
#: A pendulum whose bob is set beside its circle.
OffTheRod = toy(
    "OffTheRod", base=Pendulum,
    initial_state=lambda self: State(np.array([1.001, 0.0]), np.zeros(2), np.zeros(0)),
)  # fmt: skip


def test_the_start_of_the_paper_and_of_implicit_outputs_and_singular_masses_is_found():
    start = consistent_start(SpringMass())
    assert start.z.a == pytest.approx([-5.0], abs=1e-14)
    assert start.xdot == pytest.approx([7.0], abs=1e-14)
    assert start.z.y == pytest.approx([0.0, 0.0], abs=1e-14)
    scene = NonlinearFeedback()
    start, (q, _, x) = consistent_start(scene), scene.initial_state()

    def eliminated(y):  # a = y - 3 q put into the output equation
        return y - scene.c * np.tanh(x[0] + y - 3 * q[0] - y)

    y = brentq(eliminated, -10, 10, xtol=1e-15)
    assert start.z.y == pytest.approx([y], rel=1e-12)
    assert start.z.a == pytest.approx([y - 3 * q[0]], rel=1e-12)
    assert start.xdot == pytest.approx([start.z.a[0] ** 3 - x[0]], rel=1e-12)
    # One oscillator of mass 1 and stiffness 2; the second coordinate follows without force.
    start = consistent_start(MasslessAlone())
    assert start.z.a == pytest.approx([-2.0, -2.0], abs=1e-13)
    assert start.z.lam == pytest.approx([0.0], abs=1e-13)
    # Parameters are traced and compile nothing new.
    light, heavy = SpringMass(m=1.0), SpringMass(m=7.0)
    assert compiled(light) is compiled(heavy)
    assert consistent_start(heavy).z.a == pytest.approx([-5.0 / 7.0])


def test_the_jerk_is_the_slope_of_the_acceleration_along_the_motion():
    for scene in [Pendulum(), SpringMass(), NonlinearFeedback(), DrivenBead()]:
        start = consistent_start(scene)
        z, xdot, eps = start.z, start.xdot, 1e-5
        functions, p = compiled(scene), scene.parameters()
        ends = []
        for s in (-eps, eps):
            rows = (z.q + s * z.v + s**2 / 2 * z.a, z.v + s * z.a, z.x + s * xdot)
            rows = [np.asarray(row)[None] for row in rows]
            ends.append(functions.complete(p, *rows, np.array([z.t + s]))[0].a[0])
        assert start.jerk == pytest.approx((ends[1] - ends[0]) / (2 * eps), rel=1e-6, abs=1e-6)


def test_constraint_levels_are_time_derivatives_and_their_force_the_transposed_jacobian():
    scene, eps, q = DrivenBead(), 1e-4, np.array([0.3, 0.1])
    jacobian = np.asarray(jax.jacfwd(lambda q: scene.constraint(q, 0.5))(q))
    force = form.constraint_force(scene, q, 0.5, np.array([1.7]))
    assert force == pytest.approx(jacobian.T @ [1.7], rel=1e-14)
    rng = np.random.default_rng(1)
    q, v, a = rng.normal(size=(3, 2))
    t = 0.6

    def levels(s):
        moved = q + s * v + s * s / 2 * a
        velocity = form.constraint_velocity(scene, moved, v, t)
        acceleration = form.constraint_acceleration(scene, moved, v, a, t)
        return scene.constraint(moved, t + s), velocity, acceleration

    levels = jax.jit(levels)
    _, velocity, acceleration = levels(0.0)

    def phi(s):
        return np.asarray(levels(s)[0])

    assert velocity == pytest.approx((phi(eps) - phi(-eps)) / (2 * eps), rel=1e-6)
    assert acceleration == pytest.approx((phi(eps) - 2 * phi(0) + phi(-eps)) / eps**2, rel=1e-5)


def test_mu_moves_positions_in_the_directions_of_the_constraints_at_its_time():
    """They turn with time, here by an eighth of a radian."""
    scene, t, mu = CarAxis(), 0.15, np.array([0.3, -0.7])
    q, at = scene.initial_state().q, form.dae_layout(scene.sizes, "stabilised_index2")
    w = np.zeros((2, at.size))
    w[:, at.q], w[1, at.mu] = q, mu
    residual = jax.jit(lambda w: form.dae_residual(scene, "stabilised_index2", t, w, 0 * w))
    change = np.asarray(residual(w[1]) - residual(w[0]))
    directions = np.asarray(jax.jacfwd(scene.constraint)(q, t)).T
    assert change[at.q] == pytest.approx(directions @ mu, abs=1e-14)
    assert not np.delete(change, at.q).any()


def test_every_dae_formulation_vanishes_on_the_motion():
    for scene in (Pendulum(), DrivenBead(), NonlinearFeedback()):
        for formulation in ["index3", "index2", "stabilised_index2", "index1"]:
            start, at = consistent_start(scene), form.dae_layout(scene.sizes, formulation)
            w, wdot = np.zeros(at.size), np.zeros(at.size)
            for name in ("q", "v", "x", "lam", "y"):
                w[getattr(at, name)] = getattr(start.z, name)
            wdot[at.q], wdot[at.v], wdot[at.x] = start.z.v, start.z.a, start.xdot

            def moved(s):
                return form.dae_residual(scene, formulation, start.z.t, w + s, wdot + 3.7 * s)

            both = jax.jit(lambda s: (moved(s), jax.jacfwd(moved)(s)))
            residual, jacobian = map(np.asarray, both(np.zeros(at.size)))
            assert residual.size == at.size
            assert np.abs(residual).max() < 1e-12 * max(1.0, np.abs(w).max(), np.abs(wdot).max())
            # ... and off it it does not: each row answers to some variable.
            assert (np.abs(jacobian).max(axis=1) > 0).all()


def test_an_inconsistent_start_is_refused_with_its_size_and_a_wrong_shape_is_named():
    for scene, level, amount in [
        (OffTheRod(), "position", r"1\.000e-03|1\.001e-03"),
        (Pendulum(radial=0.02), "velocity", r"2\.000e-02"),
    ]:
        with pytest.raises(InconsistentStart, match=f"{level} level by ({amount})"):
            consistent_start(scene)
    lopsided = toy("Lopsided", base=SpringMass, force=lambda self, q, v, t: jnp.zeros(2))
    with pytest.raises(ValueError, match=r"force has shape \(2,\), expected \(1,\)"):
        consistent_start(lopsided())
