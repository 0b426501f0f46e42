"""Rows of a trajectory made from states: what a solver does not give, the equations do."""

from __future__ import annotations

import numpy as np

from problems.formulations import compiled
from problems.system import MechatronicSystem


def rows_from_states(
    scene: MechatronicSystem, t: np.ndarray, q: np.ndarray, v: np.ndarray, x: np.ndarray
) -> dict[str, np.ndarray]:
    """Solve the equations of motion for a, lam, y and xdot at k given states.

    Returns
    -------
    dict
        t ``(k,)`` and q, v, a, lam, x, xdot, y, each ``(k, n)``; NaN where there is no solution.
    """
    z, xdot = compiled(scene).complete(scene.parameters(), q, v, x, t)
    return {"t": t, "q": q, "v": v, "a": z.a, "lam": z.lam, "x": x, "xdot": xdot, "y": z.y}
