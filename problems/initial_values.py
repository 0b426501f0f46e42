"""Consistent initial values of a scene, checked and completed."""

from __future__ import annotations

import contextlib
from functools import cache

import numpy as np

from problems import answers, sparsity
from problems.compiled import compiled
from problems.formulations import Start
from problems.runtime import jax
from problems.sparse_initial_values import sparse_start
from problems.system import MechatronicSystem, State

#: A start is consistent if its residuals, relative to the size of q or v, are below this.
CONSISTENCY_TOLERANCE = 1e-9


class InconsistentStart(ValueError):
    """The initial q or v violates the constraints; the message says by how much."""


class NoConsistentStart(ValueError):
    """No finite initial a, lam, y exist, or Newton's method did not find them."""


def consistent_start(scene: MechatronicSystem) -> Start:
    """Check q and v of the initial state, and compute a, lam, y and the derivatives.

    Returns
    -------
    Start
        NumPy arrays, at ``scene.interval[0]``.

    Raises
    ------
    InconsistentStart
        If Phi or d/dt Phi is not zero at the given q, v (relative tolerance 1e-9).
    NoConsistentStart
        If a, lam, y do not exist: singular equations or no convergence.
    ValueError
        If an array has a wrong shape.
    """
    t0 = scene.interval[0]
    state = State(*answers.state(scene.initial_state()))
    _check_dimensions(scene, state)
    if scene.has("constraint"):
        _check_constraints(scene, state, t0)
    start: Start = jax.tree.map(np.asarray, _completed(scene, state, t0))
    if not all(np.isfinite(part).all() for part in start.z):
        raise NoConsistentStart(
            f"{scene.spec} has no finite initial a, lam, y at t={t0:g}: the augmented mass matrix "
            f"is singular there, or its outputs have no solution near zero."
        )
    return start


def _completed(scene: MechatronicSystem, state: State, t: float) -> Start:
    if sparsity.prefers_sparse(scene):
        with contextlib.suppress(sparsity.NoPattern):
            return sparse_start(scene, state, t)
    return compiled(scene).start(scene.parameters(), *state, t)


def _check_constraints(scene: MechatronicSystem, state: State, t: float) -> None:
    one = [part[None] for part in (state.q, state.v, 0 * state.q, np.asarray(t))]
    position, velocity, _ = compiled(scene).levels(scene.parameters(), *one)
    for level, group, residual, values in (
        ("position", "q", position, state.q),
        ("velocity", "v", velocity, state.v),
    ):
        violation, scale = np.abs(residual[0]).max(), max(1.0, np.abs(values).max())
        if not violation <= CONSISTENCY_TOLERANCE * scale:
            raise InconsistentStart(
                f"The initial {group} of {scene.spec} violates the constraints at {level} "
                f"level by {violation:.3e} (allowed: {CONSISTENCY_TOLERANCE * scale:.0e}); "
                f"correct the scene's initial_state or its parameters."
            )


def _check_dimensions(scene: MechatronicSystem, state: State) -> None:
    nq = len(state.q)
    mass, force = _block_shapes(scene.template(), nq)
    shapes = {
        "v": (np.shape(state.v), (nq,)),
        "mass": (mass, (nq, nq)),
        "force": (force, (nq,)),
    }
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
