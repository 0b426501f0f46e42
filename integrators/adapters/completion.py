"""Rows of a trajectory made from states: what a solver does not give, the equations do."""

from __future__ import annotations

import contextlib

import numpy as np

from problems.compiled import compiled
from problems.sparse_initial_values import sparse_complete
from problems.sparsity import NoPattern, prefers_sparse
from problems.system import MechatronicSystem, State, Variables


def rows_from_states(
    scene: MechatronicSystem, t: np.ndarray, q: np.ndarray, v: np.ndarray, x: np.ndarray
) -> dict[str, np.ndarray]:
    """Solve the equations of motion for a, lam, y and xdot at k given states.

    Returns
    -------
    dict
        t ``(k,)`` and q, v, a, lam, x, xdot, y, each ``(k, n)``; NaN where there is no solution.
    """
    z, xdot = _complete(scene, q, v, x, t)
    return {"t": t, "q": q, "v": v, "a": z.a, "lam": z.lam, "x": x, "xdot": xdot, "y": z.y}


def _complete(
    scene: MechatronicSystem, q: np.ndarray, v: np.ndarray, x: np.ndarray, t: np.ndarray
) -> tuple[Variables, np.ndarray]:
    if prefers_sparse(scene):  # many dense systems side by side would not fit into memory
        with contextlib.suppress(NoPattern):
            rows = [
                sparse_complete(scene, State(*state), time)
                for *state, time in zip(q, v, x, t, strict=True)
            ]
            variables, rates = zip(*rows, strict=True)
            return Variables(*map(np.array, zip(*variables, strict=True))), np.array(rates)
    return compiled(scene).complete(scene.parameters(), q, v, x, t)
