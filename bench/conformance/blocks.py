"""The checks of a scene's blocks: pure, differentiable, and with parameters that are traced."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from bench.conformance.verdicts import DoesNotApply, Failed, shortly
from bench.plugins.registry import Registry
from problems import ContactSystem, jax, jnp, spec
from problems.system import MechatronicSystem
from problems.variables import INVARIANTS, Variables

#: Derivatives agree with difference quotients to this, relative to the block's largest entry.
_DERIVATIVE_ERROR = 1e-6
#: Difference quotients are tried with these steps and the best one counts: a block may be as
#: sharp as the smallest.
_QUOTIENT_STEPS = (1e-3, 1e-4, 1e-5)
_POINTS = 3
#: The variables that each block takes.
_ARGUMENTS = {
    "mass": "q",
    "force": "qvt",
    "constraint": "qt",
    "velocity_constraint": "qvt",
    "kinematics": "qv",
    "coupled_force": "z",
    **dict.fromkeys(INVARIANTS, "qv"),
    "state_rate": "z",
    "output": "z",
    "events": "z",
    "sample": "z",
    "jump": "z",
    "gaps": "qt",
    "sliding": "qvt",
}
#: Attributes that may be parameters.
_CONSTANTS = ("sample_time", "restitution", "friction")


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
    """The start, and states near it, with all else made up: blocks are functions of anything."""
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
        points.append(tuple(p + move for p, move in zip(start, moves, strict=True)))
    return [Variables(*(jnp.asarray(part, dtype=float) for part in point)) for point in points]


def check_blocks(registry: Registry, scene: MechatronicSystem) -> str:
    """Blocks are pure functions whose derivatives are those of their values."""
    names = [name for name in _ARGUMENTS if scene.has(name)]
    if getattr(type(scene), "jump", None) is ContactSystem.jump:
        names.remove("jump")  # the law of impact, which has a kink where bodies part
    points = _points(scene)
    for name in names:
        block = _block(name)
        try:
            traced = jax.jit(lambda z, block=block: block(scene, z))
            slope = jax.jit(jax.jacfwd(traced))
            jax.block_until_ready(slope(points[0]))
        except Exception as error:
            raise Failed(
                f"{name} cannot be traced by JAX: {shortly(error)} Write it in jax.numpy, without "
                f"branches on values."
            ) from error
        for z in points:
            values = [np.asarray(value) for value in (traced(z), block(scene, z), traced(z))]
            if not all(np.allclose(v, values[0], rtol=1e-9, atol=1e-12) for v in values):
                raise Failed(f"{name} gives other values when called again; keep it pure.")
            _compare(name, traced, slope(z), z)
    return f"{', '.join(names)}: derivatives agree with difference quotients at {_POINTS} states."


def _compare(name: str, block: Callable, slope: Variables, z: Variables) -> None:
    for variable, at in zip(Variables._fields, z, strict=True):
        if not at.size:
            continue
        exact = np.asarray(getattr(slope, variable)).reshape(-1, at.size)
        quotients = np.array([_quotient(block, z, variable, step) for step in _QUOTIENT_STEPS])
        errors = np.nan_to_num(np.abs(quotients - exact), nan=np.inf)
        best = errors.min(axis=0)
        size = max(np.abs(exact).max(initial=0.0), np.abs(np.asarray(block(z))).max(initial=1e-300))
        if best.size and not best.max() <= _DERIVATIVE_ERROR * size:
            i, j = np.unravel_index(best.argmax(), best.shape)
            quotient = quotients[errors[:, i, j].argmin(), i, j]
            index = f"[{j}]" if at.ndim else ""
            raise Failed(
                f"The derivative of {name}[{i}] by {variable}{index} is {exact[i, j]:.6g}, the "
                f"difference quotient {quotient:.6g}; look for stop_gradient, rounding or a kink "
                f"there."
            )


def _quotient(block: Callable, z: Variables, variable: str, step: float) -> np.ndarray:
    """Difference quotient of fourth order by every entry of a variable, as columns."""
    at = np.atleast_1d(getattr(z, variable))
    columns = []
    for j in range(at.size):
        h = step * max(1.0, abs(at[j]))
        sides = []
        for k in (-2, -1, 1, 2):
            moved = at.copy()
            moved[j] += k * h
            value = jnp.asarray(moved.reshape(getattr(z, variable).shape))
            sides.append(np.asarray(block(z._replace(**{variable: value}))))
        columns.append((8 * (sides[2] - sides[1]) - (sides[3] - sides[0])) / (12 * h))
    return np.stack(columns, axis=1)


def check_parameters(registry: Registry, scene: MechatronicSystem) -> str:
    """Another value of a float parameter acts without compiling anything new."""
    fields = list(spec.numbers_of(type(scene)).values())
    if not fields:
        raise DoesNotApply("It has no float parameter.")
    template, points = scene.template(), _points(scene)
    names = [name for name in _ARGUMENTS if scene.has(name)]

    def blocks(s: MechatronicSystem) -> list[Any]:
        return [_block(name)(s, z) for z in points for name in names]

    traced = jax.jit(lambda p: blocks(template.with_parameters(p)))
    plain = blocks(scene)
    # A force may act in another phase alone, as that of teeth that do not touch at the start.
    later = {name: value + 1 for name, value in scene.held_values().items()}
    for field in fields:
        other = _with_another(scene, field)
        if other is None:
            continue
        if other.template() != template or other.sizes != scene.sizes:
            raise Failed(
                f"Another value of {field.name} makes another compiled scene; keep in fields "
                f"only what is declared by parameter()."
            )
        pairs = list(zip(traced(other.parameters()), blocks(other), plain, strict=True))
        if not all(np.allclose(t, p, rtol=1e-9, atol=1e-12, equal_nan=True) for t, p, _ in pairs):
            raise Failed(
                f"A traced value of {field.name} does not act as a plain one; compute from "
                f"self.{field.name} inside the blocks and not when the scene is made."
            )
        # A held value may be what one sample leaves to the next, and a quantised command hides a
        # small change.
        if field.metadata.get("held") or scene.has("sample"):
            continue
        acts = any(not np.array_equal(p, before) for _, p, before in pairs)
        if later and not acts:
            both = [blocks(s.with_parameters(s.parameters() | later)) for s in (scene, other)]
            acts = any(not np.array_equal(*pair) for pair in zip(*both, strict=True))
        if not acts and _unmoved(scene, other):
            raise Failed(f"The parameter {field.name} changes nothing; use it or remove it.")
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


def _unmoved(scene: MechatronicSystem, other: MechatronicSystem) -> bool:
    """Whether initial states, actuation, pictures and constants of the contract are the same."""
    one, two = scene.initial_state(), other.initial_state()
    pairs: list[tuple[Any, Any]] = list(zip(one, two, strict=True))
    pairs += [(getattr(scene, name), getattr(other, name)) for name in _CONSTANTS]
    if scene.has("actuation"):
        pairs.append((scene.actuation(), other.actuation()))
    if scene.has("draw"):
        pairs += zip(scene.draw(np.asarray(one.q)), other.draw(np.asarray(one.q)), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)
