"""Point masses, all alike: a base of scenes."""

from __future__ import annotations

from problems.base.runtime import Array, jnp
from problems.system import MechatronicSystem


class PointMasses(MechatronicSystem):
    """Base class of scenes each coordinate of which has the mass ``m``, perhaps a parameter."""

    m = 1.0

    def mass(self, q: Array) -> Array:
        return self.m * jnp.eye(len(q))
