"""Mass matrix and forces from a scene's energies, by automatic differentiation.

Lagrange's equations d/dt T_v - T_q + V_q = 0 for a kinetic energy T(q, v) that is quadratic in v
and a potential energy V(q). A scene with a full M(q) states two scalars in place of a matrix and
its gyroscopic forces.
"""

from __future__ import annotations

from collections.abc import Callable

from problems.runtime import Array, Float, jax, jnp


def mass(kinetic: Callable[[Array, Array], Array], q: Float[Array, " nq"]) -> Float[Array, "nv nv"]:
    """Compute M(q) = T_vv in kg (or kg m^2).

    Parameters
    ----------
    kinetic
        T(q, v) in J, a scalar.
    """
    return jax.jacfwd(jax.grad(kinetic, 1), 1)(q, jnp.zeros_like(q))


def force(
    kinetic: Callable[[Array, Array], Array],
    potential: Callable[[Array], Array],
    q: Float[Array, " nq"],
    v: Float[Array, " nv"],
) -> Float[Array, " nv"]:
    """Compute g(q, v) = T_q - (T_v)_q v - V_q in N (or N m).

    Parameters
    ----------
    kinetic, potential
        T(q, v) and V(q) in J, scalars.
    """
    _, momentum_rate = jax.jvp(lambda q: jax.grad(kinetic, 1)(q, v), (q,), (v,))
    g = jax.grad(kinetic)(q, v) - momentum_rate
    return g - jax.grad(potential)(q)
