"""Problems: the system contract, its formulations, initial values, references, and the scenes."""

from problems.runtime import jax, jnp
from problems.system import MechatronicSystem, Published, State, Variables, parameter

__all__ = ["MechatronicSystem", "Published", "State", "Variables", "jax", "jnp", "parameter"]
