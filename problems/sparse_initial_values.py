"""Initial values of scenes with many unknowns, by sparse linear algebra."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from problems.formulations import Start, algebraic_residual, constraint_force, inertia
from problems.kinematics import q_rate
from problems.layouts import algebraic_layout
from problems.runtime import jax, jnp
from problems.sparsity import Pattern
from problems.system import MechatronicSystem, State, Variables

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Float
    from scipy.sparse.linalg import SuperLU

_TOLERANCE, _MOST_ITERATIONS = 1e-9, 50
#: Pivots that are smaller, relative to the largest, are rounding.
_SMALLEST_PIVOT = 1e-14


def sparse_start(scene: MechatronicSystem, state: State, t: float) -> Start:
    """Compute `formulations.with_rates` and the constrained part of the jerk.

    The derivatives along the motion take one more solve with the last matrix of `sparse_complete`.

    Returns
    -------
    Start
        ``constrained_jerk`` is None for a scene without constraints; a and the jerk are NaN where
        there is no solution.

    Raises
    ------
    problems.sparsity.NoPattern
        If the pattern of the equations cannot be found.
    """
    z, xdot, factors = _complete(scene, state, t)
    sizes, p = scene.sizes, scene.parameters()
    if factors is None:
        return Start(z, xdot, z.a, jnp.zeros(sizes.nx))
    programs = _programs(scene.template())
    change = -factors.solve(np.asarray(programs.drift(p, z, xdot)))
    jerk, dlam, dy = (jnp.asarray(part) for part in algebraic_layout(sizes).split(change))
    xddot = jnp.zeros(0)
    if sizes.nx:
        rates = Variables(z.v, z.a, jerk, dlam, xdot, dy, jnp.ones_like(z.t))
        xddot = jax.jvp(scene.state_rate, (z,), (rates,))[1]
    if not sizes.nl:
        return Start(z, xdot, jerk, xddot)
    if sizes.ny:
        return Start(z, xdot, jerk, xddot, projected(scene, z.q, t, jerk))
    # Without outputs the matrix is [[M, Phi_q^T], [Phi_q, 0]], that of the projection.
    right = np.concatenate([np.zeros(sizes.nv), programs.constraint_change(p, z, jerk)])
    return Start(z, xdot, jerk, xddot, jnp.asarray(factors.solve(right)[: sizes.nv]))


def sparse_complete(
    scene: MechatronicSystem, state: State, t: float
) -> tuple[Variables, Float[Array, " nx"]]:
    """Compute `formulations.complete` by Newton's method, one factorisation per iteration.

    Returns
    -------
    Variables, Array
        The variables and xdot ``(nx,)``; a is NaN where there is no solution.

    Raises
    ------
    problems.sparsity.NoPattern
        If the pattern of the equations cannot be found.
    """
    return _complete(scene, state, t)[:2]


def _complete(
    scene: MechatronicSystem, state: State, t: float
) -> tuple[Variables, Float[Array, " nx"], SuperLU | None]:
    """Variables, xdot, and the last factors; None where there is no solution."""
    sizes, p = scene.sizes, scene.parameters()
    programs = _programs(scene.template())
    u, factors = np.zeros(programs.pattern.size), None
    for _ in range(_MOST_ITERATIONS):
        entries = np.asarray(programs.entries(p, u, *state, t))
        factors = _factorised(programs.pattern, entries)
        if factors is None:
            break
        du = factors.solve(np.asarray(programs.residual(p, u, *state, t)))
        u = u - du
        if not sizes.ny or np.abs(du).max() <= _TOLERANCE * (1e-3 + np.abs(u).max()):
            break
    else:
        factors = None
    a, lam, y = algebraic_layout(sizes).split(u)
    z = Variables(*map(jnp.asarray, (state.q, state.v, a, lam, state.x, y, t)))
    if factors is None:
        return z._replace(a=jnp.full(sizes.nv, jnp.nan)), jnp.zeros(sizes.nx), None
    return z, scene.state_rate(z) if sizes.nx else jnp.zeros(0), factors


def _factorised(pattern: Pattern, entries: np.ndarray) -> SuperLU | None:
    """LU factors of the matrix with these entries; None if it is singular."""
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import splu

    shape = (pattern.size, pattern.size)
    try:
        factors = splu(csc_matrix((entries, (pattern.rows, pattern.columns)), shape=shape))
    except RuntimeError:  # exactly singular
        return None
    pivots = np.abs(factors.U.diagonal())
    return factors if pivots.min() > _SMALLEST_PIVOT * pivots.max() else None


def projected(
    scene: MechatronicSystem, q: Float[Array, " nq"], t: float, w: Float[Array, " nv"]
) -> Float[Array, " nv"]:
    """Compute `projections.constrained_part` of w; NaN where the augmented matrix is singular."""
    nv, nl, now = scene.sizes.nv, scene.sizes.nl, jnp.asarray(t)

    def augmented(u: Array) -> Array:
        along = jax.jvp(lambda q: scene.constraint(q, now), (q,), (q_rate(scene, q, u[:nv]),))[1]
        return jnp.concatenate(
            [inertia(scene, q, u[:nv]) + constraint_force(scene, q, now, u[nv:]), along]
        )

    pattern = Pattern(augmented, nv + nl)
    factors = _factorised(pattern, np.asarray(pattern.values(augmented, jnp.zeros(nv + nl))))
    if factors is None:
        return jnp.full(nv, jnp.nan)
    right = np.array(augmented(jnp.concatenate([w, jnp.zeros(nl)])))
    right[:nv] = 0.0
    return jnp.asarray(factors.solve(right)[:nv])


class _Programs(NamedTuple):
    """Compiled parts of the index-1 equations for u = [a, lam, y], and the pattern of their matrix.

    ``residual(p, u, q, v, x, t)``, ``entries(p, u, q, v, x, t)``
        residual ``(n,)``, and the entries of its Jacobian by u in the order of the pattern
    ``drift(p, z, xdot)``
        derivative of the residual by time at constant u, ``(n,)``
    ``constraint_change(p, z, w)``
        Phi_q w, ``(nl,)``
    """

    pattern: Pattern
    residual: Callable[..., Array]
    entries: Callable[..., Array]
    drift: Callable[..., Array]
    constraint_change: Callable[..., Array]


@cache
def _programs(template: MechatronicSystem) -> _Programs:
    sizes = template.sizes

    def at(p: Mapping, *state: Array) -> Callable[[Array], Array]:
        return lambda u: algebraic_residual(template.with_parameters(p), u, *state)

    def drift(p: Mapping, z: Variables, xdot: Array) -> Array:
        u = jnp.concatenate([z.a, z.lam, z.y])
        return jax.jvp(
            lambda q, v, x, t: at(p, q, v, x, t)(u),
            (z.q, z.v, z.x, z.t),
            (z.v, z.a, xdot, jnp.ones_like(z.t)),
        )[1]

    def constraint_change(p: Mapping, z: Variables, w: Array) -> Array:
        scene = template.with_parameters(p)
        return jax.jvp(lambda q: scene.constraint(q, z.t), (z.q,), (w,))[1]

    start = map(jnp.asarray, (*template.initial_state(), template.interval[0]))
    pattern = Pattern(at(template.parameters(), *start), algebraic_layout(sizes).size)
    return _Programs(
        pattern,
        residual=jax.jit(lambda p, u, *state: at(p, *state)(u)),
        entries=jax.jit(lambda p, u, *state: pattern.values(at(p, *state), u)),
        drift=jax.jit(drift),
        constraint_change=jax.jit(constraint_change),
    )
