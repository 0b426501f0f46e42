"""Consistent initial values of a scene, checked and completed.

Compiled equations give them. Where constraints depend on each other multipliers are not unique, and
the least ones are taken; large scenes take sparse factors, outside of JAX.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np

from problems.base.runtime import Array, Float, jax, jnp
from problems.equations import sparsity
from problems.equations.compiled import compiled
from problems.equations.formulations import Start, algebraic_residual
from problems.equations.kinematics import q_rate
from problems.starts import CONSISTENCY_TOLERANCE, constraints_at
from problems.system import MechatronicSystem
from problems.variables import State, Variables, algebraic_layout

#: Accelerations solve their equations if the constraints' residual is below this part of them.
_SOLVED = 1e-6
#: A million roundings: a motion that is smaller, relative to what moves it, is rounding.
STILL = 1e6 * float(np.finfo(float).eps)
#: Newton's method of sparse starts: the last relative change, and most iterations.
_TOLERANCE, _MOST_ITERATIONS = 1e-9, 50
#: Pivots of sparse factors that are smaller, relative to the largest, are rounding.
_SMALLEST_PIVOT = 1e-14
#: Beyond this condition of the constraints' derivatives, lines of size one, no digit is left.
_REGULAR = 1e-13
#: Most coordinates of a scene whose constraints are examined by a full matrix.
_MOST_COORDINATES = 1000


class InconsistentStart(ValueError):
    """The initial q or v violates the constraints; the message says by how much."""


class NoConsistentStart(ValueError):
    """No finite initial a, lam, y exist, or Newton's method did not find them."""


def consistent_start(scene: MechatronicSystem) -> Start:
    """Check q and v of the initial state, and compute a, lam, y and the derivatives.

    Of the multipliers of redundant constraints the least ones are taken.

    Returns
    -------
    Start
        NumPy arrays, at ``scene.interval[0]``.

    Raises
    ------
    InconsistentStart
        If Phi or d/dt Phi is not zero at the given q, v (relative tolerance 1e-9).
    NoConsistentStart
        If there are no a, lam, y, or more than one a or y; or Newton's method does not converge.
    ValueError
        If an array has a wrong shape.
    """
    t0, state, start = scene.interval[0], scene.start(), None
    if fault := _fault_of_shapes(scene.template()):
        raise ValueError(f"{scene.spec}: {fault}")
    check_constraints(scene, state)
    if sparsity.prefers_sparse(scene):
        with contextlib.suppress(sparsity.NoPattern):
            start = sparse_start(scene, state, t0)
    if start is None:
        start = _dense_start(scene, state, t0)
    if not _solves(scene, start) and scene.sizes.nl:
        cls = type(scene) if scene.redundant else _sharing(type(scene))
        start = _dense_start(scene.with_parameters({}, cls), state, t0)
    if not _solves(scene, start):
        raise NoConsistentStart(
            f"{scene.spec} has no finite initial a, lam, y at t={t0:g}: the augmented mass matrix "
            f"is singular there, or its outputs have no solution near zero."
        )
    return jax.tree.map(np.asarray, start)


def _dense_start(scene: MechatronicSystem, state: State, t: float) -> Start:
    return compiled(scene).linearised(scene.parameters(), *state, t)[0]


@cache
def _sharing(cls: type[MechatronicSystem]) -> type[MechatronicSystem]:
    """The same scene, whose constraints may depend on each other: they share forces."""
    return type(cls.__name__, (cls,), {"redundant": 1, "name": cls.name})


def _solves(scene: MechatronicSystem, start: Start) -> bool:
    """Whether all is finite, and accelerations keep the constraints; those from an almost singular
    matrix do not."""
    z = start.z
    if not all(np.isfinite(part).all() for part in z):
        return False
    if not scene.sizes.nl:
        return True
    *_, violation = _levels(scene, z.q, z.v, z.a, z.t)
    return np.abs(violation).max() <= _SOLVED * (1.0 + np.abs(z.a).max() + np.abs(z.v).max() ** 2)


def _levels(scene: MechatronicSystem, *values: Any) -> list[np.ndarray]:
    """Residuals of the constraints and of their two derivatives at q, v, a and t."""
    one = [np.asarray(part)[None] for part in values]
    return [level[0] for level in compiled(scene).levels(scene.parameters(), *one)]


def check_constraints(scene: MechatronicSystem, state: State) -> None:
    """Raise `InconsistentStart` if a state at the start violates the constraints."""
    if not scene.sizes.nl:
        return
    position, velocity, _ = _levels(scene, state.q, state.v, 0 * state.v, scene.interval[0])
    for level, group, residual, values in (
        ("position", "q", position, state.q),
        ("velocity", "v", velocity, state.v),
    ):
        violation, scale = np.abs(residual).max(initial=0.0), max(1.0, np.abs(values).max())
        if not violation <= CONSISTENCY_TOLERANCE * scale:
            equation = scene.components("lam")[int(np.argmax(np.abs(residual)))].name
            raise InconsistentStart(
                f"The initial {group} of {scene.spec} violates the constraints at {level} "
                f"level by {violation:.3e} (allowed: {CONSISTENCY_TOLERANCE * scale:.0e}), the "
                f"most in equation {equation}; correct the scene's initial_state or its parameters."
            )


def missing_rank(scene: MechatronicSystem, q: np.ndarray, t: float) -> int:
    """The number of constraints that depend on the others at q and t (s).

    Scenes of more than 1000 coordinates are not examined, as it would take minutes: 0 is returned.
    """
    if not scene.sizes.nl or scene.sizes.nq > _MOST_COORDINATES:
        return 0
    rows = constraints_at(scene, q, np.zeros(scene.sizes.nv), t)[3]
    sizes = np.linalg.norm(rows, axis=1, keepdims=True)
    unit = np.divide(rows, sizes, out=np.zeros_like(rows), where=sizes > 0)
    if not np.isfinite(unit).all():
        return 0
    return scene.sizes.nl - int((np.linalg.svd(unit, compute_uv=False) > _REGULAR).sum())


@cache  # it is found by tracing, and every run asks for it
def _fault_of_shapes(template: MechatronicSystem) -> str:
    """The sentence on the first block that has a wrong shape, or nothing."""
    nq, nv, *_ = template.sizes
    q, v = np.zeros(nq), np.zeros(nv)
    wanted = {"mass": (nv, nv), "force": (nv,), "kinematics": (nq,), "move": (nq,)}
    at = {"mass": (q,), "force": (q, v, 0.0), "kinematics": (q, v), "move": (q, v)}
    for block in filter(template.has, wanted):
        found = jax.eval_shape(getattr(template, block), *at[block]).shape
        if found != wanted[block]:
            return f"{block} has shape {found}, expected {wanted[block]}."
    return ""


# ---- large scenes ----------------------------------------------------------------------
def sparse_start(scene: MechatronicSystem, state: State, t: float) -> Start:
    """Compute the start of `formulations.linearised` and the constrained part of the jerk.

    The latter is None for a scene without constraints; a and the jerk are NaN where there is no
    solution.
    """
    z, xdot, matrix, factors = sparse_complete(scene, state, t)
    if factors is None:
        return Start(z, xdot, z.a, 0 * xdot)
    (nv, nl), drift = (scene.sizes.nv, scene.sizes.nl), _equations(scene.template())[2]
    change = -factors.solve(np.asarray(drift(scene.parameters(), z, xdot)))
    jerk, dlam, dy = algebraic_layout(scene.sizes).split(change)
    xddot, part = xdot, None
    if scene.sizes.nx:
        rates = Variables(q_rate(scene, z.q, z.v), z.a, jerk, dlam, xdot, dy, jnp.ones_like(z.t))
        xddot = jax.jvp(scene.state_rate, (z,), (jax.tree.map(jnp.asarray, rates),))[1]
    if nl:
        augmented = matrix[: nv + nl, : nv + nl]  # [[M, Phi_q^T], [Phi_q, 0]]
        if scene.sizes.ny:  # it stands beside the outputs
            factors = _factors(augmented)
        right = np.concatenate([np.zeros(nv), augmented[nv:, :nv] @ jerk])
        part = jnp.asarray(factors.solve(right)[:nv] if factors else np.full(nv, np.nan))
    return Start(z, xdot, jnp.asarray(jerk), xddot, part)


def sparse_complete(
    scene: MechatronicSystem, state: State, t: float
) -> tuple[Variables, Float[Array, " nx"], Any, Any]:
    """Compute `formulations.complete` by Newton's method, one factorisation per iteration.

    Returns
    -------
    tuple
        All variables, xdot, the last matrix of the index-1 equations and its factors; a is NaN and
        the factors are None where there is no solution.
    """
    sizes, p = scene.sizes, scene.parameters()
    layout, (pattern, system, _) = algebraic_layout(sizes), _equations(scene.template())
    u, matrix, factors = np.zeros(layout.size), None, None
    for _ in range(_MOST_ITERATIONS):
        entries, residual = map(np.asarray, system(p, u, *state, t))
        matrix = pattern.matrix(entries)
        factors = _factors(matrix) if np.isfinite(residual).all() else None
        if factors is None:
            break
        du = factors.solve(residual)
        u = u - du
        if not sizes.ny or np.abs(du).max() <= _TOLERANCE * (1e-3 + np.abs(u).max()):
            break
    else:
        factors = None
    a, lam, y = layout.split(u if factors else np.where(np.arange(len(u)) < sizes.nv, np.nan, u))
    z = Variables(*map(jnp.asarray, (state.q, state.v, a, lam, state.x, y, t)))
    xdot = scene.state_rate(z) if sizes.nx and factors else jnp.zeros(sizes.nx)
    return z, xdot, matrix, factors


@cache
def _equations(template: MechatronicSystem) -> tuple[sparsity.Pattern, Callable, Callable]:
    """The index-1 equations for u = [a, lam, y]: the pattern of their matrix; its entries and the
    residual ``(n,)`` of (p, u, q, v, x, t); the derivative of the residual by time at constant u
    ``(n,)``, of (p, z, xdot)."""

    def at(p: Mapping, *state: Array) -> Callable[[Array], Array]:
        return lambda u: algebraic_residual(template.with_parameters(p), u, *state)

    def system(p: Mapping, u: Array, *state: Array) -> tuple[Array, Array]:
        function = at(p, *state)
        return pattern.values(function, u), function(u)

    def drift(p: Mapping, z: Variables, xdot: Array) -> Array:
        u, scene = jnp.concatenate([z.a, z.lam, z.y]), template.with_parameters(p)
        rates = q_rate(scene, z.q, z.v), z.a, xdot, jnp.ones_like(z.t)
        return jax.jvp(lambda *state: at(p, *state)(u), (z.q, z.v, z.x, z.t), rates)[1]

    start = map(jnp.asarray, (*template.initial_state(), template.interval[0]))
    function = at(template.parameters(), *start)
    pattern = sparsity.Pattern(function, algebraic_layout(template.sizes).size)
    return pattern, jax.jit(system), jax.jit(drift)


def _factors(matrix: Any) -> Any:
    """LU factors of a sparse matrix; None if it is singular."""
    from scipy.sparse.linalg import splu

    try:
        factors = splu(matrix)
    except RuntimeError:  # exactly singular
        return None
    pivots = np.abs(factors.U.diagonal())
    return factors if pivots.min() > _SMALLEST_PIVOT * pivots.max() else None


def rests(scene: MechatronicSystem, t: Float[np.ndarray, " k"]) -> bool:
    """Whether a scene stays where it starts, but for `STILL` of what moves it elsewhere.

    It has no velocity then, and at all times no rates of its states and no accelerations: these are
    measured by those at states in which one entry of q or v is larger by 1, because forces in
    balance leave their rounding, or that of a file. Where values jump it is not known.

    Parameters
    ----------
    t
        Times in s, the first that of the start.
    """
    q, v, x = map(np.asarray, scene.start())
    if scene.is_hybrid or not np.abs(v).max(initial=0.0) * np.ptp(t) <= STILL:
        return False
    # Rows at all times, then those in which one entry is larger.
    rows = np.concatenate([np.zeros((len(t), len(q) + len(v))), np.eye(len(q) + len(v))])
    rows, times = np.concatenate([q, v]) + rows, np.append(t, np.full(len(rows) - len(t), t[0]))
    states = rows[:, : len(q)], rows[:, len(q) :], np.broadcast_to(x, (len(rows), len(x)))
    z, xdot = compiled(scene).complete(scene.parameters(), *states, times)
    a, drifts = np.asarray(z.a), np.abs(np.asarray(xdot)[: len(t)]) * np.ptp(t)
    changes = np.linalg.norm(a[len(t) :] - a[0], axis=1)
    size = changes[np.isfinite(changes)].max(initial=0.0)
    rests = np.linalg.norm(a[: len(t)], axis=1) <= STILL * size
    return bool(rests.all() and (drifts <= STILL * np.maximum(1.0, np.abs(x))).all())
