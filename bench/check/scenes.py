"""The checks that every scene has to pass."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np

from bench.check.trials import reference
from bench.check.verdicts import DoesNotApply, Failed, round_trip, shortly
from bench.plugins.registry import Registry
from bench.running.errors import relative_reference_error
from problems import ContactSystem, jax, jnp
from problems.base import checks, spec
from problems.equations.compiled import compiled
from problems.equations.initial_values import consistent_start
from problems.equations.kinematics import constraint_change, q_rate
from problems.hybrid.phases import Samples, after
from problems.system import MechatronicSystem
from problems.truth.reference import published_digits
from problems.variables import INVARIANTS, Variables

#: Largest estimated error of a reference in q and v, relative to their largest values.
_REFERENCE_ERROR = 1e-8
#: Largest d/dt E along the reference, relative to the powers that it is the sum of; a closed form
#: fits the equations of motion and its own slopes to the same.
_RATE_ERROR = 1e-6
#: Its difference quotients are tried with these parts of the nominal step, which may be longer
#: than the fastest oscillation.
_SLOPE_STEPS = (1e-2, 1e-3, 1e-4, 1e-5)
_TIMES = 40
#: A movement follows dq/dt to this, relative to the largest rate.
_MOVE_ERROR = 1e-9
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


def check_description(registry: Registry, scene: MechatronicSystem) -> str:
    """Docstring, interval, step, names and units can be shown, and parameters are read back."""
    if not inspect.getdoc(type(scene)):
        raise Failed("It has no docstring; say what the scene tests and what it leaves out.")
    if fault := checks.fault_of_times(scene.interval, scene.nominal_step):
        raise Failed(fault)
    length, step = float(np.ptp(scene.interval)), scene.nominal_step
    if not step <= length / 4:
        raise Failed(
            f"The nominal step {step:g} s does not fit the interval of {length:g} s; take the "
            f"largest step that resolves the motion."
        )
    names = {"coordinates": "q", "multipliers": "lam", "states": "x", "outputs": "y"}
    if scene.has("kinematics"):
        names["velocities"] = "v"
    for attribute, group in names.items():
        scene.components(group)  # refuses names that are no text, and sizes that are no numbers
        named = getattr(scene, attribute)
        named = 1 if isinstance(named, str) else len(named)
        if named not in (0, size := scene.sizes.of(group)):
            raise Failed(f"{named} {attribute} are named, {group} has {size} entries.")
    checks.texts(scene.tags, "tags")
    checks.texts(scene.difficulties, "difficulties")
    checks.text(scene.source, "source")
    for item in checks.description(scene)["parameters"]:
        if isinstance(item["value"], float) and not item["unit"].strip():
            raise Failed(f"The parameter {item['name']} has no unit; give '1' for a pure number.")
        if not item["doc"].strip():
            raise Failed(f"The parameter {item['name']} has no description; say what it is.")
    return f"{round_trip(registry.problem, scene)}."


# ---- the start ---------------------------------------------------------------------------
def check_start(registry: Registry, scene: MechatronicSystem) -> str:
    """The start is consistent, with a regular augmented matrix, and new values can be used."""
    try:
        z = consistent_start(scene).z
    except ValueError as error:
        raise Failed(str(error)) from error
    for block, size in (("state_rate", scene.sizes.nx), ("output", scene.sizes.ny)):
        shape = jax.eval_shape(getattr(scene, block), z).shape if scene.has(block) else (size,)
        if shape != (size,):
            raise Failed(f"{block} has shape {shape}, expected {(size,)}.")
    told = _check_mass(scene)
    if scene.has("move"):
        _check_move(scene)
    if scene.has("events") and not np.isfinite(values := np.asarray(scene.events(z))).all():
        raise Failed(f"events is {values} at the start, expected finite numbers.")
    jumps = [None] * scene.has("sample")
    jumps += [*range(len(compiled(scene).jumps))] if scene.has("events") else []
    Samples.of(scene)
    for event in jumps:  # new values that cannot be used are refused
        phase = scene.phase(scene.interval[0], scene.start(), scene.held_values())
        after(phase, jax.tree.map(np.asarray, z), event)
    told += f"; {len(jumps)} samples or events give values that can be used" if jumps else ""
    own = scene.sizes._asdict() | {"nh": 0}
    own["nv"] *= own["nv"] != own["nq"]
    shown = ", ".join(f"{name}={size}" for name, size in own.items() if size)
    return f"Consistent at t={scene.interval[0]:g} s: {shown}; the augmented matrix {told}."


def _check_mass(scene: MechatronicSystem) -> str:
    """M is symmetric, and the augmented matrix has the rank at the start that is stated."""
    q = jnp.asarray(scene.initial_state().q, dtype=float)
    mass = np.asarray(scene.mass(q))
    size, skew, nl = np.abs(mass).max(), np.abs(mass - mass.T), scene.sizes.nl
    if not skew.max() <= 1e-12 * size:
        i, j = np.unravel_index(skew.argmax(), skew.shape)
        raise Failed(
            f"mass is not symmetric at the start: M[{i},{j}]={mass[i, j]:.9g}, "
            f"M[{j},{i}]={mass[j, i]:.9g}; it has to be, as a second derivative of the energy."
        )
    augmented = mass / size
    if nl:
        change = partial(constraint_change, scene, q, jnp.asarray(scene.interval[0]))
        jacobian = np.asarray(jax.jacfwd(change)(jnp.zeros(scene.sizes.nv)))
        # Rows of any unit: each is scaled to its own size, and a row of zeros stays one.
        rows = np.abs(jacobian).max(axis=1, keepdims=True)
        jacobian = jacobian / np.where(rows > 0, rows, 1.0)
        augmented = np.block([[augmented, jacobian.T], [jacobian, np.zeros((nl, nl))]])
    singular = np.linalg.svd(augmented, compute_uv=False)
    missing = np.count_nonzero(singular <= 1e-12 * singular[0])
    if missing != scene.redundant:
        raise Failed(
            f"The matrix [[M, Phi_q^T], [Phi_q, 0]] lacks {missing} rank at the start, and "
            f"redundant = {scene.redundant} is stated; remove dependent constraints or state how "
            f"many they are, or give every coordinate a mass or a constraint."
        )
    if scene.has("mass_product"):
        a = jnp.asarray(np.random.default_rng(1).normal(size=scene.sizes.nv))
        difference = np.abs(np.asarray(scene.mass_product(q, a)) - mass @ np.asarray(a)).max()
        if not difference <= 1e-12 * size * len(q):
            raise Failed(f"mass_product differs from mass times a vector by {difference:.2g}.")
    return f"lacks {missing} rank, as stated" if missing else "is regular"


def _check_move(scene: MechatronicSystem) -> None:
    """A displacement s w leads along dq/ds = T(q) w, from q itself."""
    q, v, _ = map(jnp.asarray, scene.initial_state())
    w = jnp.asarray(np.random.default_rng(1).uniform(-1, 1, v.shape))
    there, rate = jax.jvp(lambda s: scene.move(q, s * w), (1.0,), (1.0,))
    for of, one, other in (
        ("move by zero", scene.move(q, 0 * w), q),
        ("the rate of move", rate, scene.kinematics(there, w)),
    ):
        difference = np.abs(np.asarray(one - other)).max()
        if not difference <= _MOVE_ERROR * np.abs(np.asarray(other)).max():
            raise Failed(
                f"{of} differs by {difference:.2g} from what kinematics leads to; let move(q, w) "
                f"follow dq/ds = kinematics(q, w) for one second."
            )


# ---- blocks: pure, differentiable, and with parameters that are traced -------------------
def _block(name: str, scene: MechatronicSystem, z: Variables) -> Any:
    """The values of a block as a vector.

    The mass matrix is multiplied by a vector, so that its derivative stays small. Of jumps, that at
    the first event is taken.
    """
    wanted = _ARGUMENTS[name]
    given = [z] if wanted == "z" else [getattr(z, w) for w in wanted]
    value = getattr(scene, name)(*given, *([0] if name == "jump" else []))
    if name in ("sample", "jump"):  # new values by name
        value = jnp.concatenate([jnp.ravel(part) for part in value.values()])
    if name == "mass":
        value = value @ jnp.cos(jnp.arange(value.shape[-1], dtype=float))
    return jnp.ravel(jnp.asarray(value))


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
        block = partial(_block, name, scene)
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
            return ""
        except AssertionError as error:
            fault = f"{shortly(error)} Look for stop_gradient, rounding, a kink or a root of zero."
    return fault


def check_parameters(registry: Registry, scene: MechatronicSystem) -> str:
    """Another value of a float parameter acts without compiling anything new."""
    fields = list(spec.numbers_of(type(scene)).values())
    if not fields:
        raise DoesNotApply("It has no float parameter.")
    template, points = scene.template(), _points(scene)
    names = [name for name in _ARGUMENTS if scene.has(name)]

    def blocks(s: MechatronicSystem) -> list[Any]:
        return [jnp.stack([_block(name, s, z) for z in points]) for name in names]

    traced = jax.jit(lambda p: blocks(template.with_parameters(p)))
    for field in fields:
        if not (other := _with_another(scene, field)):
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
        with suppress(spec.SpecError):
            return spec.build(type(scene), options | {field.name: changed}, scene.name)
    return None


# ---- the motion --------------------------------------------------------------------------
def check_reference(registry: Registry, scene: MechatronicSystem) -> str:
    """The reference is accurate, solves the equations, has published digits and can be drawn."""
    exact = reference(scene, scene.interval[1])
    if scene.has_closed_form:
        _check_closed_form(scene)
    own = relative_reference_error(exact)
    for group in ("q", "v"):
        if not own[group] < _REFERENCE_ERROR:
            raise Failed(
                f"The reference ({exact.method}) knows {group} to {own[group]:.1e} only; "
                f"shorten the interval: it must not last until neighbours have parted."
            )
    drawn = "; nothing is drawn: state `draw` to show the motion in reports"
    if scene.has("draw"):
        lines = [checks.drawing(scene.draw(q)) for q in _along(scene)[1]["q"]][-1]
        drawn = f"; {len(lines)} lines are drawn at all times"
    told = f"{exact.method}; relative error {max(own['q'], own['v']):.1e} in q and v"
    return f"{told}{check_published(scene)}{drawn}."


def _check_closed_form(scene: MechatronicSystem) -> None:
    """It begins at the initial state, dq/dt follows v, v' = a, and the forces agree."""
    t, values = _along(scene)
    start, state = consistent_start(scene).z, [values[group] for group in ("q", "v", "x")]
    solved, _ = compiled(scene).complete(scene.parameters(), *state, t)
    rate = np.array([q_rate(scene, q, v) for q, v in zip(*state[:2], strict=True)])
    slopes: dict[str, list[np.ndarray]] = {"q": [], "v": []}
    for h in np.multiply(_SLOPE_STEPS, scene.nominal_step):  # quotients of fourth order
        at = {k: scene.exact(t + k * h) for k in (-2, -1, 1, 2)}
        for group, found in slopes.items():
            one, two = (np.subtract(at[k][group], at[-k][group]) for k in (1, 2))
            found.append((8 * one - two) / (12 * h))
    for name, own, others in (
        *((f"{g} at the start", values[g], [[getattr(start, g), *values[g][1:]]]) for g in "qv"),
        *((f"{g} of the equations", values[g], [getattr(solved, g)]) for g in ("a", "lam")),
        ("the slope of q", rate, slopes["q"]),
        ("the slope of v", values["a"], slopes["v"]),
    ):
        off = min((np.abs(own - o) for o in others), key=lambda off: off.max(initial=0.0))
        size = np.abs(own).max(initial=0.0) or 1.0
        if not off.max(initial=0.0) <= _RATE_ERROR * size:
            raise Failed(
                f"`exact` is no solution: {name} is off by {off.max():.2g} (of {size:.2g}) at "
                f"t={t[off.max(axis=1).argmax()]:.4g} s; correct `exact` or the blocks."
            )


def check_published(scene: MechatronicSystem) -> str:
    """The reference has the published digits, up to their tolerances."""
    if not (own := checks.published(scene.published)):
        return ""
    end, t = max(scene.interval[1], *(p.t for p in own)), np.unique([p.t for p in own])
    parts = []
    for stated, computed in published_digits(scene, t, reference(scene, end)(t)):
        difference = np.abs(computed - stated.values).max()
        if not difference <= stated.tolerance:
            raise Failed(
                f"{stated.quantity} at t={stated.t:g} s differs from the published digits by "
                f"{difference:.2g}, more than the tolerance of {stated.tolerance:.2g}."
            )
        parts.append(difference / stated.tolerance)
    if not parts:
        return "; published digits belong to its default parameters"
    return f"; {len(parts)} published values agree, up to {max(parts):.2g} of their tolerances"


def check_conserved(registry: Registry, scene: MechatronicSystem) -> str:
    """Energy and momenta stay as they are along the reference."""
    told = [_check_invariant(scene, block) for block in INVARIANTS if scene.has(block)]
    if not told:
        raise DoesNotApply("It states no energy and no momentum.")
    return f"Along the reference: {'; '.join(told)}."


def _check_invariant(scene: MechatronicSystem, block: str) -> str:
    """No entry f of an invariant changes along the motion: f_q dq/dt + f_v a = 0."""
    q, v, _ = map(jnp.asarray, scene.initial_state())
    first, (unit, kinetic) = getattr(scene, block)(q, v), INVARIANTS[block]
    if kinetic:
        checks.number(first, f"{block}()")
    elif not jnp.size(first):
        raise Failed(f"{block}() has no entry; leave it out.")
    t, values = _along(scene)
    entries = lambda q, v: jnp.atleast_1d(getattr(scene, block)(q, v))  # noqa: E731
    by = jax.jit(jax.jacrev(entries, argnums=(0, 1)))
    rates = []
    for q, v, a in zip(*(jnp.asarray(values[g]) for g in ("q", "v", "a")), strict=True):
        by_q, by_v = by(q, v)
        rates.append(np.concatenate([by_q * q_rate(scene, q, v), by_v * a], axis=1))
    net, parts = np.abs(np.sum(rates, axis=2)).max(axis=1), np.abs(rates).sum(axis=2).max(axis=1)
    if not net.max() <= _RATE_ERROR * max(parts.max(), np.finfo(float).tiny):
        raise Failed(
            f"d/dt {block} is {net.max():.2g} {unit} at t={t[net.argmax()]:.4g} s, of parts of "
            f"{parts.max():.2g} {unit}; let the {block} fit the forces, or leave it out where it "
            f"is not conserved."
        )
    return f"d/dt {block} is below {net.max():.1e} {unit}, of parts of {parts.max():.2g} {unit}"


def _along(scene: MechatronicSystem) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times spread over the interval, and the reference there."""
    t = np.linspace(*scene.interval, _TIMES)
    return t, reference(scene, scene.interval[1])(t)


SCENE_CHECKS = {
    "description": check_description,
    "start": check_start,
    "blocks": check_blocks,
    "parameters": check_parameters,
    "reference": check_reference,
    "conserved": check_conserved,
}
