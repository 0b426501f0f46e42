"""Starts of models: initial values that are left out follow from the constraints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from problems import spec
from problems.kinematics import q_rate
from problems.runtime import Float, jax, jnp
from problems.system import MechatronicSystem
from problems.variables import State

#: Newton's method takes less than ten iterations, or does not converge.
_ITERATIONS = 50


def completed(
    scene: MechatronicSystem,
    q: Sequence[float] | Float[np.ndarray, " nq"],
    v: Sequence[float] | Float[np.ndarray, " nv"],
    open_q: Sequence[int],
    open_v: Sequence[int],
) -> State:
    """Return the start at which the entries left open satisfy the constraints.

    Newton's method with the shortest corrections leads from ``q`` to the nearest position at which
    Phi(q, t) = 0; open velocities get the shortest correction by which d/dt Phi = 0 and A v = b.
    Where there is no solution the start violates the constraints, and `violation` tells by how
    much.

    Parameters
    ----------
    q, v
        Values of the entries that are given, and first guesses of the open ones.
    open_q, open_v
        Indices of the open entries.
    """
    q, v = np.array(q, dtype=float), np.array(v, dtype=float)
    if scene.has("constraint"):
        for _ in range(_ITERATIONS):
            phi, jacobian, *_ = constraints_at(scene, q, v)
            step = _shortest(jacobian[:, open_q], phi)
            q[open_q] -= step
            if not np.abs(step).max(initial=0.0) > 1e-15 * np.abs(q).max():
                break
    _, _, rate, rows = constraints_at(scene, q, v)
    v[open_v] -= _shortest(rows[:, open_v], rate)
    return State(q, v)


def violation(scene: MechatronicSystem, state: State) -> tuple[float, float]:
    """Return the largest entries of Phi, and of d/dt Phi and A v - b, at the start."""
    phi, _, rate, _ = constraints_at(scene, state.q, state.v)
    return np.abs(phi).max(initial=0.0), np.abs(rate).max(initial=0.0)


def constraints_at(
    scene: MechatronicSystem, q: Float[np.ndarray, " nq"], v: Float[np.ndarray, " nv"]
) -> tuple[np.ndarray, ...]:
    """Compute the constraints at the start of the interval.

    Returns
    -------
    tuple
        Phi ``(nh,)``, its derivative by q ``(nh, nq)``, d/dt Phi and A v - b ``(nl,)``, and their
        derivative by v ``(nl, nv)``.
    """
    if not (scene.has("constraint") or scene.has("velocity_constraint")):
        return np.zeros(0), np.zeros((0, len(q))), np.zeros(0), np.zeros((0, len(v)))
    numbers = spec.numbers_of(type(scene))
    defaults: dict[str, Any] = {name: field.default for name, field in numbers.items()}
    program = _program(scene.with_parameters(defaults))
    return tuple(map(np.asarray, program(scene.parameters(), q, v, scene.interval[0])))


def _shortest(matrix: np.ndarray, residual: np.ndarray) -> np.ndarray:
    if not (matrix.size and np.isfinite(matrix).all() and np.isfinite(residual).all()):
        return np.zeros(matrix.shape[1])
    return np.linalg.lstsq(matrix, residual, rcond=None)[0]


@cache  # not `problems.compiled`, which asks for the sizes, that is, for the start
def _program(template: MechatronicSystem) -> Callable[..., Any]:
    def constraints(p: dict[str, Any], q: Any, v: Any, t: Any) -> Any:
        scene, now = template.with_parameters(p), jnp.asarray(t, dtype=float)
        positions = scene.constraint if scene.has("constraint") else lambda q, t: jnp.zeros(0)

        def rates(v: Any) -> Any:
            moving = q_rate(scene, q, v), jnp.ones_like(now)
            rate = jax.jvp(positions, (q, now), moving)[1]
            if not scene.has("velocity_constraint"):
                return rate
            return jnp.concatenate([rate, scene.velocity_constraint(q, v, now)])

        of_q = jax.jacfwd(lambda q: positions(q, now))(q)
        return positions(q, now), of_q, rates(v), jax.jacfwd(rates)(v)

    return jax.jit(constraints)
