"""Problems: the system contract, its formulations, initial values, references, and the scenes."""

from problems.runtime import jax, jnp
from problems.system import MechatronicSystem, State, Variables, parameter

__all__ = ["MechatronicSystem", "State", "Variables", "jax", "jnp", "parameter"]
