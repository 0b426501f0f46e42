"""Whether blocks of a scene depend on a variable, found in their programs before compilation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from problems.runtime import jax, jnp
from problems.system import MechatronicSystem


def depends(function: Callable, on: int, *arguments: Any) -> bool:
    """Whether the program of a function uses an argument for its result.

    A call within the program counts as a whole: all its results depend on all that it takes.

    Parameters
    ----------
    on
        Place of the argument, an array.
    arguments
        All arguments, arrays or numbers.
    """
    program = jax.make_jaxpr(function)(*arguments).jaxpr
    reached = {program.invars[on]}
    for equation in program.eqns:
        # Literals are no variables and cannot be hashed.
        if any(not hasattr(v, "val") and v in reached for v in equation.invars):
            reached.update(equation.outvars)
    return any(not hasattr(v, "val") and v in reached for v in program.outvars)


def mass_varies(scene: MechatronicSystem) -> bool:
    """Whether the mass matrix depends on q."""
    return depends(scene.mass, 0, jnp.zeros(scene.sizes.nq))


def force_takes_velocities(scene: MechatronicSystem) -> bool:
    """Whether the applied forces depend on v."""
    q = jnp.zeros(scene.sizes.nq)
    return depends(scene.force, 1, q, q, jnp.asarray(0.0))
