"""What is simulated: the system contract, its formulations, references, and one file per scene."""

from problems.runtime import jax, jnp
from problems.system import MechatronicSystem, State, Variables, parameter

__all__ = ["MechatronicSystem", "State", "Variables", "jax", "jnp", "parameter"]
