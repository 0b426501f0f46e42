"""Projections along the directions in which constraints act.

Shapes and units are those of `problems.equations.formulations`.
"""

from __future__ import annotations

from problems.base.runtime import Array, Float, jax, jnp
from problems.equations.constraints import constraint_change, constraint_velocity, regular
from problems.equations.kinematics import advance
from problems.equations.layouts import state_layout
from problems.equations.named_equations import equation
from problems.system import MechatronicSystem

#: Newton iterations of a projection: from a distance of a hundredth of the mechanism to round-off.
_PROJECTIONS = 3


def _least_change(scene: MechatronicSystem, q: Array, t: Array, r: Array) -> Array:
    """The w of least norm w^T M w with Phi_q w = r, of the first constraints if r has fewer rows.

    It lies in the range of M^-1 Phi_q^T, the directions in which constraints act. One solve with
    the augmented matrix, so that M need not be regular.
    """
    nv, nl = scene.sizes.nv, len(r)
    if nl == scene.sizes.nh and not scene.has("kinematics"):
        jacobian = jax.jacfwd(lambda q: scene.constraint(q, t))(q)
    else:
        jacobian = jax.jacfwd(lambda w: constraint_change(scene, q, t, w))(jnp.zeros(nv))[:nl]
    augmented = jnp.block([[scene.mass(q), jacobian.T], [jacobian, jnp.zeros((nl, nl))]])
    augmented = regular(scene, augmented)
    return jnp.linalg.solve(augmented, jnp.concatenate([jnp.zeros(nv), r]))[:nv]


@equation
def constrained_part(
    scene: MechatronicSystem, q: Float[Array, " nq"], t: Float[Array, ""], w: Float[Array, " nv"]
) -> Float[Array, " nv"]:
    """Project w on the range of M^-1 Phi_q^T, the directions of constraint forces; ``(nv,)``."""
    return _least_change(scene, q, t, constraint_change(scene, q, t, w))


@equation
def projected_state(
    scene: MechatronicSystem, t: Float[Array, ""], s: Float[Array, " n"]
) -> Float[Array, " n"]:
    """Move s = [q, v, x] to Phi = 0 and d/dt Phi = 0, by the least changes in the norm of M.

    Newton's method moves q, and one linear solve v: Hairer & Wanner (1996),
    doi:10.1007/978-3-642-05221-7, sec. VII.2.
    """
    if not scene.sizes.nl:
        return s
    q, v, x = state_layout(scene.sizes).split(s)
    for _ in range(_PROJECTIONS if scene.sizes.nh else 0):
        q = advance(scene, q, -_least_change(scene, q, t, scene.constraint(q, t)))
    v = v - _least_change(scene, q, t, constraint_velocity(scene, q, v, t))
    return jnp.concatenate([q, v, x])
