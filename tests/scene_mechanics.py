"""Mechanics of a scene at one state, and scenes with a flipped sign, for tests of identities."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from problems import MechatronicSystem, formulations, jax, jnp


def rng():
    return np.random.default_rng(20)


def cross(a, b):
    return a[0] * b[1] - a[1] * b[0]


def solved(scene, q, v, t=0.0):
    """a and lam of the equations of motion at one state.

    Not the compiled functions of the project: compiling each of a hundred mutants takes minutes.
    """
    q, v, t = jnp.asarray(q, dtype=float), jnp.asarray(v, dtype=float), jnp.asarray(float(t))
    m, g = np.asarray(scene.mass(q)), np.asarray(scene.force(q, v, t))
    if not scene.has("constraint"):
        return np.linalg.solve(m, g), np.zeros(0)
    jacobian = np.asarray(jax.jacfwd(scene.constraint)(q, t))
    rest = np.asarray(formulations.constraint_acceleration(scene, q, v, 0 * q, t))
    corner = np.zeros((len(rest), len(rest)))
    augmented = np.block([[m, jacobian.T], [jacobian, corner]])
    return np.split(np.linalg.solve(augmented, np.concatenate([g, -rest])), [len(q)])


def assembled(scene):
    """The scene's start satisfies its constraints."""
    q, v, _ = scene.initial_state()
    t = scene.interval[0]
    assert np.abs(np.asarray(scene.constraint(q, t))).max() < 1e-12
    rate = np.asarray(formulations.constraint_velocity(scene, q, v, t))
    assert np.abs(rate).max() < 1e-12 * max(1.0, np.abs(v).max())


def options(scene):
    return {field.name: getattr(scene, field.name) for field in fields(scene)}


def flipped(scene: MechatronicSystem, block: str, what: str) -> MechatronicSystem:
    """The scene with a sign error in one of its blocks.

    ``what`` is a parameter, or q0, q1, ... or v0, v1, ... for an entry of the first or second
    argument: wherever the block uses it, it uses its negative.
    """
    right = getattr(type(scene), block)

    def wrong(self, *given):
        if hasattr(self, what):
            return right(self.with_parameters({what: -getattr(self, what)}), *given)
        place, entry = "qv".index(what[0]), int(what[1:])
        sign = np.ones(len(given[place]))
        sign[entry] = -1.0
        parts = [part * sign if k == place else part for k, part in enumerate(given)]
        return right(self, *parts)

    return type("Flipped", (type(scene),), {block: wrong})(**options(scene))


def keeps_energy(scene, q, v, t, tolerance=1e-11):
    """d/dt E = lam . Phi_t: only a constraint that time moves does work."""
    assert np.abs(np.asarray(scene.constraint(q, t))).max() < 1e-12
    a, lam = solved(scene, q, v, t)

    def energy(q, v):
        return (
            scene.energy(q, v)
            if scene.has("energy")
            else scene.kinetic_energy(q, v) + scene.potential_energy(q)
        )

    by_q, by_v = jax.grad(energy, (0, 1))(q, v)
    moved = np.asarray(jax.jacfwd(scene.constraint, 1)(q, float(t)))
    terms = np.concatenate([by_q * v, by_v * a, -lam * moved])
    assert abs(terms.sum()) < tolerance * np.abs(terms).sum()
