"""Derivatives of a motion by parameters of its scene: at the start, and exact ones at the end.

The exact ones solve the variational equations of the explicit ODE, S' = f_s S + f_p, beside the
motion, by Gauss' collocation of order 24. Their error is the difference from Radau IIA of order 23
with other steps. Where values jump, references of other parameters are differenced and extrapolated
(Richardson), and the widths with the least estimated error are taken. No integrator of the bench
takes part.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from io import BytesIO
from typing import Any, NamedTuple

import numpy as np

from problems.collocation import TooSmallStep, gauss, integrate, radau
from problems.formulations import Start, complete, ode_rate, with_rates
from problems.initial_values import consistent_start
from problems.layouts import state_layout
from problems.reference import Reference, ReferenceFailed, once
from problems.runtime import Array, Float, jax, jnp
from problems.system import MechatronicSystem
from problems.variables import VARIABLES, State

#: Largest difference of a parameter, relative to it, and how often it is halved.
_DIFFERENCE, _HALVINGS = 0.04, 3
_TOLERANCE = 3e-14
#: Changes of the state by a whole parameter below this part of the state are none.
_NO_CHANGE = 1e-4
#: Longest steps of the two integrations, in nominal steps.
_LONGEST = 4, 3
#: How often differences of references are halved at most, and the relative error that is enough.
_MOST_HALVINGS, _ENOUGH = 11, 1e-11
#: Largest estimated error of a derivative, relative to itself or to its scene's natural size.
_TRUSTED = 1e-4


class Sensitivities(NamedTuple):
    """Values at the end of a motion, their derivatives and these ones' errors, by group.

    Attributes
    ----------
    values
        Arrays of shape (n,), in the units of the scene.
    derivatives, errors
        Arrays of shape (n, k), in these units per unit of each of the k parameters.
    """

    values: dict[str, Float[np.ndarray, " n"]]
    derivatives: dict[str, Float[np.ndarray, "n k"]]
    errors: dict[str, Float[np.ndarray, "n k"]]


def size_of(scene: MechatronicSystem, name: str) -> float:
    """Return the size of a parameter in its unit: its absolute value, or 1 if it is zero."""
    return abs(scene.parameters()[name]) or 1.0


def initial_changes(scene: MechatronicSystem, name: str) -> State:
    """Differentiate q, v and x at the start, which are NumPy's, by a parameter.

    Central differences are extrapolated to order eight (Richardson).
    """
    p, size = scene.parameters(), size_of(scene, name)

    def central(part: float) -> np.ndarray:
        ends = (
            np.concatenate(scene.with_parameters(p | {name: p[name] + h}).start())
            for h in (part * size, -part * size)
        )
        return np.subtract(*ends) / (2 * part * size)

    row = [central(_DIFFERENCE / 2**k) for k in range(_HALVINGS + 1)]
    for k in range(1, _HALVINGS + 1):
        pairs = zip(row[1:], row, strict=False)
        row = [fine + (fine - coarse) / (4**k - 1) for fine, coarse in pairs]
    return State(*state_layout(scene.sizes).split(row[0]))


def start_changes(scene: MechatronicSystem, by: Sequence[str]) -> Start:
    """Differentiate the consistent start by k parameters: arrays with an axis of length k in front.

    Raises
    ------
    ReferenceFailed
        If a derivative is not finite.
    """
    p, start = scene.parameters(), scene.start()
    template, t = scene.template(), jnp.asarray(scene.interval[0])

    def rates(p: dict, q: Array, v: Array, x: Array) -> Start:
        return with_rates(template.with_parameters(p), q, v, x, t)

    program = jax.jit(lambda at, change: jax.jvp(rates, at, change)[1])
    at = jax.tree.map(jnp.asarray, (p, *start))
    rows = []
    for name in by:
        change = {other: float(other == name) for other in p}, *initial_changes(scene, name)
        rows.append(program(at, jax.tree.map(jnp.asarray, change)))
    found = jax.tree.map(lambda *parts: np.stack(parts), *rows)
    if not all(np.isfinite(part).all() for part in jax.tree.leaves(found)):
        raise ReferenceFailed(f"The start of {scene.spec} has no derivative by {', '.join(by)}.")
    return found


def sensitivities(scene: MechatronicSystem, t_end: float, by: Sequence[str]) -> Sensitivities:
    """Compute values at t_end in s and their exact derivatives by k float parameters, once for all
    processes (see `reference.keep_references`).

    Raises
    ------
    ReferenceFailed
        If the scene is too large, or no step is small enough; or if values jump, and the number of
        events changes with a parameter.
    """
    if missing := Reference(scene, t_end).missing:
        raise ReferenceFailed(missing.replace("No reference is", "No exact derivatives are"))
    solved = _through_jumps if scene.is_hybrid else _along_the_motion
    return once(scene, t_end, lambda: solved(scene, t_end, by), _read, _written, by)


def _written(found: Sensitivities) -> bytes:
    parts = found._asdict().items()
    np.savez(
        content := BytesIO(), **{f"{part} {g}": by[g] for part, by in parts for g in VARIABLES}
    )
    return content.getvalue()


def _read(content: bytes) -> Sensitivities:
    with np.load(BytesIO(content), allow_pickle=False) as file:
        parts = Sensitivities._fields
        return Sensitivities(*({g: file[f"{part} {g}"] for g in VARIABLES} for part in parts))


def _along_the_motion(scene: MechatronicSystem, t_end: float, by: Sequence[str]) -> Sensitivities:
    """`sensitivities` by the variational equations."""
    template, p = scene.template(), scene.parameters()
    at, n, k = state_layout(scene.sizes), state_layout(scene.sizes).size, len(by)
    sizes = np.array([size_of(scene, name) for name in by])

    def along(function: Callable, p: dict, s: Array, changes: Array) -> tuple[Any, Any]:
        """A function of (scene, s), and its changes with those of s and of each parameter."""

        def one(change: Array, seed: Array) -> tuple[Any, Any]:
            moved = p | dict(zip(by, seed, strict=True))
            tangent = {name: moved[name] if name in by else 0.0 * p[name] for name in p}
            return jax.jvp(
                lambda p, s: function(template.with_parameters(p), s), (p, s), (tangent, change)
            )

        return jax.vmap(one, out_axes=(None, 0))(changes, jnp.diag(jnp.asarray(sizes)))

    def rate(p: dict, t: Array, w: Array) -> Array:
        s, changes = w[:n], w[n:].reshape(k, n)
        return jnp.concatenate(
            [jnp.ravel(x) for x in along(lambda sc, s: ode_rate(sc, t, s), p, s, changes)]
        )

    def end(p: dict, w: Array) -> tuple[dict, dict]:
        def groups(scene: MechatronicSystem, s: Array) -> dict[str, Array]:
            z, _ = complete(scene, *at.split(s), jnp.asarray(t_end))
            return {group: getattr(z, group) for group in VARIABLES}

        return along(groups, p, w[:n], w[n:].reshape(k, n))

    rates, start = jax.jit(jax.vmap(rate, (None, 0, 0))), consistent_start(scene).z
    changes = [
        size * np.concatenate(initial_changes(scene, b)) for b, size in zip(by, sizes, strict=True)
    ]
    first = np.concatenate([start.q, start.v, start.x, *changes])
    groups = at.q, at.v, at.x
    # A derivative that is zero is rounding, which is no size.
    least = np.zeros(len(first))
    least[n:] = _NO_CHANGE * (np.abs(first[:n]).max(initial=0.0) or 1.0)
    parts = [slice(i * n + g.start, i * n + g.stop) for i in range(k + 1) for g in groups]
    found = []
    for method, longest, factor in zip((gauss(), radau()), _LONGEST, (1, 2), strict=True):
        try:
            motion = integrate(
                lambda t, w: np.asarray(rates(p, t, w)),
                first,
                (scene.interval[0], t_end),
                groups=parts,
                method=method,
                tolerance=factor * _TOLERANCE,
                longest=longest * scene.nominal_step,
                least=least,
            )
        except TooSmallStep as error:
            raise ReferenceFailed(f"No exact derivatives of {scene.spec}: {error}.") from None
        values, derivatives = jax.jit(end)(p, motion(np.array([t_end]))[0])
        per_unit = {g: np.asarray(d).T / sizes for g, d in derivatives.items()}
        found.append(({g: np.asarray(v) for g, v in values.items()}, per_unit))
    (values, ours), (_, other) = found
    return Sensitivities(values, ours, {g: np.abs(ours[g] - other[g]) for g in VARIABLES})


def _through_jumps(scene: MechatronicSystem, t_end: float, by: Sequence[str]) -> Sensitivities:
    """`sensitivities` of a motion whose values jump, by differences of references."""
    if scene.has("sample") and "sample_time" in by:
        raise ReferenceFailed(
            f"No exact derivatives of {scene.spec} by sample_time are computed: it moves the "
            f"samples, and their number changes."
        )
    values, events = Reference(scene, t_end).end()
    columns = [_extrapolated(scene, t_end, name, values, events[:, 1]) for name in by]
    derivatives, errors = (
        {g: np.stack([column[part][g] for column in columns], axis=1) for g in VARIABLES}
        for part in (0, 1)
    )
    return Sensitivities({g: values[g] for g in VARIABLES}, derivatives, errors)


def _extrapolated(
    scene: MechatronicSystem,
    t_end: float,
    name: str,
    values: dict[str, np.ndarray],
    events: np.ndarray,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Derivatives by a parameter and their errors, by group: for each number the extrapolation of
    central differences that differs least from those it is made of (Ridders 1982)."""
    p, size = scene.parameters(), size_of(scene, name)
    cuts = np.cumsum([len(values[group]) for group in VARIABLES])[:-1]

    def end(change: float) -> np.ndarray | None:
        changed = scene.with_parameters(p | {name: p[name] + change})
        try:
            found, jumps = Reference(changed, t_end).end()
        except ReferenceFailed:
            return None
        same = np.array_equal(jumps[:, 1], events)
        return np.concatenate([found[group] for group in VARIABLES]) if same else None

    natural = np.abs(np.concatenate([values[group] for group in VARIABLES])) / size
    best = np.zeros_like(natural)
    errors = np.full(len(best), np.inf)
    row: list[np.ndarray] = []
    for k in range(_MOST_HALVINGS + 1):
        change = size * _DIFFERENCE / 2**k
        ends = end(change), end(-change)
        if ends[0] is None or ends[1] is None:
            row = []
            continue
        row, coarse = [(ends[0] - ends[1]) / (2 * change)], row
        for j, before in enumerate(coarse):
            row.append(row[j] + (row[j] - before) / (4 ** (j + 1) - 1))
            error = np.maximum(np.abs(row[-1] - row[j]), np.abs(row[-1] - before))
            better = error < errors
            best, errors = np.where(better, row[-1], best), np.where(better, error, errors)
        if (errors <= _ENOUGH * np.maximum(np.abs(best), natural)).all():
            break
    if np.isinf(errors).any():
        raise ReferenceFailed(
            f"No exact derivatives of {scene.spec} by {name}: the number of events up to "
            f"t={t_end:g} s changes with it; take another end."
        )
    if (errors > _TRUSTED * np.maximum(np.abs(best), natural.max())).any():
        raise ReferenceFailed(
            f"No exact derivatives of {scene.spec} by {name}: the values at t={t_end:g} s are no "
            f"smooth function of it; take another end."
        )
    return tuple(  # pyright: ignore[reportReturnType]
        dict(zip(VARIABLES, np.split(part, cuts), strict=True)) for part in (best, errors)
    )
