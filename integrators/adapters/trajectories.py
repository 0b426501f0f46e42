"""Trajectories of solvers of other libraries.

Some solvers give q, v and x alone. The equations of motion then give the other variables.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

import numpy as np

from integrators.contract import Trajectory
from problems import sparse_initial_values
from problems.formulations import compiled, is_large
from problems.sparsity import NoPattern
from problems.system import MechatronicSystem, State, Variables

if TYPE_CHECKING:
    from jaxtyping import Float


def trajectory_from_states(
    scene: MechatronicSystem,
    t: Float[np.ndarray, " k"],
    q: Float[np.ndarray, "k nq"],
    v: Float[np.ndarray, "k nq"],
    x: Float[np.ndarray, "k nx"],
) -> Trajectory:
    """Solve the equations of motion for a, lam, y and xdot at k states (index 1).

    Parameters
    ----------
    scene
        Scene with its parameters.
    t, q, v, x
        Times in s and the states there.

    Returns
    -------
    A trajectory with status "ok" and no counts; its entries are NaN where there is no solution.
    """
    z, xdot = _solve(scene, t, q, v, x)
    return Trajectory(t, q, v, z.a, z.lam, x, xdot, z.y)


def early_end_message(t: float, t_end: float, reason: str, remedy: str) -> str:
    """The message of a run to t_end that ended at t (s); reason and remedy are clauses."""
    return f"Ended at t={t:.6g} s of {t_end:g} s: {reason}; {remedy}."


def _solve(
    scene: MechatronicSystem, t: np.ndarray, q: np.ndarray, v: np.ndarray, x: np.ndarray
) -> tuple[Variables, np.ndarray]:
    """All variables and xdot at k states, arrays ``(k, n)``."""
    if is_large(scene):  # many dense systems side by side would not fit into memory
        with contextlib.suppress(NoPattern):
            rows = [
                sparse_initial_values.start_of(scene, State(*state), time)[:2]
                for *state, time in zip(q, v, x, t, strict=True)
            ]
            variables, rates = zip(*rows, strict=True)
            return Variables(*map(np.array, zip(*variables, strict=True))), np.array(rates)
    return compiled(scene).complete(scene.parameters(), q, v, x, t)
