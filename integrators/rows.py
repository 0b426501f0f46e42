"""Rows of a trajectory made from states: what a solver does not give, the equations do."""

from __future__ import annotations

import numpy as np

from integrators.contract import FIRST_ROWS, SPREAD_ROWS
from problems.formulations import compiled
from problems.system import MechatronicSystem

#: Rows are padded to a multiple of this, so that one compiled function serves runs of any length.
_SLOTS = FIRST_ROWS + SPREAD_ROWS + 8


def rows_from_states(
    scene: MechatronicSystem, t: np.ndarray, q: np.ndarray, v: np.ndarray, x: np.ndarray
) -> dict[str, np.ndarray]:
    """Solve the equations of motion for a, lam, y and xdot at k given states.

    Returns
    -------
    dict
        t ``(k,)`` and q, v, a, lam, x, xdot, y, each ``(k, n)``; NaN where there is no solution.
    """
    k = len(t)
    fill = -k % _SLOTS

    def padded(rows: np.ndarray) -> np.ndarray:
        return np.concatenate([rows, np.repeat(rows[-1:], fill, axis=0)])

    given = [padded(np.asarray(rows, dtype=float)) for rows in (q, v, x, t)]
    z, xdot = compiled(scene)["complete"](scene.parameters(), *given)
    solved = {"a": z.a, "lam": z.lam, "y": z.y, "xdot": xdot}
    # To NumPy first: a slice of a JAX array is compiled anew for every length.
    return {"t": t, "q": q, "v": v, "x": x} | {
        name: np.asarray(rows)[:k] for name, rows in solved.items()
    }
