"""Problems: the system contract, its formulations, initial values, references, and the scenes."""

from importlib import import_module
from typing import TYPE_CHECKING

from problems.base.runtime import jax as jax
from problems.base.runtime import jnp as jnp
from problems.hybrid.contact import ContactSystem as ContactSystem
from problems.mechanics.bodies import GROUND as GROUND
from problems.mechanics.bodies import Body as Body
from problems.mechanics.bodies import RigidBodies as RigidBodies
from problems.mechanics.joints import Distance as Distance
from problems.mechanics.joints import Fixed as Fixed
from problems.mechanics.joints import Joint as Joint
from problems.mechanics.joints import Prismatic as Prismatic
from problems.mechanics.joints import Revolute as Revolute
from problems.mechanics.joints import Spherical as Spherical
from problems.mechanics.joints import SpringDamper as SpringDamper
from problems.mechanics.joints import Universal as Universal
from problems.starts import completed as completed
from problems.system import MechatronicSystem as MechatronicSystem
from problems.system import SampledSystem as SampledSystem
from problems.variables import Published as Published
from problems.variables import State as State
from problems.variables import Variables as Variables
from problems.variables import held as held
from problems.variables import parameter as parameter

if TYPE_CHECKING:
    from problems.models.mjcf import from_mjcf as from_mjcf
    from problems.models.sympy_models import from_sympy as from_sympy

#: Loaded late: SymPy takes long, and is an extra; the other compiles when it is imported.
_LATE = {"from_sympy": "problems.models.sympy_models", "from_mjcf": "problems.models.mjcf"}


def __getattr__(name: str):
    if name in _LATE:
        return getattr(import_module(_LATE[name]), name)
    raise AttributeError(f"module 'problems' has no attribute {name!r}")
