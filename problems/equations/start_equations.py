"""Initial values by matrices outside of JAX: sparse ones of large scenes, and singular ones.

Redundant constraints make the matrix singular, as their multipliers are not unique; least squares
take its place then. Both ways solve the index-1 equations for u = [a, lam, y] by Newton's method;
one more solve with the last matrix gives the derivative of u along the motion.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from problems.base.runtime import FEW_CALLS, Array, Float, jax, jnp
from problems.equations.constraints import constraint_change
from problems.equations.formulations import Start, algebraic_residual
from problems.equations.kinematics import q_rate
from problems.equations.layouts import algebraic_layout
from problems.equations.sparsity import Pattern
from problems.system import MechatronicSystem
from problems.variables import State, Variables

_TOLERANCE, _MOST_ITERATIONS = 1e-9, 50
#: Pivots of sparse factors that are smaller, relative to the largest, are rounding.
_SMALLEST_PIVOT = 1e-14
#: Singular values and residuals below this part of the largest one are zero.
_ZERO = 1e-10
#: Beyond this condition of the constraints' derivatives, lines of size one, no digit is left.
_REGULAR = 1e-13
#: Most coordinates of a scene whose constraints are examined by a full matrix.
_MOST_COORDINATES = 1000


def sparse_start(scene: MechatronicSystem, state: State, t: float) -> Start:
    """Compute `formulations.with_rates` and the constrained part of the jerk.

    The latter is None for a scene without constraints; a and the jerk are NaN where there is no
    solution.
    """
    equations, (nv, nl) = _equations(scene.template(), True), (scene.sizes.nv, scene.sizes.nl)
    z, xdot, factors = _complete(scene, state, t, equations)
    start = _with_rates(scene, z, xdot, equations, factors)
    if factors is None or not nl:
        return start
    augmented = factors.matrix[: nv + nl, : nv + nl]  # [[M, Phi_q^T], [Phi_q, 0]]
    if scene.sizes.ny:  # it stands beside the outputs
        factors = _sparse_factors(augmented)
    along = augmented[nv:, :nv] @ np.asarray(start.jerk)
    right = np.concatenate([np.zeros(nv), along])
    part = factors.solve(right)[:nv] if factors else np.full(nv, np.nan)
    return start._replace(constrained_jerk=jnp.asarray(part))


def sparse_complete(
    scene: MechatronicSystem, state: State, t: float
) -> tuple[Variables, Float[Array, " nx"]]:
    """Compute `formulations.complete` by Newton's method, one factorisation per iteration.

    a is NaN where there is no solution.
    """
    return _complete(scene, state, t, _equations(scene.template(), True))[:2]


def least_start(scene: MechatronicSystem, state: State, t: float) -> Start:
    """Compute a start with the least multipliers, where a and y are unique although lam is not.

    At time t (s); a is NaN if there are none, or more than one a or y.
    """
    equations = _equations(scene.template(), False)
    z, xdot, factors = _complete(scene, state, t, equations)
    if factors:
        u, matrix = np.concatenate([z.a, z.lam, z.y]), factors.matrix
        rest = np.abs(equations.residual(scene.parameters(), u, *state, t)).max()
        _, sizes, directions = np.linalg.svd(matrix)
        free = directions[sizes <= _ZERO * sizes[0]]
        other = np.delete(free, algebraic_layout(scene.sizes).lam, axis=1)
        solved = rest <= _ZERO * (1.0 + np.abs(matrix).max() * np.abs(u).max())
        if not solved or np.abs(other).max(initial=0.0) > 1e-6:
            z, factors = z._replace(a=jnp.full_like(z.a, jnp.nan)), None
    return _with_rates(scene, z, xdot, equations, factors)


def missing_rank(scene: MechatronicSystem, q: np.ndarray, t: float) -> int:
    """The number of constraints that depend on the others at q and t (s).

    Scenes of more than 1000 coordinates are not examined, as it would take minutes: 0 is returned.
    """
    if not scene.sizes.nl or scene.sizes.nq > _MOST_COORDINATES:
        return 0
    rows = np.asarray(_rows(scene.template())(scene.parameters(), q, t))
    sizes = np.linalg.norm(rows, axis=1, keepdims=True)
    unit = np.divide(rows, sizes, out=np.zeros_like(rows), where=sizes > 0)
    if not np.isfinite(unit).all():
        return 0
    return scene.sizes.nl - int((np.linalg.svd(unit, compute_uv=False) > _REGULAR).sum())


@cache
def _rows(template: MechatronicSystem) -> Callable:
    """The compiled derivatives of the constraints along velocities."""
    still = np.zeros(template.sizes.nv)

    def rows(p: Any, q: Any, t: Any) -> Any:
        scene = template.with_parameters(p)
        return jax.jacfwd(lambda w: constraint_change(scene, q, jnp.asarray(t), w))(still)

    return jax.jit(rows, compiler_options=FEW_CALLS)


# ---- Newton's method -------------------------------------------------------------------
class _Equations(NamedTuple):
    """Compiled parts of the index-1 equations for u = [a, lam, y].

    ``pattern``
        pattern of their matrix; None for a full one
    ``residual(p, u, q, v, x, t)``, ``jacobian(p, u, q, v, x, t)``
        residual ``(n,)``, and its Jacobian by u: the entries in the order of the pattern
    ``drift(p, z, xdot)``
        derivative of the residual by time at constant u, ``(n,)``
    """

    pattern: Pattern | None
    residual: Callable[..., Array]
    jacobian: Callable[..., Array]
    drift: Callable[..., Array]


class _Factors(NamedTuple):
    """A matrix, and the function that solves equations with it."""

    matrix: Any
    solve: Callable[[np.ndarray], np.ndarray]


@cache
def _equations(template: MechatronicSystem, sparse: bool) -> _Equations:
    def at(p: Mapping, *state: Array) -> Callable[[Array], Array]:
        return lambda u: algebraic_residual(template.with_parameters(p), u, *state)

    def jacobian(p: Mapping, u: Array, *state: Array) -> Array:
        function = at(p, *state)
        return pattern.values(function, u) if pattern else jax.jacfwd(function)(u)

    def drift(p: Mapping, z: Variables, xdot: Array) -> Array:
        u, scene = jnp.concatenate([z.a, z.lam, z.y]), template.with_parameters(p)
        rates = q_rate(scene, z.q, z.v), z.a, xdot, jnp.ones_like(z.t)
        return jax.jvp(lambda *state: at(p, *state)(u), (z.q, z.v, z.x, z.t), rates)[1]

    pattern = None
    if sparse:
        start = map(jnp.asarray, (*template.initial_state(), template.interval[0]))
        function = at(template.parameters(), *start)
        pattern = Pattern(function, algebraic_layout(template.sizes).size)
    return _Equations(
        pattern,
        residual=jax.jit(lambda p, u, *state: at(p, *state)(u)),
        jacobian=jax.jit(jacobian),
        drift=jax.jit(drift),
    )


def _complete(
    scene: MechatronicSystem, state: State, t: float, equations: _Equations
) -> tuple[Variables, Float[Array, " nx"], _Factors | None]:
    """Variables, xdot, and the last factors; without a solution a is NaN, and there are none."""
    sizes = scene.sizes
    u, factors = _newton(scene, (*state, t), equations)
    a, lam, y = algebraic_layout(sizes).split(u)
    z = Variables(*map(jnp.asarray, (state.q, state.v, a, lam, state.x, y, t)))
    if factors is None:
        return z._replace(a=jnp.full_like(z.a, jnp.nan)), jnp.zeros(sizes.nx), None
    return z, scene.state_rate(z) if sizes.nx else jnp.zeros(0), factors


def _newton(
    scene: MechatronicSystem, known: tuple, equations: _Equations
) -> tuple[Float[np.ndarray, " n"], _Factors | None]:
    """The unknowns u at known (q, v, x, t) and the last factors, none if it does not converge."""
    p, u = scene.parameters(), np.zeros(algebraic_layout(scene.sizes).size)
    for _ in range(_MOST_ITERATIONS):
        jacobian = np.asarray(equations.jacobian(p, u, *known))
        residual = np.asarray(equations.residual(p, u, *known))
        pattern = equations.pattern
        factors = _sparse_factors(pattern.matrix(jacobian)) if pattern else _least(jacobian)
        if factors is None or not np.isfinite(residual).all():
            return u, None
        du = factors.solve(residual)
        u = u - du
        if not scene.sizes.ny or np.abs(du).max() <= _TOLERANCE * (1e-3 + np.abs(u).max()):
            return u, factors
    return u, None


def _with_rates(
    scene: MechatronicSystem,
    z: Variables,
    xdot: Array,
    equations: _Equations,
    factors: _Factors | None,
) -> Start:
    """The start with the derivatives of these variables; without factors they are a and zero."""
    if factors is None:
        return Start(z, xdot, z.a, 0 * xdot)
    change = -factors.solve(np.asarray(equations.drift(scene.parameters(), z, xdot)))
    jerk, dlam, dy = map(jnp.asarray, algebraic_layout(scene.sizes).split(change))
    xddot = xdot
    if scene.sizes.nx:
        q_change = q_rate(scene, z.q, z.v)
        rates = Variables(q_change, z.a, jerk, dlam, xdot, dy, jnp.ones_like(z.t))
        xddot = jax.jvp(scene.state_rate, (z,), (rates,))[1]
    return Start(z, xdot, jerk, xddot)


def _sparse_factors(matrix: Any) -> _Factors | None:
    """LU factors of a sparse matrix; None if it is singular."""
    from scipy.sparse.linalg import splu

    try:
        factors = splu(matrix)
    except RuntimeError:  # exactly singular
        return None
    pivots = np.abs(factors.U.diagonal())
    if not pivots.min() > _SMALLEST_PIVOT * pivots.max():
        return None
    return _Factors(matrix, factors.solve)


def _least(matrix: np.ndarray) -> _Factors | None:
    """Least squares with a matrix that may be singular; None if it is not finite."""
    if not np.isfinite(matrix).all():
        return None
    return _Factors(matrix, lambda right: np.linalg.lstsq(matrix, right, _ZERO)[0])
