"""Trajectories of solvers of other libraries.

Some solvers give q, v and x alone. The equations of motion then give the other variables.
"""

from __future__ import annotations

import contextlib

import numpy as np

from integrators.contract import Trajectory
from problems.base.runtime import Float, jax
from problems.equations.compiled import compiled
from problems.equations.initial_values import sparse_complete
from problems.equations.sparsity import NoPattern, prefers_sparse
from problems.system import MechatronicSystem
from problems.variables import State


def trajectory_from_states(
    scene: MechatronicSystem,
    t: Float[np.ndarray, " k"],
    q: Float[np.ndarray, "k nq"],
    v: Float[np.ndarray, "k nq"],
    x: Float[np.ndarray, "k nx"],
) -> Trajectory:
    """Solve the equations of motion for a, lam, y and xdot at k states (index 1).

    It has the status "ok" and no counts; its entries are NaN where there is no solution.

    Parameters
    ----------
    scene
        Scene with its parameters.
    t, q, v, x
        Times in s and the states there.
    """
    found = None
    if prefers_sparse(scene):  # many dense systems side by side would not fit into memory
        with contextlib.suppress(NoPattern):
            rows = [
                sparse_complete(scene, State(*state), time)
                for *state, time in zip(q, v, x, t, strict=True)
            ]
            found = jax.tree.map(lambda *parts: np.array(parts), *rows)
    z, xdot = found or compiled(scene).complete(scene.parameters(), q, v, x, t)
    a, lam, y = (np.asarray(part) for part in (z.a, z.lam, z.y))
    return Trajectory(t, q, v, a, lam, x, np.asarray(xdot), y)


def early_end_message(t: float, t_end: float, reason: str, remedy: str) -> str:
    """The message of a run to t_end that ended at t (s); reason and remedy are clauses."""
    return f"Ended at t={t:.6g} s of {t_end:g} s: {reason}; {remedy}."
