"""Consistent starts of large scenes, by sparse linear algebra."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from problems.formulations import (
    algebraic_residual,
    constraint_force,
    inertia,
)
from problems.runtime import jax, jnp
from problems.sparsity import Pattern
from problems.system import MechatronicSystem, State, Variables

_TOLERANCE, _MOST = 1e-9, 50
#: Pivots that are smaller, relative to the largest, are rounding.
_SMALLEST_PIVOT = 1e-14


def start_of(scene: MechatronicSystem, state: State, t: float) -> tuple:
    """(Variables, xdot, jerk, xddot) as `formulations.with_rates`, NaN where there is no solution.

    One sparse factorisation per Newton iteration on the index-1 equations, and one more solve for
    their derivative along the motion.
    """
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import splu

    sizes, p = scene.sizes, scene.parameters()
    pattern, residual, values, total = _functions(scene.template())
    u = np.zeros(pattern.size)
    solve = None
    for _ in range(_MOST):
        entries = np.asarray(values(p, u, *state, t))
        matrix = csc_matrix((entries, (pattern.rows, pattern.columns)), shape=2 * (len(u),))
        try:
            factors = splu(matrix)
        except RuntimeError:  # exactly singular
            break
        pivots = np.abs(factors.U.diagonal())
        if not pivots.min() > _SMALLEST_PIVOT * pivots.max():
            solve = None
            break
        solve = factors.solve
        du = solve(np.asarray(residual(p, u, *state, t)))
        u = u - du
        if not sizes.ny or np.abs(du).max() <= _TOLERANCE * (1e-3 + np.abs(u).max()):
            break
    else:
        solve = None
    a, lam, y = np.split(u, [sizes.nq, sizes.nq + sizes.nl])
    z = Variables(*state[:2], a, lam, state.x, y, np.asarray(t))
    if solve is None:
        nothing = np.full(sizes.nq, np.nan)
        return z._replace(a=nothing), np.zeros(sizes.nx), nothing, np.zeros(sizes.nx)
    xdot = np.asarray(scene.state_rate(z)) if sizes.nx else np.zeros(0)
    change = -solve(np.asarray(total(p, u, *state, t, xdot)))
    jerk, dlam, dy = np.split(change, [sizes.nq, sizes.nq + sizes.nl])
    xddot = np.zeros(0)
    if sizes.nx:
        along = Variables(state.v, a, jerk, dlam, xdot, dy, np.ones_like(z.t))
        xddot = np.asarray(jax.jvp(scene.state_rate, (z,), (along,))[1])
    return z, xdot, jerk, xddot


def projected(scene: MechatronicSystem, q: np.ndarray, t: float, w: np.ndarray) -> np.ndarray:
    """`formulations.constrained_part` of w."""
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import splu

    nq, nl = scene.sizes.nq, scene.sizes.nl

    def augmented(u: Any) -> Any:
        along = jax.jvp(lambda q: scene.constraint(q, t), (q,), (u[:nq],))[1]
        return jnp.concatenate(
            [inertia(scene, q, u[:nq]) + constraint_force(scene, q, t, u[nq:]), along]
        )

    pattern = Pattern(augmented, nq + nl)
    entries = np.asarray(pattern.values(augmented, jnp.zeros(nq + nl)))
    matrix = csc_matrix((entries, (pattern.rows, pattern.columns)), shape=2 * (nq + nl,))
    right = np.array(augmented(jnp.concatenate([w, jnp.zeros(nl)])))
    right[:nq] = 0.0
    return splu(matrix).solve(right)[:nq]


@cache
def _functions(template: MechatronicSystem) -> tuple:
    """Pattern, residual, its values, and its derivative along the motion, compiled."""

    def at(p: dict, *state: Any) -> Any:
        return lambda u: algebraic_residual(template.with_parameters(p), u, *state)

    def total(p: dict, u: Any, q: Any, v: Any, x: Any, t: Any, xdot: Any) -> Any:
        scene, a = template.with_parameters(p), u[: template.sizes.nq]
        return jax.jvp(
            lambda q, v, x, t: algebraic_residual(scene, u, q, v, x, t),
            (q, v, x, t),
            (v, a, xdot, jnp.ones_like(t)),
        )[1]

    start = template.initial_state()
    pattern = Pattern(
        at(template.parameters(), *map(jnp.asarray, start), jnp.asarray(template.interval[0])),
        template.sizes.nq + template.sizes.nl + template.sizes.ny,
    )
    residual = jax.jit(lambda p, u, *state: at(p, *state)(u))
    values = jax.jit(lambda p, u, *state: pattern.values(at(p, *state), u))
    return pattern, residual, values, jax.jit(total)
