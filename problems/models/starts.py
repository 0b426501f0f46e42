"""Starts of models: initial values that are left out follow from the constraints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from problems import spec
from problems.runtime import Float, jax, jnp
from problems.system import MechatronicSystem
from problems.variables import State

#: Newton's method takes less than ten iterations, or does not converge.
_ITERATIONS = 50


def completed(
    scene: MechatronicSystem,
    q: Sequence[float] | Float[np.ndarray, " nq"],
    v: Sequence[float] | Float[np.ndarray, " nq"],
    open_q: Sequence[int],
    open_v: Sequence[int],
) -> State:
    """Return the start at which the entries left open satisfy the constraints Phi(q, t) = 0.

    Newton's method with the shortest corrections leads from ``q`` to the nearest position; open
    velocities get the shortest correction by which d/dt Phi = 0. Where there is no solution the
    start violates the constraints, and `violation` tells by how much.

    Parameters
    ----------
    q, v
        Values of the entries that are given, and first guesses of the open ones.
    open_q, open_v
        Indices of the open entries.
    """
    q, v = np.array(q, dtype=float), np.array(v, dtype=float)
    if not scene.has("constraint"):
        return State(q, v)
    for _ in range(_ITERATIONS):
        phi, jacobian, _ = _position(scene, q)
        step = _shortest(jacobian[:, open_q], phi)
        q[open_q] -= step
        if not np.abs(step).max(initial=0.0) > 1e-15 * np.abs(q).max():
            break
    _, jacobian, rate = _position(scene, q)
    v[open_v] -= _shortest(jacobian[:, open_v], jacobian @ v + rate)
    return State(q, v)


def violation(scene: MechatronicSystem, state: State) -> tuple[float, float]:
    """Return the largest entries of Phi and of d/dt Phi at the start of a scene's interval."""
    if not scene.has("constraint"):
        return 0.0, 0.0
    phi, jacobian, rate = _position(scene, state.q)
    return np.abs(phi).max(), np.abs(jacobian @ state.v + rate).max()


def _shortest(matrix: np.ndarray, residual: np.ndarray) -> np.ndarray:
    if not (matrix.size and np.isfinite(matrix).all() and np.isfinite(residual).all()):
        return np.zeros(matrix.shape[1])
    return np.linalg.lstsq(matrix, residual, rcond=None)[0]


def _position(scene: MechatronicSystem, q: np.ndarray) -> tuple[np.ndarray, ...]:
    """Phi ``(nl,)``, Phi_q ``(nl, nq)`` and the partial derivative of Phi by time ``(nl,)``."""
    numbers = spec.numbers_of(type(scene))
    defaults: dict[str, Any] = {name: field.default for name, field in numbers.items()}
    program = _program(scene.with_parameters(defaults))
    return tuple(map(np.asarray, program(scene.parameters(), q, scene.interval[0])))


@cache  # not `problems.compiled`, which asks for the sizes, that is, for the start
def _program(template: MechatronicSystem) -> Callable[..., Any]:
    def position(p: dict[str, Any], q: Any, t: Any) -> Any:
        scene, now = template.with_parameters(p), jnp.asarray(t, dtype=float)
        phi, rate = jax.jvp(lambda t: scene.constraint(q, t), (now,), (jnp.ones_like(now),))
        return phi, jax.jacfwd(lambda q: scene.constraint(q, now))(q), rate

    return jax.jit(position)
