"""Traced programs of a scene, before compilation: names in them, and the variables they depend on.

By names operations are counted: of a scene's equations, of parts of a method's work, and of loops
and branches whose turns a run counts.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from functools import cache, wraps
from typing import Any

import numpy as np

from problems.base.runtime import jax
from problems.system import MechatronicSystem
from problems.variables import VARIABLES, Variables

#: Names of operations in traced programs, by which those of a run are counted: a scene's equations,
#: and Newton's method for the index-1 equations.
EQUATIONS, INDEX1 = "equations_of_a_scene", "newton_of_index_1"


def part(name: str) -> Any:
    """A context: operations that are traced in it belong to this part of the work."""
    return jax.named_scope(f"part_{name}")


def turns(name: str) -> Any:
    """A context: the loop or branch that is traced in it is taken as often as a run says."""
    return jax.named_scope(f"turns_{name}")


def innermost(kind: str, scope: str) -> str:
    """The innermost "part" in a scope, or loop or branch ("turns"); empty if there is none."""
    return ["", *re.findall(rf"\b{kind}_(\w+)", scope)][-1]


def equation(function: Callable) -> Callable:
    """The same function, whose operations have the name `EQUATIONS` in traced programs."""

    @wraps(function)
    def call(*arguments: Any, **options: Any) -> Any:
        with jax.named_scope(EQUATIONS):
            return function(*arguments, **options)

    return call


def jitted(name: str, function: Callable) -> Callable:
    """The same function, compiled under a name; JAX 0.12 drops names of scopes in a custom root,
    but not those of compiled functions."""
    function.__name__ = name
    return jax.jit(function)


#: Blocks of a scene that a step may call by itself.
_BLOCKS = ("mass", "mass_product", "force", "constraint", "state_rate", "output")


def with_named_blocks(scene: MechatronicSystem) -> MechatronicSystem:
    """The scene with blocks whose operations have the name `EQUATIONS` in traced programs."""
    return scene.with_parameters({}, _named_class(type(scene)))


@cache
def _named_class(cls: type[MechatronicSystem]) -> type[MechatronicSystem]:
    blocks = {name: equation(getattr(cls, name)) for name in _BLOCKS if cls.has(name)}
    return type(cls.__name__, (cls,), blocks)


# ---- on which variables blocks depend --------------------------------------------------
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
