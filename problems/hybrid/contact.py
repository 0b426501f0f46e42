"""Contact: gaps that stay open, impacts, and Coulomb's friction.

A scene states ``gaps`` g(q, t) >= 0, perhaps the velocities ``sliding`` at which bodies that touch
move along each other, and the numbers ``restitution`` e and ``friction`` mu. A contact acts by p_N
along G_N, the derivative of dg/dt by v, and by p_T along G_T, that of the sliding velocity. In an
impact these are impulses; with ' for values behind it::

    M (v' - v) = G_N^T p_N + G_T^T p_T
    0 <= p_N  perpendicular to  u_N' + e u_N >= 0      (Newton)
    |p_T| <= mu p_N,    p_T = -mu p_N sign(u_T')  unless u_T' = 0      (Coulomb)

with u_N = dg/dt and the sliding velocity u_T. Constraints hold in an impact, too. Newton's law with
friction may raise the energy where an impact turns a body round (Kane & Levinson 1985).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from problems.base.runtime import Array, Bool, Float, jax, jnp
from problems.equations.kinematics import augmented, q_rate
from problems.equations.programs import equation
from problems.system import MechatronicSystem
from problems.variables import Variables

#: Sweeps and Newton iterations for an impact, and the part of velocities that may be left of its
#: residual.
_SWEEPS, _MOST, _SOLVED = 50, 10, 1e-12


@equation
def gap_rates(
    scene: MechatronicSystem, q: Float[Array, " nq"], v: Float[Array, " nv"], t: Float[Array, ""]
) -> Float[Array, " nc"]:
    """Compute dg/dt, the velocities at which gaps open, in m/s (or rad/s)."""
    return jax.jvp(scene.gaps, (q, t), (q_rate(scene, q, v), jnp.ones_like(t)))[1]


class Contacts(NamedTuple):
    """Contacts at a place and a time: those that are closed, and their velocities G v + b.

    Rows of G are those of normals, then of tangents. Restitution e u_N is added to b of normals.
    """

    closed: Bool[Array, " nc"]
    g: Float[Array, "n nv"]
    b: Float[Array, " n"]
    mu: Float[Array, " nc"]
    #: Accelerations by unit forces, about: they weigh forces against velocities.
    weight: Float[Array, " n"]

    @classmethod
    def of(
        cls, scene: MechatronicSystem, q: Array, v: Array, t: Array, closed: Array | None = None
    ) -> Contacts:
        """Return those of a place and a time, with the velocities v before; all that have no gap
        are closed, unless it is given."""
        gaps = scene.gaps(q, t)
        nc, still = len(gaps), 0.0 * v
        slide = [scene.sliding] if scene.has("sliding") else []

        def rates(v: Array) -> Array:
            return jnp.concatenate([gap_rates(scene, q, v, t), *(f(q, v, t) for f in slide)])

        e, mu = (jnp.asarray(x, dtype=float) for x in (scene.restitution, scene.friction))
        g, b = jax.jacfwd(rates)(still), rates(still)
        b = b.at[:nc].add(e * rates(v)[:nc])
        weight = jnp.sum(g * g / jnp.diag(scene.mass(q)), axis=1)
        closed = gaps <= 0 if closed is None else closed
        return cls(closed, g, b, jnp.broadcast_to(mu, (nc,)), weight)

    def rows(self, r: Array, v: Array, h: Any = 1.0, give: float = 0.0) -> Array:
        """Residuals of the laws for forces r and the velocities v after them, as accelerations.

        Parameters
        ----------
        h
            Time in s for which forces act; 1 if r are impulses.
        give
            Part of the velocity that its impulse takes away with which a contact gives way.
        """
        nc, u = len(self.closed), (self.g @ v + self.b) / h + give * self.weight * r
        along = self.weight * r
        push = jnp.where(self.closed, jnp.maximum(0.0, (along - u)[:nc]), 0.0)
        rows = along[:nc] - push
        if len(r) == nc:
            return rows
        most = self.weight[nc:] * self.mu * push / self.weight[:nc]
        return jnp.concatenate([rows, along[nc:] - jnp.clip((along - u)[nc:], -most, most)])


def impact(
    scene: MechatronicSystem, z: Variables, closed: Bool[Array, " nc"]
) -> tuple[Float[Array, " nv"], Float[Array, " n"]]:
    """Compute the velocities behind an impact of closed contacts, and impulses, normal ones first.

    Sweeps of projections from contact to contact (Gauss & Seidel) find the piece of the laws that
    holds, and Newton's method the impulses. They are NaN where this does not converge.
    """
    contacts = Contacts.of(scene, z.q, z.v, z.t, closed)
    nc, g, nl = len(contacts.closed), contacts.g, scene.sizes.nl
    # Changes of v by unit impulses, and by the impulses of constraints that follow.
    matrix = augmented(scene, z.q, z.t, nl) if nl else scene.mass(z.q)
    right = jnp.concatenate([g.T, jnp.zeros((nl, len(g)))])
    moved = jnp.linalg.solve(matrix, right)[: g.shape[1]].T
    matrix, still = g @ moved.T, g @ z.v + contacts.b

    def sweep(_: int, p: Array) -> Array:
        for k in range(nc):
            for j in range(k, len(p), nc):
                free = p[j] - (still[j] + matrix[j] @ p) / matrix[j, j]
                normal = jnp.where(contacts.closed[k], jnp.maximum(0.0, free), 0.0)
                most = contacts.mu[k] * p[k]
                p = p.at[j].set(normal if j == k else jnp.clip(free, -most, most))
        return p

    def residual(p: Array) -> Array:
        return contacts.rows(p, z.v + p @ moved)

    def update(_: int, p: Array) -> Array:
        return p - jnp.linalg.solve(jax.jacfwd(residual)(p), residual(p))

    p = jax.lax.fori_loop(0, _SWEEPS, sweep, jnp.zeros(len(still)))
    p = jax.lax.fori_loop(0, _MOST, update, p)
    solved = jnp.max(jnp.abs(residual(p))) <= _SOLVED * jnp.max(jnp.abs(g @ z.v))
    p = jnp.where(solved, p, jnp.nan)
    return z.v + p @ moved, p


@dataclass(frozen=True)
class ContactSystem(MechatronicSystem):
    """Base of scenes whose ``gaps`` close in impacts alone, which are their events.

    Gaps that close at the same instant strike one after the other. Contact that lasts has no
    equations here: a motion that comes to rest, or slides on, ends with a sentence, unless the
    method takes it (`moreau_jean`) or the scene states events and jump of its own.
    """

    def events(self, z: Variables) -> Array:
        return self.gaps(z.q, z.t)

    def jump(self, z: Variables, event: int) -> dict[str, Array]:
        closed = jnp.arange(len(self.gaps(z.q, z.t))) == event
        return {"v": impact(self, z, closed)[0]}
