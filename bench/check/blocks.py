"""The checks of a scene's blocks: pure, differentiable, and with parameters that are traced."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from bench.check.verdicts import DoesNotApply, Failed, shortly
from bench.plugins.registry import Registry
from problems import ContactSystem, jax, jnp
from problems.base import spec
from problems.system import MechatronicSystem
from problems.variables import INVARIANTS, Variables

#: Derivatives agree with difference quotients to this, relative to them or to the block's largest
#: entry.
_DERIVATIVE_ERROR = 1e-6
#: Difference quotients with one of these steps have to: a block may be as sharp as the smallest.
_QUOTIENT_STEPS = (1e-3, 1e-4, 1e-5, 1e-6)
_POINTS = 3
#: The variables that each block takes.
_ARGUMENTS = {
    "mass": "q",
    **dict.fromkeys(("force", "velocity_constraint", "sliding"), "qvt"),
    **dict.fromkeys(("constraint", "gaps"), "qt"),
    **dict.fromkeys(("kinematics", *INVARIANTS), "qv"),
    **dict.fromkeys(("coupled_force", "state_rate", "output", "events", "sample", "jump"), "z"),
}


def _block(name: str) -> Callable[[MechatronicSystem, Variables], Any]:
    """A block as a function of a scene and all variables, with a flat result.

    The mass matrix is multiplied by a vector, so that its derivative stays small. Of jumps, that at
    the first event is taken.
    """

    def call(scene: MechatronicSystem, z: Variables) -> Any:
        wanted = _ARGUMENTS[name]
        given = [z] if wanted == "z" else [getattr(z, w) for w in wanted]
        value = getattr(scene, name)(*given, *([0] if name == "jump" else []))
        if name in ("sample", "jump"):  # new values by name
            value = jnp.concatenate([jnp.ravel(part) for part in value.values()])
        if name == "mass":
            value = value @ jnp.cos(jnp.arange(value.shape[-1], dtype=float))
        return jnp.ravel(jnp.asarray(value))

    return call


def _points(scene: MechatronicSystem) -> list[Variables]:
    """The start, and states near it at later times: blocks are functions of anything.

    The times are spread over the interval, as a road may begin to act late.
    """
    state, random = scene.initial_state(), np.random.default_rng(1)
    try:
        sizes = scene.sizes
    except Exception as error:
        raise Failed(f"constraint or actuation cannot be traced: {shortly(error)}") from error
    a, lam, y = (np.zeros(n) for n in (sizes.nv, sizes.nl, sizes.ny))
    start = (state.q, state.v, a, lam, state.x, y, np.float64(scene.interval[0]))
    points: list[tuple[Any, ...]] = [start]
    for _ in range(_POINTS - 1):
        moves = [0.1 * np.maximum(1.0, np.abs(p)) * random.uniform(-1, 1, p.shape) for p in start]
        moves[-1] = np.ptp(scene.interval) * (len(points) - random.uniform(0, 1)) / (_POINTS - 1)
        points.append(tuple(p + move for p, move in zip(start, moves, strict=True)))
    return [Variables(*(jnp.asarray(part, dtype=float) for part in point)) for point in points]


def check_blocks(registry: Registry, scene: MechatronicSystem) -> str:
    """Blocks are pure functions whose derivatives are those of their values."""
    names = [name for name in _ARGUMENTS if scene.has(name)]
    if getattr(type(scene), "jump", None) is ContactSystem.jump:
        names.remove("jump")  # the law of impact, which has a kink where bodies part
    points = _points(scene)
    for name in names:
        block = partial(_block(name), scene)
        traced = jax.jit(block)
        try:
            jax.block_until_ready(traced(points[0]))
        except Exception as error:
            raise Failed(
                f"{name} cannot be traced by JAX: {shortly(error)} Write it in jax.numpy, without "
                f"branches on values."
            ) from error
        if not alike(*(np.stack([call(z) for z in points]) for call in (traced, block, traced))):
            raise Failed(f"{name} gives other values when called again; keep it pure.")
        for z in points:
            if fault := _apart(traced, z):
                raise Failed(f"Derivatives of {name} are not its slope: {fault}")
    return f"{', '.join(names)}: derivatives agree with difference quotients at {_POINTS} states."


def alike(first: np.ndarray, *others: np.ndarray) -> bool:
    """Whether calls of a block gave the same values at all points, but for rounding.

    Stiff forces that nearly cancel at one point round as they do where they are large.
    """
    sizes = np.abs(np.nan_to_num(first, posinf=0.0, neginf=0.0))
    close = partial(np.allclose, rtol=1e-9, atol=1e-12 * max(1.0, sizes.max(initial=0.0)))
    return all(close(first, other, equal_nan=True) for other in others)


def _apart(block: Callable, z: Variables) -> str:
    """Say how derivatives along a random vector differ from difference quotients, if they do."""
    from jax.test_util import check_grads

    allowed, fault = _DERIVATIVE_ERROR * max(np.abs(block(z)).max(initial=0.0), 1e-6), ""
    for h in _QUOTIENT_STEPS:
        try:
            check_grads(block, (z,), 1, ["fwd"], atol=allowed, rtol=_DERIVATIVE_ERROR, eps=h)
        except AssertionError as error:
            fault = f"{shortly(error)} Look for stop_gradient, rounding, a kink or a root of zero."
        else:
            return ""
    return fault


def check_parameters(registry: Registry, scene: MechatronicSystem) -> str:
    """Another value of a float parameter acts without compiling anything new."""
    fields = list(spec.numbers_of(type(scene)).values())
    if not fields:
        raise DoesNotApply("It has no float parameter.")
    template, points = scene.template(), _points(scene)
    calls = [_block(name) for name in _ARGUMENTS if scene.has(name)]

    def blocks(s: MechatronicSystem) -> list[Any]:
        return [jnp.stack([call(s, z) for z in points]) for call in calls]

    traced = jax.jit(lambda p: blocks(template.with_parameters(p)))
    for field in fields:
        other = _with_another(scene, field)
        if other is None:
            continue
        if other.template() != template or other.sizes != scene.sizes:
            raise Failed(
                f"Another value of {field.name} makes another compiled scene; keep in fields "
                f"only what is declared by parameter()."
            )
        if not all(map(alike, traced(other.parameters()), blocks(other))):
            raise Failed(
                f"A traced value of {field.name} does not act as a plain one; compute from "
                f"self.{field.name} inside the blocks and not when the scene is made."
            )
    return f"Acting when traced: {', '.join(f.name for f in fields)}; nothing is compiled anew."


def _with_another(scene: MechatronicSystem, field: dataclasses.Field) -> MechatronicSystem | None:
    """The scene with a slightly different value of a parameter; None if none is allowed."""
    value = getattr(scene, field.name)
    options = {f.name: getattr(scene, f.name) for f in dataclasses.fields(scene) if f.metadata}
    for changed in (1.01 * value + 0.01 * (value == 0), 0.99 * value - 0.01 * (value == 0)):
        try:
            return spec.build(type(scene), options | {field.name: changed}, scene.name)
        except spec.SpecError:
            continue
    return None
