"""Contact: gaps that stay open, impacts, and Coulomb's friction.

A scene states ``gaps`` g(q, t) >= 0, perhaps ``sliding``, the tangential velocities, and the numbers
``restitution`` e and ``friction`` mu. A contact acts by p_N along the gradient of its gap and by p_T
along that of its slip. In an impact these are impulses in N s. With ' behind the impact::

    M (v' - v) = G_N^T p_N + G_T^T p_T,   u_N' = -e u_N,   |p_T| <= mu p_N

where u_N = dg/dt is Newton's and p_T Coulomb's: the slip stops, or p_T = mu p_N acts against it.
Holonomic and other constraints hold in an impact, too. Velocities change by the least M norm.
"""

from __future__ import annotations

from dataclasses import dataclass

from problems.constraints import constraint_change
from problems.kinematics import q_rate
from problems.named_equations import equation
from problems.runtime import Array, Float, jax, jnp
from problems.system import MechatronicSystem
from problems.variables import Variables


@equation
def gap_rates(
    scene: MechatronicSystem, q: Float[Array, " nq"], v: Float[Array, " nv"], t: Float[Array, ""]
) -> Float[Array, " nc"]:
    """Compute dg/dt, the velocities at which gaps open, in m/s (or rad/s)."""
    return jax.jvp(scene.gaps, (q, t), (q_rate(scene, q, v), jnp.ones_like(t)))[1]


def constants(scene: MechatronicSystem, count: int) -> tuple[Array, Array]:
    """Return restitution and friction of each of so many contacts."""
    e, mu = (jnp.asarray(number, dtype=float) for number in (scene.restitution, scene.friction))
    return jnp.broadcast_to(e, (count,)), jnp.broadcast_to(mu, (count,))


def after_impact(scene: MechatronicSystem, z: Variables, contact: int) -> Float[Array, " nv"]:
    """Compute the velocities behind an impact of one contact.

    They are NaN where the laws of Newton and Coulomb have no solution (Painleve).
    """
    q, v, t, still = z.q, z.v, z.t, jnp.zeros_like(z.v)
    of_constraints = jnp.zeros((0, len(v)))
    if scene.sizes.nl:
        of_constraints = jax.jacfwd(lambda w: constraint_change(scene, q, t, w))(still)
    nl = len(of_constraints)
    matrix = jnp.block([[scene.mass(q), of_constraints.T], [of_constraints, jnp.zeros((nl, nl))]])

    def moved_by(direction: Array) -> Array:
        """Change of v by a unit impulse."""
        return jnp.linalg.solve(matrix, jnp.concatenate([direction, jnp.zeros(nl)]))[: len(v)]

    u_n, normal = jax.value_and_grad(lambda v: gap_rates(scene, q, v, t)[contact])(v)
    along_n = moved_by(normal)
    e, mu = (number[contact] for number in constants(scene, scene.gaps(q, t).shape[0]))
    if not scene.has("sliding"):
        stopped = along_n * (u_n / (normal @ along_n))
        return (v - stopped) - e * stopped
    u_t, tangent = jax.value_and_grad(lambda v: scene.sliding(q, v, t)[contact])(v)
    along_t = moved_by(tangent)
    a, b, c = normal @ along_n, normal @ along_t, tangent @ along_t
    rebound = -(1 + e) * u_n
    p_n, p_t = jnp.linalg.solve(jnp.array([[a, b], [b, c]]), jnp.array([rebound, -u_t]))
    side = jnp.sign(p_t)
    slid = rebound / (a + side * mu * b)
    sticks = jnp.abs(p_t) <= mu * p_n
    p_n, p_t = jnp.where(sticks, p_n, slid), jnp.where(sticks, p_t, side * mu * slid)
    return jnp.where(p_n >= 0, v + along_n * p_n + along_t * p_t, jnp.nan)


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
        return {"v": after_impact(self, z, event)}
