"""Mass matrix and forces from a scene's energies, by automatic differentiation.

Lagrange's equations d/dt T_v - T_q + V_q = 0 for a kinetic energy T(q, v) that is quadratic in v
and a potential energy V(q). A scene with a full M(q) states two scalars in place of a matrix and
its gyroscopic forces.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from problems.runtime import jax, jnp


def mass(kinetic: Callable, q: Any) -> Any:
    """M(q) = T_vv, shape ``(nq, nq)``."""
    return jax.jacfwd(jax.grad(kinetic, 1), 1)(q, jnp.zeros_like(q))


def force(kinetic: Callable, potential: Callable | None, q: Any, v: Any) -> Any:
    """g(q, v) = T_q - (T_v)_q v - V_q, shape ``(nq,)``; without V_q if there is no potential."""
    _, momentum_rate = jax.jvp(lambda q: jax.grad(kinetic, 1)(q, v), (q,), (v,))
    g = jax.grad(kinetic)(q, v) - momentum_rate
    return g if potential is None else g - jax.grad(potential)(q)
