"""Problems: the system contract, its formulations, initial values, references, and the scenes."""

from typing import TYPE_CHECKING

from problems.base.runtime import jax, jnp
from problems.hybrid.contact import ContactSystem
from problems.hybrid.sampled import SampledSystem
from problems.mechanics.bodies import GROUND, Body, RigidBodies
from problems.mechanics.joints import (
    Distance,
    Fixed,
    Joint,
    Prismatic,
    Revolute,
    Spherical,
    SpringDamper,
    Universal,
)
from problems.starts import completed
from problems.system import MechatronicSystem
from problems.variables import Published, State, Variables, held, parameter

if TYPE_CHECKING:
    from problems.models.mjcf import from_mjcf
    from problems.models.sympy_models import from_sympy

__all__ = [
    "GROUND",
    "Body",
    "ContactSystem",
    "Distance",
    "Fixed",
    "Joint",
    "MechatronicSystem",
    "Prismatic",
    "Published",
    "Revolute",
    "RigidBodies",
    "SampledSystem",
    "Spherical",
    "SpringDamper",
    "State",
    "Universal",
    "Variables",
    "completed",
    "from_mjcf",
    "from_sympy",
    "held",
    "jax",
    "jnp",
    "parameter",
]


def __getattr__(name: str):
    if name == "from_sympy":  # loaded late: SymPy takes long, and is an extra
        from problems.models.sympy_models import from_sympy

        return from_sympy
    if name == "from_mjcf":  # loaded late, as it compiles when it is imported
        from problems.models.mjcf import from_mjcf

        return from_mjcf
    raise AttributeError(f"module 'problems' has no attribute {name!r}")
