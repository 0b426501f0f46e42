"""Initial values of scenes whose constraints are redundant: multipliers are not unique there."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from problems.exported_programs import exported
from problems.formulations import Start, algebraic_residual
from problems.kinematics import q_rate
from problems.layouts import algebraic_layout
from problems.runtime import jax, jnp
from problems.system import MechatronicSystem, State, Variables

#: Singular values and residuals below this part of the largest one are zero.
_ZERO = 1e-10
_MOST_ITERATIONS = 20
#: Beyond this condition of the constraints' derivatives, lines of size one, no digit is left.
_REGULAR = 1e-13
#: Most coordinates of a scene whose constraints are examined by a full matrix.
_MOST_COORDINATES = 1000


def least_start(scene: MechatronicSystem, state: State, t: float) -> Start | None:
    """Compute a start with the least multipliers, where a and y are unique although lam is not.

    Returns
    -------
    Start or None
        Values at time t (s); None if there are none, or more than one a or y.
    """
    layout = algebraic_layout(scene.sizes)
    equations, tangent, derivatives = _functions(scene.template())
    p, known = scene.parameters(), (*state, np.asarray(t, float))
    u = np.zeros(layout.size)
    for _ in range(_MOST_ITERATIONS):
        matrix, (residual, xdot) = np.asarray(tangent(p, u, *known)), equations(p, u, *known)
        if not (np.isfinite(matrix).all() and np.isfinite(residual).all()):
            return None
        if np.abs(residual).max() <= _ZERO * (1.0 + np.abs(matrix).max() * np.abs(u).max()):
            break
        u = u - np.linalg.lstsq(matrix, np.asarray(residual), _ZERO)[0]
    else:
        return None
    _, sizes, directions = np.linalg.svd(matrix)
    free = directions[sizes <= _ZERO * sizes[0]]
    if np.abs(np.delete(free, layout.lam, axis=1)).max(initial=0.0) > 1e-6:
        return None
    a, lam, y = layout.split(u)
    # The residual stays zero along the motion, so that its derivative gives that of u.
    motion = q_rate(scene, *map(jnp.asarray, state[:2])), a, np.asarray(xdot), np.ones(())
    rest, _ = derivatives(p, (u, *known), (0 * u, *motion))
    rate = np.linalg.lstsq(matrix, -np.asarray(rest), _ZERO)[0]
    _, xddot = derivatives(p, (u, *known), (rate, *motion))
    z = Variables(*map(jnp.asarray, (state.q, state.v, a, lam, state.x, y, t)))
    return Start(z, xdot, jnp.asarray(rate[layout.a]), xddot)


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
    """The compiled derivatives of the constraints by q."""

    def rows(p: Any, q: Any, t: Any) -> Any:
        return jax.jacfwd(lambda q: template.with_parameters(p).constraint(q, t))(q)

    return exported(lambda: rows, lambda: ("rows of the constraints", template))


@cache
def _functions(template: MechatronicSystem) -> tuple[Callable, Callable, Callable]:
    """Compiled functions of a scene: residual and xdot at u = [a, lam, y]; the residual's tangent
    in u; derivatives of both along a direction."""
    layout = algebraic_layout(template.sizes)

    def equations(p: Any, u: Any, q: Any, v: Any, x: Any, t: Any) -> tuple[Any, Any]:
        scene = template.with_parameters(p)
        a, lam, y = layout.split(u)
        z = Variables(q, v, a, lam, x, y, t)
        rate = scene.state_rate(z) if scene.sizes.nx else jnp.zeros(0)
        return algebraic_residual(scene, u, q, v, x, t), rate

    def derivatives(p: Any, at: tuple, direction: tuple) -> tuple[Any, Any]:
        return jax.jvp(lambda *at: equations(p, *at), at, direction)[1]

    tangent = jax.jacfwd(lambda p, *at: equations(p, *at)[0], argnums=1)
    return jax.jit(equations), jax.jit(tangent), jax.jit(derivatives)
