"""Whether blocks of a scene depend on a variable, found in their programs before compilation."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from problems.base.runtime import jax
from problems.system import MechatronicSystem
from problems.variables import VARIABLES, Variables


def depends(function: Callable, on: Iterable[int], *arguments: Any) -> bool:
    """Whether the program of a function uses one of some arguments for its result.

    Parameters
    ----------
    on
        Places of the arguments.
    arguments
        All arguments, arrays or numbers.
    """
    from jax.interpreters.partial_eval import dce_jaxpr

    program = jax.make_jaxpr(function)(*arguments).jaxpr
    _, used = dce_jaxpr(program, [True] * len(program.outvars))
    return any(used[place] for place in on)


def mass_varies(scene: MechatronicSystem) -> bool:
    """Whether the mass matrix depends on q."""
    return depends(scene.mass, [0], np.zeros(scene.sizes.nq))


def force_takes_velocities(scene: MechatronicSystem) -> bool:
    """Whether the applied forces depend on v."""
    return depends(scene.force, [1], *_motion(scene))


def damping_varies(scene: MechatronicSystem) -> bool:
    """Whether the derivative of the applied forces by v depends on q, v or t."""
    return depends(jax.jacfwd(scene.force, argnums=1), range(3), *_motion(scene))


def output_takes(scene: MechatronicSystem, *groups: str) -> bool:
    """Whether the outputs depend on one of these groups of variables."""
    return bool(scene.sizes.ny) and takes(scene.output, scene, groups)


def states_follow_accelerations(scene: MechatronicSystem) -> bool:
    """Whether the rates of controller states depend on a or lam, also through the outputs."""
    through = output_takes(scene, "a", "lam")
    groups = ("a", "lam", "y") if through else ("a", "lam")
    return bool(scene.sizes.nx) and takes(scene.state_rate, scene, groups)


def takes(block: Callable, scene: MechatronicSystem, groups: Iterable[str]) -> bool:
    """Whether a block of all variables depends on one of these groups."""
    z = [*(np.zeros(scene.sizes.of(group)) for group in VARIABLES), np.zeros(())]
    places = map(Variables._fields.index, groups)
    return depends(lambda *z: block(Variables(*z)), places, *z)


def _motion(scene: MechatronicSystem) -> tuple[np.ndarray, ...]:
    return np.zeros(scene.sizes.nq), np.zeros(scene.sizes.nv), np.zeros(())
