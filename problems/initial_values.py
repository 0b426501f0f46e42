"""Consistent initial values of a scene, checked and completed."""

from __future__ import annotations

import contextlib
from functools import cache
from typing import Any

import numpy as np

from problems import answers, sparsity
from problems.compiled import compiled
from problems.formulations import Start
from problems.redundant_start import least_start
from problems.runtime import jax
from problems.sparse_initial_values import sparse_start
from problems.system import MechatronicSystem, State

#: A start is consistent if its residuals, relative to the size of q or v, are below this.
CONSISTENCY_TOLERANCE = 1e-9
#: Accelerations solve their equations if the constraints' residual is below this part of them.
_SOLVED = 1e-6


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
    state = State(*answers.state(scene.initial_state()))
    _check_dimensions(scene, state)
    if scene.has("constraint"):
        _check_constraints(scene, state, t0)
    start = jax.tree.map(np.asarray, _completed(scene, state, t0))
    if scene.has("constraint") and not _solves(scene, start):
        start = jax.tree.map(np.asarray, least_start(scene, state, t0))
    if start is None or not _is_finite(start):
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
    return compiled(scene).start(scene.parameters(), *state, t)


def _check_constraints(scene: MechatronicSystem, state: State, t: float) -> None:
    position, velocity, _ = _levels(scene, state.q, state.v, 0 * state.q, t)
    for level, group, residual, values in (
        ("position", "q", position, state.q),
        ("velocity", "v", velocity, state.v),
    ):
        violation, scale = np.abs(residual).max(), max(1.0, np.abs(values).max())
        if not violation <= CONSISTENCY_TOLERANCE * scale:
            raise InconsistentStart(
                f"The initial {group} of {scene.spec} violates the constraints at {level} "
                f"level by {violation:.3e} (allowed: {CONSISTENCY_TOLERANCE * scale:.0e}); "
                f"correct the scene's initial_state or its parameters."
            )


def _check_dimensions(scene: MechatronicSystem, state: State) -> None:
    nq = len(state.q)
    mass, force = _block_shapes(scene.template(), nq)
    shapes = {"mass": (mass, (nq, nq)), "force": (force, (nq,))}
    if scene.has("output"):
        shapes["actuation"] = (np.shape(scene.actuation())[:1], (nq,))
    for block, (found, wanted) in shapes.items():
        if found != wanted:
            raise ValueError(f"{scene.spec}: {block} has shape {found}, expected {wanted}.")


@cache  # they are found by tracing, and every run asks for them
def _block_shapes(template: MechatronicSystem, nq: int) -> tuple[tuple, tuple]:
    q = np.zeros(nq)
    mass, force = jax.eval_shape(template.mass, q), jax.eval_shape(template.force, q, q, 0.0)
    return mass.shape, force.shape
