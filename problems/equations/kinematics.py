"""Kinematics of a scene: how coordinates q ``(nq,)`` follow velocities v ``(nv,)``; constraints.

Methods move coordinates by `advance`. Where velocities are the rates of the coordinates, q moves by
sums. Where a scene states ``kinematics``, q moves along dq/dt = T(q) w for unit time with the
displacement w, in one movement from the start of the step: movements one after the other would lose
an order, because rotations do not commute.

Constraints are those of positions Phi(q, t) = 0, then those of velocities A(q) v = b(t), and lam
has their multipliers in this order. Shapes and units are those of
`problems.equations.formulations`. With ``kinematics`` Phi_q stands for Phi_q T.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

from problems.base.runtime import Array, Float, jax, jnp
from problems.equations.programs import equation
from problems.system import MechatronicSystem
from problems.variables import Variables, algebraic_layout, state_layout


class Displaced(NamedTuple):
    """Coordinates q ``(nq,)`` from which a displacement w ``(nv,)`` leads on."""

    q: Float[Array, " nq"]
    w: Float[Array, " nv"]


#: Coordinates as an array, of scenes with ``kinematics`` also as `Displaced`.
Place: TypeAlias = Any


def q_rate(
    scene: MechatronicSystem, q: Float[Array, " nq"], v: Float[Array, " nv"]
) -> Float[Array, " nq"]:
    """Return dq/dt at velocity v, in units of q per s."""
    return scene.kinematics(q, v) if scene.has("kinematics") else v


def displaced(scene: MechatronicSystem, q: Place, *changes: Float[Array, " nv"]) -> Place:
    """Add a displacement, a velocity times a time, to which `advance` may add more.

    Parameters
    ----------
    changes
        Parts of the displacement; they are added one after the other.
    """
    if scene.has("kinematics"):
        first, *others = (q.w, *changes) if isinstance(q, Displaced) else changes
        return Displaced(origin(q), sum(others, first))
    for change in changes:
        q = q + change
    return q


def advance(
    scene: MechatronicSystem, q: Place, *changes: Float[Array, " nv"]
) -> Float[Array, " nq"]:
    """Move coordinates by a displacement; arguments as those of `displaced`."""
    place = displaced(scene, q, *changes)
    if not isinstance(place, Displaced):
        return place
    return scene.move(*place) if scene.has("move") else _along(scene, *place)


def origin(q: Place) -> Float[Array, " nq"]:
    """Return the coordinates before the displacement, if there is one."""
    return q.q if isinstance(q, Displaced) else q


def _along(scene: MechatronicSystem, q: Array, w: Array) -> Array:
    """Follow dq/dt = T(q) w for unit time by one classical Runge-Kutta step: up to w^5."""
    k1 = scene.kinematics(q, w)
    k2 = scene.kinematics(q + k1 / 2, w)
    k3 = scene.kinematics(q + k2 / 2, w)
    k4 = scene.kinematics(q + k3, w)
    return q + (k1 + 2 * k2 + 2 * k3 + k4) / 6


# ---- forces of constraints and their derivatives by time -------------------------------
#: Part of the constraints' derivatives, squared, that is nothing beside them.
_SMALL = 1e-8
#: Newton iterations of a projection: from a distance of a hundredth of the mechanism to round-off.
_PROJECTIONS = 3


@equation
def constraint_force(
    scene: MechatronicSystem, q: Float[Array, " nq"], t: Float[Array, ""], lam: Float[Array, " nl"]
) -> Float[Array, " nv"]:
    """Compute Phi_q(q, t)^T lam, which eq. (1) subtracts, in N (or N m), shape ``(nv,)``.

    With ``kinematics`` it is T^T Phi_q^T lam. The entries of lam behind those of Phi, if there are
    any, are of the velocity constraints A v = b and add A^T lam.
    """
    still = jnp.zeros(scene.sizes.nv)
    rates = jax.vjp(lambda v: constraint_velocity(scene, q, v, t)[: len(lam)], still)[1]
    return rates(lam)[0]


@equation
def constraint_velocity(
    scene: MechatronicSystem, q: Float[Array, " nq"], v: Float[Array, " nv"], t: Float[Array, ""]
) -> Float[Array, " nl"]:
    """Compute d/dt Phi = Phi_q v + Phi_t, in units of Phi per s, and A v - b, shape ``(nl,)``."""
    rows = []
    if scene.sizes.nh:
        rates = q_rate(scene, q, v), jnp.ones_like(t)
        rows.append(jax.jvp(scene.constraint, (q, t), rates)[1])
    if scene.has("velocity_constraint"):
        rows.append(scene.velocity_constraint(q, v, t))
    return joined(rows)


def constraint_change(
    scene: MechatronicSystem, q: Float[Array, " nq"], t: Float[Array, ""], w: Float[Array, " nv"]
) -> Float[Array, " nl"]:
    """Compute the part of `constraint_velocity` that is linear in v, for w in its place."""
    return jax.jvp(lambda v: constraint_velocity(scene, q, v, t), (w,), (w,))[1]


@equation
def constraint_acceleration(
    scene: MechatronicSystem,
    q: Float[Array, " nq"],
    v: Float[Array, " nv"],
    a: Float[Array, " nv"],
    t: Float[Array, ""],
) -> Float[Array, " nl"]:
    """Compute d2/dt2 Phi, linear in a, in units of Phi per s^2, shape ``(nl,)``."""
    rates = q_rate(scene, q, v), a, jnp.ones_like(t)
    return jax.jvp(lambda q, v, t: constraint_velocity(scene, q, v, t), (q, v, t), rates)[1]


def constraint_rows(
    scene: MechatronicSystem,
    formulation: str,
    z: Variables,
    of_q: Array | float | None = None,
    of_v: Array | float | None = None,
) -> list[Array]:
    """Compute the residuals of the constraints that a formulation holds.

    Constraints of velocities alone hold as they are on index 3, too.

    Parameters
    ----------
    of_q, of_v
        Numbers by which residuals of positions and of velocities are divided, if given.
    """
    q, v, t, positions, velocities = z.q, z.v, z.t, [], []
    if formulation == "index1":
        return [constraint_acceleration(scene, q, v, z.a, t)]
    if formulation in ("index3", "stabilised_index2") and scene.sizes.nh:
        positions.append(scene.constraint(q, t))
    if formulation in ("index2", "stabilised_index2"):
        velocities.append(constraint_velocity(scene, q, v, t))
    elif scene.has("velocity_constraint"):
        velocities.append(scene.velocity_constraint(q, v, t))
    return [
        row if by is None else row / by
        for rows, by in ((positions, of_q), (velocities, of_v))
        for row in rows
    ]


def pulled(scene: MechatronicSystem, row: Array, weight: Any, q: Array, t: Array) -> Array:
    """Add weight times Phi to the rows of Phi."""
    nh = scene.sizes.nh
    if not nh:
        return row
    if nh == len(row):
        return row + weight * scene.constraint(q, t)
    return row.at[:nh].add(weight * scene.constraint(q, t))


def joined(rows: list[Array]) -> Array:
    """Residuals of both kinds of constraints; of one kind as they are, without an operation."""
    return rows[0] if len(rows) == 1 else jnp.concatenate(rows)


# ---- projections along the directions in which constraints act -------------------------------
def augmented(
    scene: MechatronicSystem, q: Float[Array, " nq"], t: Float[Array, ""], nl: int
) -> Float[Array, "n n"]:
    """Compute [[M, Phi_q^T], [Phi_q, 0]] with the first nl constraints, made `regular`."""
    still = jnp.zeros(scene.sizes.nv)
    rows = jax.jacfwd(lambda w: constraint_change(scene, q, t, w))(still)[:nl]
    return regular(scene, jnp.block([[scene.mass(q), rows.T], [rows, jnp.zeros((nl, nl))]]))


def _least_change(scene: MechatronicSystem, q: Array, t: Array, r: Array) -> Array:
    """The w of least norm w^T M w with Phi_q w = r, of the first constraints if r has fewer rows.

    It lies in the range of M^-1 Phi_q^T, the directions in which constraints act. One solve with
    the augmented matrix, so that M need not be regular.
    """
    nv = scene.sizes.nv
    right = jnp.concatenate([jnp.zeros(nv), r])
    return jnp.linalg.solve(augmented(scene, q, t, len(r)), right)[:nv]


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


# ---- redundant constraints -----------------------------------------------------------------
def idle_multipliers(
    scene: MechatronicSystem, rows: Float[Array, "nl nv"]
) -> Float[Array, "nl nl"]:
    """Compute the projection on multipliers that exert no force, from rows Phi_q.

    It is a power of e (Phi_q Phi_q^T + e)^-1, and vanishes where violated constraints have full
    rank. Derivatives take it as constant.
    """
    rows = jax.lax.stop_gradient(rows)
    squares = rows @ rows.T
    small = _SMALL * jnp.trace(squares)
    part = small * jnp.linalg.inv(squares + small * jnp.eye(scene.sizes.nl))
    part = part @ part
    return part @ part.T  # columns of the inverse are longer or shorter by rounding, rows are not


@equation
def least_multipliers(
    scene: MechatronicSystem, q: Float[Array, " nq"], t: Float[Array, ""], lam: Float[Array, " nl"]
) -> Float[Array, " nl"]:
    """Compute the least multipliers that exert the same force."""
    still = jnp.zeros(scene.sizes.nv)
    idle = idle_multipliers(scene, jax.jacfwd(lambda w: constraint_change(scene, q, t, w))(still))
    lam = lam - idle @ lam
    return lam - idle @ lam  # what the powers' rounding left


def regular(scene: MechatronicSystem, matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Make the matrix of the index-1 equations regular if constraints are redundant.

    Of their solutions the one with the least multipliers is left.
    """
    if not scene.redundant:
        return matrix
    nv, lam = scene.sizes.nv, algebraic_layout(scene.sizes).lam
    rows, mass = matrix[lam, :nv], matrix[:nv, :nv]
    pull = jnp.sum(rows**2) / jnp.max(jnp.abs(mass))
    return matrix.at[lam, lam].add(pull * idle_multipliers(scene, rows))
