"""Consistent initial values of a scene, or of many at once, checked and completed."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from problems.base import checks
from problems.base.runtime import Float, jax
from problems.equations import sparsity
from problems.equations.compiled import compiled
from problems.equations.formulations import Start
from problems.equations.start_equations import least_start, sparse_start
from problems.system import MechatronicSystem
from problems.variables import State

#: A start is consistent if its residuals, relative to the size of q or v, are below this.
CONSISTENCY_TOLERANCE = 1e-9
#: Accelerations solve their equations if the constraints' residual is below this part of them.
_SOLVED = 1e-6
#: A million roundings: a motion that is smaller, relative to what moves it, is rounding.
STILL = 1e6 * float(np.finfo(float).eps)


class InconsistentStart(ValueError):
    """The initial q or v violates the constraints; the message says by how much."""


class NoConsistentStart(ValueError):
    """No finite initial a, lam, y exist, or Newton's method did not find them."""


def consistent_start(scene: MechatronicSystem) -> Start:
    """Check q and v of the initial state, and compute a, lam, y and the derivatives.

    Of the multipliers of redundant constraints the least ones are taken.

    Returns
    -------
    Start
        NumPy arrays, at ``scene.interval[0]``.

    Raises
    ------
    InconsistentStart
        If Phi or d/dt Phi is not zero at the given q, v (relative tolerance 1e-9).
    NoConsistentStart
        If there are no a, lam, y, or more than one a or y; or Newton's method does not converge.
    ValueError
        If an array has a wrong shape.
    """
    t0 = scene.interval[0]
    state = scene.start()
    _check_dimensions(scene, state)
    check_constraints(scene, state)
    start = jax.tree.map(np.asarray, _completed(scene, state, t0))
    if scene.sizes.nl and not _solves(scene, start):
        start = jax.tree.map(np.asarray, least_start(scene, state, t0))
    if not _is_finite(start):
        raise NoConsistentStart(
            f"{scene.spec} has no finite initial a, lam, y at t={t0:g}: the augmented mass matrix "
            f"is singular there, or its outputs have no solution near zero."
        )
    return start


def _is_finite(start: Start) -> bool:
    return all(np.isfinite(part).all() for part in start.z)


def _solves(scene: MechatronicSystem, start: Start) -> bool:
    """Whether accelerations keep the constraints; those from an almost singular matrix do not."""
    z = start.z
    if not _is_finite(start):
        return False
    *_, violation = _levels(scene, z.q, z.v, z.a, z.t)
    return np.abs(violation).max() <= _SOLVED * (1.0 + np.abs(z.a).max() + np.abs(z.v).max() ** 2)


def _levels(scene: MechatronicSystem, *values: Any) -> list[np.ndarray]:
    """Residuals of the constraints and of their two derivatives at q, v, a and t."""
    one = [np.asarray(part)[None] for part in values]
    return [level[0] for level in compiled(scene).levels(scene.parameters(), *one)]


def _completed(scene: MechatronicSystem, state: State, t: float) -> Start:
    if sparsity.prefers_sparse(scene):
        with contextlib.suppress(sparsity.NoPattern):
            return sparse_start(scene, state, t)
    return compiled(scene).linearised(scene.parameters(), *state, t)[0]


def check_constraints(scene: MechatronicSystem, state: State) -> None:
    """Raise `InconsistentStart` if a state at the start violates the constraints."""
    if not scene.sizes.nl:
        return
    position, velocity, _ = _levels(scene, state.q, state.v, 0 * state.v, scene.interval[0])
    for level, group, residual, values in (
        ("position", "q", position, state.q),
        ("velocity", "v", velocity, state.v),
    ):
        violation, scale = np.abs(residual).max(initial=0.0), max(1.0, np.abs(values).max())
        if not violation <= CONSISTENCY_TOLERANCE * scale:
            equation = scene.components("lam")[int(np.argmax(np.abs(residual)))].name
            raise InconsistentStart(
                f"The initial {group} of {scene.spec} violates the constraints at {level} "
                f"level by {violation:.3e} (allowed: {CONSISTENCY_TOLERANCE * scale:.0e}), the "
                f"most in equation {equation}; correct the scene's initial_state or its parameters."
            )


def _check_dimensions(scene: MechatronicSystem, state: State) -> None:
    nq, nv = len(state.q), len(state.v)
    found = _block_shapes(scene.template(), nq, nv)
    wanted = {"mass": (nv, nv), "force": (nv,), "kinematics": (nq,), "move": (nq,)}
    shapes = {block: (shape, wanted[block]) for block, shape in found.items()}
    if scene.has("output"):
        shapes["actuation"] = (np.shape(scene.actuation_at(state.q))[:1], (nv,))
    for block, (found, wanted) in shapes.items():
        if found != wanted:
            raise ValueError(f"{scene.spec}: {block} has shape {found}, expected {wanted}.")


@cache  # they are found by tracing, and every run asks for them
def _block_shapes(template: MechatronicSystem, nq: int, nv: int) -> dict[str, tuple]:
    q, v = np.zeros(nq), np.zeros(nv)
    given = {"mass": (q,), "force": (q, v, 0.0), "kinematics": (q, v), "move": (q, v)}
    return {
        block: jax.eval_shape(getattr(template, block), *arguments).shape
        for block, arguments in given.items()
        if template.has(block)
    }


def rests(scene: MechatronicSystem, t: Float[np.ndarray, " k"]) -> bool:
    """Whether a scene stays where it starts, but for `STILL` of what moves it elsewhere.

    It has no velocity then, and at all times no rates of its states and no accelerations: these are
    measured by those at states in which one entry of q or v is larger by 1, because forces in
    balance leave their rounding, or that of a file. Where values jump it is not known.

    Parameters
    ----------
    t
        Times in s, the first that of the start.
    """
    start: Any = scene.start()
    q, v, x = start
    if scene.is_hybrid or not np.abs(v).max(initial=0.0) * np.ptp(t) <= STILL:
        return False

    def rates(q: Any, v: Any, t: Any) -> tuple[np.ndarray, np.ndarray]:
        rows = np.broadcast_to(x, (len(t), len(x)))
        z, xdot = compiled(scene).complete(scene.parameters(), q, v, rows, t)
        return np.asarray(z.a), np.asarray(xdot)

    moved = np.concatenate([q, v]) + np.eye(1 + len(q) + len(v), len(q) + len(v), -1)
    a, xdot = rates(moved[:, : len(q)], moved[:, len(q) :], np.full(len(moved), t[0]))
    changes = np.linalg.norm(a[1:] - a[0], axis=1)
    size = changes[np.isfinite(changes)].max(initial=0.0)

    def still(a: np.ndarray, xdot: np.ndarray) -> bool:
        sizes = np.maximum(1.0, np.abs(x))
        drifts = np.abs(xdot) * np.ptp(t) <= STILL * sizes
        return bool((np.linalg.norm(a, axis=1) <= STILL * size).all() and drifts.all())

    if not still(a[:1], xdot[:1]):
        return False
    q, v = (np.broadcast_to(part, (len(t), len(part))) for part in (q, v))
    return still(*rates(q, v, t))


# ---- many scenes of one kind ------------------------------------------------------------
def consistent_starts(scenes: Sequence[MechatronicSystem]) -> tuple[Start, dict[int, str]]:
    """Compute `consistent_start` of k scenes that differ in float parameters alone.

    One compiled call serves all of them; separate calls would take milliseconds each. A scene
    whose residual is not small, or whose values are not finite, is computed again alone, so that
    the decision and the message are those of a single run.

    Returns
    -------
    Start
        NumPy arrays with an axis of length k in front; NaN where there is no start.
        ``constrained_jerk`` is None.
    dict
        Indices of the scenes that have no consistent start, each with the reason.
    """
    count, functions = len(scenes), compiled(scenes[0])
    given = [(scene.parameters(), *scene.start()) for scene in scenes]
    p, q, v, x = jax.tree.map(lambda *rows: np.array(rows, dtype=float), *given)
    t = np.full(count, float(scenes[0].interval[0]))
    start = functions.starts(p, q, v, x, t)
    violation = np.zeros(count)
    if scenes[0].sizes.nl:
        levels = functions.levels(p, q, v, np.zeros_like(v), t)
        for residual, of in zip(levels, (q, v), strict=False):
            scale = np.maximum(1.0, np.abs(of).max(axis=1))
            largest = np.abs(residual).max(axis=1, initial=0.0)
            violation = np.maximum(violation, largest / scale)
    numbers = np.column_stack([part.reshape(count, -1) for part in jax.tree.leaves(start)])
    # Another program rounds differently: scenes near the limit are computed alone, too.
    good = np.isfinite(numbers).all(axis=1) & (violation <= 0.5 * CONSISTENCY_TOLERANCE)
    refused: dict[int, str] = {}
    for k in np.flatnonzero(~good).tolist():
        try:
            alone = consistent_start(scenes[k])._replace(constrained_jerk=None)
        except (InconsistentStart, NoConsistentStart, checks.FalseAnswer) as error:
            refused[k] = str(error)
            continue
        for table, row in zip(jax.tree.leaves(start), jax.tree.leaves(alone), strict=True):
            table[k] = row
    return start, refused
