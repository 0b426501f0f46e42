"""Starts of scenes: initial values that are left out follow from the constraints."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from problems.base import spec
from problems.base.runtime import Float, jax, jnp
from problems.variables import Component, State

#: Newton's method takes less than ten iterations, or does not converge.
_ITERATIONS = 50
#: A start is consistent if its residuals, relative to the size of q or v, are below this.
CONSISTENCY_TOLERANCE = 1e-9
#: Singular values below this part of the largest are of dependent constraints.
_DEPENDENT = 1e-10


def started(scene: Any, state: State, given: Mapping[str, float]) -> State:
    """Return the start of a scene at which some coordinates or velocities have other values.

    Parameters
    ----------
    scene
        A `problems.system.MechatronicSystem`.
    state
        Its own start.
    given
        Values by "name" of a coordinate or "name.v" of a velocity; a blank may be written as "_".
        Quaternions are normalised, all others that constraints bind are `completed`.

    Raises
    ------
    SpecError
        If there is no such name, or no such position satisfies the constraints.
    """
    own = scene.velocities if scene.has("kinematics") else scene.coordinates
    names = _names(scene.coordinates, len(state.q)), _names(own, len(state.v))
    places = {n: (0, k) for k, n in enumerate(names[0])}
    places |= {f"{n}.v": (1, k) for k, n in enumerate(names[1])}
    written = {name.replace(" ", "_"): name for name in places}
    values, fixed = (np.array(state.q), np.array(state.v)), ([], [])
    for name, value in given.items():
        key = written.get(name.replace(" ", "_"))
        if key is None:
            raise spec.SpecError(
                f"{scene.name} has no coordinate to start from {name!r}; "
                f"{spec.suggest(name, places)}."
            )
        group, k = places[key]
        values[group][k] = value
        fixed[group].append(k)
    q, v = values
    for k in range(len(q) - 3):
        four = range(k, k + 4)
        if [names[0][j][-2:] for j in four] == ["p0", "p1", "p2", "p3"]:
            q[four] /= np.linalg.norm(q[four]) or 1.0
            fixed[0].extend(four if scene.has("kinematics") else ())  # no constraint holds the norm
    free_q, free_v = (
        [k for k in range(len(part)) if k not in own]
        for part, own in zip(values, fixed, strict=True)
    )
    found = completed(scene, q, v, free_q, free_v)._replace(x=state.x)
    off = violation(scene, found)
    if not all(part <= CONSISTENCY_TOLERANCE for part in off):
        told = ", ".join(f"{name}={value:g}" for name, value in given.items())
        raise spec.SpecError(
            f"{scene.name} has no start near its own with {told}: its constraints are violated by "
            f"{max(off):.2g}; give other values, or values of more coordinates."
        )
    return found


def _names(texts: Iterable[str], count: int) -> list[str]:
    """Names of all entries of a group; numbers where the scene gives none."""
    named = [Component.read(str(text)).name for text in texts][:count]
    return named + [str(k + 1) for k in range(len(named), count)]


def completed(
    scene: Any,
    q: Sequence[float] | Float[np.ndarray, " nq"],
    v: Sequence[float] | Float[np.ndarray, " nv"],
    open_q: Sequence[int] | np.ndarray,
    open_v: Sequence[int] | np.ndarray,
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
    q, v, t = np.array(q, dtype=float), np.array(v, dtype=float), scene.interval[0]

    def rows(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        phi, jacobian, *_ = constraints_at(scene, q, v, t)
        return phi, jacobian[:, open_q]

    def moved(q: np.ndarray, step: np.ndarray) -> np.ndarray:
        q[open_q] += step
        return q

    if scene.has("constraint"):
        q = closed(rows, moved, q)
    _, _, rate, along = constraints_at(scene, q, v, t)
    v[open_v] -= shortest(along[:, open_v], rate)
    return State(q, v)


def closed(
    rows: Callable[[Any], tuple[np.ndarray, np.ndarray]],
    moved: Callable[[Any, np.ndarray], Any],
    q: Any,
) -> np.ndarray:
    """Return the nearest place that satisfies constraints, by Newton's method.

    Parameters
    ----------
    rows
        Residuals at a place, and their derivative by displacements.
    moved
        The place after a displacement.
    """
    for _ in range(_ITERATIONS):
        residual, jacobian = rows(q)
        step = shortest(jacobian, residual)
        q = moved(q, -step)
        if not np.abs(step).max(initial=0.0) > 1e-15 * np.abs(q).max():
            break
    return np.asarray(q)


def violation(scene: Any, state: State) -> list[float]:
    """Return the largest entries of Phi, relative to those of q or to 1, and of d/dt Phi and
    A v - b, relative to those of v or to 1, at the start."""
    phi, _, rate, _ = constraints_at(scene, state.q, state.v, scene.interval[0])
    parts = (phi, state.q), (rate, state.v)
    return [np.abs(r).max(initial=0.0) / max(1.0, np.abs(of).max()) for r, of in parts]


def constraints_at(
    scene: Any, q: Float[np.ndarray, " nq"], v: Float[np.ndarray, " nv"], t: float
) -> tuple[np.ndarray, ...]:
    """Compute the constraints at t in s.

    Returns
    -------
    tuple
        Phi ``(nh,)``, its derivative by q ``(nh, nq)``, d/dt Phi and A v - b ``(nl,)``, and their
        derivative by v ``(nl, nv)``.
    """
    if not (scene.has("constraint") or scene.has("velocity_constraint")):
        return np.zeros(0), np.zeros((0, len(q))), np.zeros(0), np.zeros((0, len(v)))
    found = _program(scene.with_defaults())(scene.parameters(), q, v, t)
    return tuple(map(np.asarray, found))


def shortest(matrix: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Return the least solution of linear equations, perhaps dependent ones."""
    if not (matrix.size and np.isfinite(matrix).all() and np.isfinite(residual).all()):
        return np.zeros(matrix.shape[1])
    return np.linalg.lstsq(matrix, residual, rcond=_DEPENDENT)[0]


@cache  # not `problems.equations.compiled`, which asks for the sizes, that is, for the start
def _program(template: Any) -> Callable[..., Any]:
    def constraints(p: dict[str, Any], q: Any, v: Any, t: Any) -> Any:
        scene, now = template.with_parameters(p), jnp.asarray(t, dtype=float)
        positions = scene.constraint if scene.has("constraint") else lambda q, t: jnp.zeros(0)
        turns = scene.has("kinematics")

        def rates(v: Any) -> Any:
            moving = (scene.kinematics(q, v) if turns else v), jnp.ones_like(now)
            rate = jax.jvp(positions, (q, now), moving)[1]
            if not scene.has("velocity_constraint"):
                return rate
            return jnp.concatenate([rate, scene.velocity_constraint(q, v, now)])

        of_q = jax.jacfwd(lambda q: positions(q, now))(q)
        return positions(q, now), of_q, rates(v), jax.jacfwd(rates)(v)

    return jax.jit(constraints)
