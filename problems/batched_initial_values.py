"""Consistent initial values of many scenes of one kind at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from problems.answers import FalseAnswer
from problems.formulations import Start, constraint_velocity, with_rates
from problems.initial_values import (
    CONSISTENCY_TOLERANCE,
    InconsistentStart,
    NoConsistentStart,
    consistent_start,
)
from problems.runtime import jax, jnp
from problems.system import MechatronicSystem, State

if TYPE_CHECKING:
    from jax import Array


def consistent_starts(scenes: Sequence[MechatronicSystem]) -> tuple[Start, dict[int, str]]:
    """Compute `consistent_start` of k scenes that differ in float parameters alone.

    One compiled call serves all of them; separate calls would take milliseconds each. A scene
    whose residual is not small, or whose values are not finite, is computed again alone, so that
    the decision and the message are those of a single run.

    Returns
    -------
    Start
        NumPy arrays with an axis of length k in front; NaN where there is no start.
        ``constrained_jerk`` is None.
    dict
        Indices of the scenes that have no consistent start, each with the reason.
    """
    first = scenes[0]
    states = [map(np.asarray, scene.initial_state()) for scene in scenes]
    settings = [scene.parameters() for scene in scenes]
    parameters = {name: np.array([values[name] for values in settings]) for name in settings[0]}
    count, filled = len(scenes), 1 << (len(scenes) - 1).bit_length()
    places = np.minimum(np.arange(filled), count - 1)  # few sizes are compiled
    program = _program(first.template())
    parts = (np.array(part, dtype=float)[places] for part in zip(*states, strict=True))
    together = State(*parts)
    answer = program({n: v[places] for n, v in parameters.items()}, *together, first.interval[0])
    start, violation = jax.tree.map(lambda part: np.array(part)[:count], answer)
    numbers = np.column_stack([part.reshape(count, -1) for part in jax.tree.leaves(start)])
    # Another program rounds differently: scenes near the limit are computed alone, too.
    good = np.isfinite(numbers).all(axis=1) & (violation <= 0.5 * CONSISTENCY_TOLERANCE)
    refused: dict[int, str] = {}
    for k in np.flatnonzero(~good).tolist():
        try:
            alone = consistent_start(scenes[k])._replace(constrained_jerk=None)
        except (InconsistentStart, NoConsistentStart, FalseAnswer) as error:
            refused[k] = str(error)
            continue
        for table, row in zip(jax.tree.leaves(start), jax.tree.leaves(alone), strict=True):
            table[k] = row
    return start, refused


@cache
def _program(template: MechatronicSystem) -> Callable[..., tuple[Start, Array]]:
    """Program of (parameters, q, v, x, t) of many scenes: starts, and the largest violation of the
    constraints in units of q and v."""

    def one(p: Mapping, q: Array, v: Array, x: Array, t: float) -> tuple[Start, Array]:
        scene, now = template.with_parameters(p), jnp.asarray(t, dtype=float)
        worst = jnp.asarray(0.0)
        start = with_rates(scene, q, v, x, now)
        if scene.sizes.nl:
            levels = (scene.constraint(q, now), q), (constraint_velocity(scene, q, v, now), v)
            for residual, of in levels:
                scale = jnp.maximum(1.0, jnp.max(jnp.abs(of)))
                worst = jnp.maximum(worst, jnp.max(jnp.abs(residual)) / scale)
        return start, worst

    return jax.jit(jax.vmap(one, in_axes=(0, 0, 0, 0, None)))
