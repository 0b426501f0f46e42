"""Consistent starts of many scenes of one kind at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np

from problems.formulations import (
    CONSISTENCY_TOLERANCE,
    InconsistentStart,
    NoConsistentStart,
    Start,
    consistent_start,
    constraint_velocity,
    with_rates,
)
from problems.runtime import jax, jnp
from problems.system import MechatronicSystem, State, Variables


def consistent_starts(scenes: Sequence[MechatronicSystem]) -> tuple[Start, dict[int, str]]:
    """What `consistent_start` gives for each of k scenes that differ in float parameters alone.

    One compiled call does for all of them what costs milliseconds for each. A scene that it finds
    suspicious is asked alone, so that the verdict and its words are those of a single run.

    Returns
    -------
    Start
        Every array with an axis of length k in front; NaN where there is no start.
    dict
        The places of the scenes that have no consistent start, and why.
    """
    first = scenes[0]
    states = [_state(scene) for scene in scenes]
    settings = [scene.parameters() for scene in scenes]
    parameters = {name: np.array([values[name] for values in settings]) for name in settings[0]}
    count, filled = len(scenes), 1 << (len(scenes) - 1).bit_length()
    places = np.minimum(np.arange(filled), count - 1)  # few sizes are compiled
    program = _program(first.template())
    t0 = first.interval[0]
    together = State(*(np.array(part)[places] for part in zip(*states, strict=True)))
    answer = program({n: v[places] for n, v in parameters.items()}, *together, t0)
    start, violation = jax.tree.map(lambda part: np.array(part)[:count], answer)
    numbers = np.column_stack([part.reshape(count, -1) for part in jax.tree.leaves(start)])
    # Another program rounds differently: what is near the limit is asked alone, too.
    good = np.isfinite(numbers).all(axis=1) & (violation <= 0.5 * CONSISTENCY_TOLERANCE)
    refused = {}
    for k in np.flatnonzero(~good):
        try:
            alone = consistent_start(scenes[k])
        except (InconsistentStart, NoConsistentStart) as error:
            refused[int(k)] = str(error)
            continue
        for table, row in zip(jax.tree.leaves(start), jax.tree.leaves(alone), strict=True):
            table[k] = row
    return start, refused


def _state(scene: MechatronicSystem) -> State:
    return State(*(np.asarray(part, dtype=float) for part in scene.initial_state()))


@cache
def _program(template: MechatronicSystem) -> Callable:
    """Program of (parameters, q, v, x, t) of many scenes: starts, and the largest violation of the
    constraints in units of q and v."""

    def one(p: dict, q: object, v: object, x: object, t: object) -> tuple:
        scene, t = template.with_parameters(p), jnp.asarray(t, dtype=float)
        z, *rates = with_rates(scene, q, v, x, t)
        worst = jnp.asarray(0.0)
        if scene.sizes.nl:
            levels = (scene.constraint(q, t), q), (constraint_velocity(scene, q, v, t), v)
            for residual, of in levels:
                scale = jnp.maximum(1.0, jnp.max(jnp.abs(of)))
                worst = jnp.maximum(worst, jnp.max(jnp.abs(residual)) / scale)
        return Start(Variables(*z), *rates), worst

    return jax.jit(jax.vmap(one, in_axes=(0, 0, 0, 0, None)))
