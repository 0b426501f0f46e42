"""Mass matrix and forces from a scene's energies, by automatic differentiation.

Lagrange's equations d/dt T_v - T_q + V_q = 0 for a kinetic energy T(q, v) that is quadratic in v
and a potential energy V(q). A scene with a full M(q) states two scalars in place of a matrix and
its gyroscopic forces.
"""

from __future__ import annotations

from collections.abc import Callable

from problems.base.runtime import Array, Float, jax, jnp
from problems.system import MechatronicSystem


def mass(kinetic: Callable[[Array, Array], Array], q: Float[Array, " nq"]) -> Float[Array, "nv nv"]:
    """Compute M(q) = T_vv in kg (or kg m^2) of T(q, v) in J."""
    return jax.jacfwd(jax.grad(kinetic, 1), 1)(q, jnp.zeros_like(q))


def force(
    kinetic: Callable[[Array, Array], Array],
    potential: Callable[[Array], Array],
    q: Float[Array, " nq"],
    v: Float[Array, " nv"],
) -> Float[Array, " nv"]:
    """Compute g(q, v) = T_q - (T_v)_q v - V_q in N (or N m) of T(q, v) and V(q) in J."""
    _, momentum_rate = jax.jvp(lambda q: jax.grad(kinetic, 1)(q, v), (q,), (v,))
    g = jax.grad(kinetic)(q, v) - momentum_rate
    return g - jax.grad(potential)(q)


class OfEnergies(MechatronicSystem):
    """Base class of scenes that state `_kinetic_energy` and `_potential_energy`.

    Where other forces act a scene adds them to ``force``, else ``energy = OfEnergies._total``.
    """

    def _kinetic_energy(self, q: Float[Array, " nq"], v: Float[Array, " nv"]) -> Float[Array, ""]:
        """T in J, quadratic in v."""
        raise NotImplementedError

    def _potential_energy(self, q: Float[Array, " nq"]) -> Float[Array, ""]:
        """V in J."""
        raise NotImplementedError

    def mass(self, q: Array) -> Array:
        return mass(self._kinetic_energy, q)

    def force(self, q: Array, v: Array, t: Array) -> Array:
        return force(self._kinetic_energy, self._potential_energy, q, v)

    def _total(self, q: Array, v: Array) -> Array:
        return self._kinetic_energy(q, v) + self._potential_energy(q)
