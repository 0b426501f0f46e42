"""Condition of the index-3 tangent, for the scalings of its rows and columns."""

from __future__ import annotations

import numpy as np

from bench.running.worker import Worker
from problems.formulations import constraint_force
from problems.initial_values import consistent_start
from problems.runtime import jax, jnp
from problems.spec import SpecError
from problems.system import MechatronicSystem

#: beta of the trapezoidal rule; the powers of h do not depend on it.
_BETA = 0.25


def condition(scene: MechatronicSystem, h: float, scaling: str) -> float:
    """Return the condition number of Newton's tangent in (q, lam) at a scene's start.

    With q'' = q/(beta h^2) + ... the tangent is [[M/(beta h^2), Phi_q^T], [Phi_q, 0]]; terms that
    vanish with h are left out. After Bottasso, Dopico & Trainelli (2008), On the optimal scaling
    of index three DAEs in multibody dynamics.

    Parameters
    ----------
    scene
        A scene with constraints.
    h
        Step size in s.
    scaling
        Divided by 1/(beta h^2) are: "none" of the rows and columns, the constraint "rows", or
        "both" these and the columns of the multipliers.

    Raises
    ------
    SpecError
        If there is no such scaling.
    """
    if scaling not in ("none", "rows", "both"):
        raise SpecError(f"There is no scaling {scaling!r}; there are none, rows and both.")
    z = consistent_start(scene).z
    mass = np.asarray(scene.mass(z.q))
    zero = jnp.zeros(len(z.lam))
    columns = np.asarray(jax.jacfwd(lambda lam: constraint_force(scene, z.q, z.t, lam))(zero))
    factor = 1 / (_BETA * h * h)
    rows = columns.T * (factor if scaling != "none" else 1.0)
    columns = columns * (factor if scaling == "both" else 1.0)
    nothing = np.zeros((len(z.lam), len(z.lam)))
    return float(np.linalg.cond(np.block([[mass * factor, columns], [rows, nothing]])))


def conditions(worker: Worker, problem: str, steps: tuple[float, ...], scaling: str) -> list[float]:
    """Do a job of a worker: the condition number at the start of a scene, for each step in s."""
    return [condition(worker.problem(problem), h, scaling) for h in steps]
