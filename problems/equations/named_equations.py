"""Names in traced programs, by which operations are counted: of a scene's equations, of parts of a
method's work, and of loops and branches whose turns a run counts."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache, wraps
from typing import Any

from problems.base.runtime import jax
from problems.system import MechatronicSystem

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
