"""Mechanics of a scene at one state."""

from __future__ import annotations

from dataclasses import fields
from functools import cache
from typing import Any

import numpy as np

from problems import MechatronicSystem, jax, jnp
from problems.equations.constraints import constraint_acceleration, constraint_velocity


def rng():
    return np.random.default_rng(20)


def cross(a, b):
    return a[0] * b[1] - a[1] * b[0]


def options(scene):
    return {field.name: getattr(scene, field.name) for field in fields(scene)}


# ---- values at a state -----------------------------------------------------------------
def _of_motion(scene: MechatronicSystem, q: Any, v: Any, t: Any) -> dict[str, Any]:
    found = {"mass": scene.mass(q), "force": scene.force(q, v, t)}
    if scene.has("constraint"):
        found["jacobian"] = jax.jacfwd(scene.constraint)(q, t)
        found["rest"] = constraint_acceleration(scene, q, v, 0 * q, t)
    return found


def _of_all(scene: MechatronicSystem, q: Any, v: Any, t: Any) -> dict[str, Any]:
    found = _of_motion(scene, q, v, t)
    if scene.has("constraint"):
        found["constraint"] = scene.constraint(q, t)
        found["velocity"] = constraint_velocity(scene, q, v, t)
        found["moved"] = jax.jacfwd(scene.constraint, 1)(q, t)
    if hasattr(scene, "_kinetic_energy"):
        found["_kinetic_energy"] = scene._kinetic_energy(q, v)
        found["_potential_energy"] = scene._potential_energy(q)

    def energy(q, v):
        if scene.has("energy"):
            return scene.energy(q, v)
        return scene._kinetic_energy(q, v) + scene._potential_energy(q)

    if scene.has("energy") or hasattr(scene, "_kinetic_energy"):
        found["energy"], found["slopes"] = jax.value_and_grad(energy, (0, 1))(q, v)
    if scene.has("momentum"):
        found["momentum"] = scene.momentum(q, v)
    return found


@cache
def _program(template: MechatronicSystem) -> Any:
    return jax.jit(lambda p, *state: _of_all(template.with_parameters(p), *state))


class Measured:
    """Values of a scene's blocks at states, by one compiled program."""

    def __init__(self, scene: MechatronicSystem) -> None:
        self._scene = scene

    def __getattr__(self, name: str) -> Any:
        return getattr(self._scene, name)

    def at(self, q: Any, v: Any, t: float = 0.0) -> dict[str, Any]:
        scene = self._scene
        state = np.asarray(q, dtype=float), np.asarray(v, dtype=float), float(t)
        found = _program(scene.template())(scene.parameters(), *state)
        return jax.tree.map(np.asarray, found)

    def energy(self, q, v):
        return self.at(q, v)["energy"]

    def _kinetic_energy(self, q, v):
        return self.at(q, v)["_kinetic_energy"]

    def _potential_energy(self, q):
        return self.at(q, 0 * q)["_potential_energy"]

    def momentum(self, q, v):
        return self.at(q, v)["momentum"]

    def constraint(self, q, t):
        return self.at(q, 0 * q, t)["constraint"]

    def slopes(self, q, v):
        """Derivatives of the energy by q and v."""
        return self.at(q, v)["slopes"]


def solved(scene: MechatronicSystem | Measured, q: Any, v: Any, t: float = 0.0) -> tuple:
    """a and lam of the equations of motion at one state."""
    if isinstance(scene, Measured):
        found = scene.at(q, v, t)
    else:
        state = jnp.asarray(q, dtype=float), jnp.asarray(v, dtype=float), jnp.asarray(float(t))
        found = jax.tree.map(np.asarray, _of_motion(scene, *state))
    if "jacobian" not in found:
        return np.linalg.solve(found["mass"], found["force"]), np.zeros(0)
    jacobian, rest = found["jacobian"], found["rest"]
    augmented = np.block([[found["mass"], jacobian.T], [jacobian, np.zeros((len(rest),) * 2)]])
    right = np.concatenate([found["force"], -rest])
    return tuple(np.split(np.linalg.solve(augmented, right), [len(q)]))


def assembled(scene: Measured) -> None:
    """The scene's start satisfies its constraints."""
    q, v, _ = scene.initial_state()
    found = scene.at(q, v, scene.interval[0])
    assert np.abs(found["constraint"]).max() < 1e-12
    assert np.abs(found["velocity"]).max() < 1e-12 * max(1.0, np.abs(v).max())


def keeps_energy(scene: Measured, q: Any, v: Any, t: float, tolerance: float = 1e-11) -> None:
    """d/dt E = lam . Phi_t: only a constraint that time moves does work."""
    found = scene.at(q, v, t)
    assert np.abs(found["constraint"]).max() < 1e-12
    a, lam = solved(scene, q, v, t)
    by_q, by_v = found["slopes"]
    terms = np.concatenate([by_q * v, by_v * a, -lam * found["moved"]])
    assert abs(terms.sum()) < tolerance * np.abs(terms).sum()
