"""Compiled functions of a scene: once per kind of scene, for any values of its parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np

from problems.base.runtime import FEW_CALLS, Array, jax, jnp
from problems.base.spec import SpecError
from problems.equations.formulations import (
    Baumgarte,
    Start,
    algebraic_iterations,
    complete,
    linearised,
    ode_rate,
)
from problems.equations.kinematics import (
    constraint_acceleration,
    constraint_velocity,
    projected_state,
)
from problems.system import MechatronicSystem
from problems.variables import INVARIANTS, VARIABLES, Variables, state_layout

#: Rows are taken in blocks of these sizes, so that two programs serve any number of rows.
_ROW_BLOCK, _LARGE_BLOCK = 256, 4096
#: Blocks of large scenes have fewer rows: at most so many numbers go into one, or one row.
_MOST_NUMBERS = 2**21
#: With more states than this there is no Jacobian: it would cost more than the runs.
MOST_STATES = 400


class Compiled:
    """Compiled functions of a scene; the first argument p is ``scene.parameters()``.

    ``linearised(p, q, v, x, t)``
        `formulations.linearised` at one time: a start, and the Jacobian of the ODE form by
        s = [q, v, x] ``(n, n)``, of scenes with more than `MOST_STATES` states ``(n, 0)``
    ``ode(p, t, s)``
        `formulations.ode_rate` of s = [q, v, x]
    ``rates(values, t, s)``
        the same at k times, arrays of shape ``(k,)`` and ``(k, n)``, with all parameters in one
        array, in the order of p: a call costs a microsecond for every array that it is given
    ``pulled(values, t, s, rate)``
        the same with Baumgarte's terms of a rate in 1/s
    ``complete(p, q, v, x, t)``
        `formulations.complete` at k times; arrays of shape ``(k, n)``, t of shape ``(k,)``, as may
        be the values of p here and below, where they jump
    ``levels(p, q, v, a, t)``
        residuals of the constraints ``(k, nh)`` and of their first two derivatives by time, beside
        those of velocities and their first one, each ``(k, nl)``, at k times
    ``invariants[block](p, q, v)``
        one of `INVARIANTS` at k times, ``(k,)`` or ``(k, n)``
    ``points(p, q)``
        the named points at k times, each ``(k, 2)`` or ``(k, 3)``
    ``events(p, q, v, x, t)``
        functions of the scene's events, and their rates along the motion, at k times, each
        ``(k, n)``
    ``sample(p, z)``, ``jumps[event](p, z)``
        values after a sample instant and after each event, as the scene states them
    ``projected(p, t, s)``
        `kinematics.projected_state` of s = [q, v, x]
    ``iterations(p, q, v, x, t)``
        iterations in `formulations.complete` at k times, ``(k,)``; for scenes with outputs
    """

    def __init__(self, template: MechatronicSystem) -> None:
        names, layout = list(template.parameters()), state_layout(template.sizes)
        states = layout.size

        def at(p: Mapping[str, Array]) -> MechatronicSystem:
            return template.with_parameters(p)

        def start(p: Mapping, q: Array, v: Array, x: Array, t: Array) -> tuple[Start, Array]:
            changes = jnp.eye(states if states <= MOST_STATES else 0, states)
            return linearised(at(p), q, v, x, t, changes)

        def rate(values: Array, t: Array, s: Array, pull: Array | None = None) -> Array:
            terms = None if pull is None else Baumgarte(pull, pull)
            return ode_rate(at(dict(zip(names, values, strict=True))), t, s, terms)

        def levels(p: Mapping, q: Array, v: Array, a: Array, t: Array) -> tuple[Array, ...]:
            s = at(p)
            phi = s.constraint(q, t) if s.sizes.nh else jnp.zeros(0)
            return phi, constraint_velocity(s, q, v, t), constraint_acceleration(s, q, v, a, t)

        def events(p: Mapping, q: Array, v: Array, x: Array, t: Array) -> tuple[Array, Array]:
            scene, s = at(p), jnp.concatenate([q, v, x])

            def values(t: Array, s: Array) -> Array:
                return scene.events(complete(scene, *layout.split(s), t)[0])

            return jax.jvp(values, (t, s), (jnp.ones_like(t), ode_rate(scene, t, s)))

        self.linearised = jax.jit(start, compiler_options=FEW_CALLS)
        self.ode = jax.jit(lambda p, t, s: ode_rate(at(p), t, s))
        self.rates = jax.jit(jax.vmap(rate, (None, 0, 0)))
        self.pulled = jax.jit(jax.vmap(rate, (None, 0, 0, None)))
        self.complete = _over_rows(lambda p, *state: complete(at(p), *state))
        self.levels = _over_rows(levels)
        self.invariants = {
            block: _over_rows(lambda p, q, v, block=block: getattr(at(p), block)(q, v))
            for block in INVARIANTS
        }
        self.points = _over_rows(lambda p, q: at(p).points(q))
        self.events = _over_rows(events)
        self.sample = jax.jit(lambda p, z: at(p).sample(z))
        self.jumps = [
            jax.jit(lambda p, z, event=event: at(p).jump(z, event))
            for event in range(_number_of_events(template))
        ]
        self.projected = jax.jit(lambda p, t, s: projected_state(at(p), t, s))
        self.iterations = _over_rows(lambda p, *state: algebraic_iterations(at(p), *state))


def compiled(scene: MechatronicSystem) -> Compiled:
    """Return the compiled functions of a scene, shared by all its parameter values."""
    return _compiled(scene.template())


_compiled = cache(Compiled)


def _number_of_events(template: MechatronicSystem) -> int:
    if not template.has("events"):
        return 0
    z: Any = [*(np.zeros(template.sizes.of(g)) for g in VARIABLES), np.zeros(())]
    shape = jax.eval_shape(template.events, Variables(*z)).shape
    if len(shape) != 1 or not shape[0]:
        raise SpecError(
            f"{template.spec}: events has shape {shape}, expected one number for each event, (n,)."
        )
    return shape[0]


def _over_rows(function: Callable) -> Callable:
    """Vectorise over rows, filled up to whole blocks; a parameter may have a value in each row."""

    def rows_at_once(p: Mapping, rows: tuple[Array, ...]) -> Any:
        axes = {name: 0 if jnp.ndim(value) else None for name, value in p.items()}
        return jax.vmap(function, (axes, *[0] * len(rows)))(p, *rows)

    large, small = jax.jit(rows_at_once), jax.jit(rows_at_once, compiler_options=FEW_CALLS)

    def call(p: Mapping, *rows: np.ndarray) -> Any:
        count, parts, first = len(rows[0]), [], 0
        width = sum(np.size(r) for r in rows) // max(count, 1)
        most = max(1, _MOST_NUMBERS // max(width, 1))
        while first < count:
            many = count - first > 4 * _ROW_BLOCK
            size, block = (_LARGE_BLOCK, large) if many else (_ROW_BLOCK, small)
            size = min(most, size)
            chosen = np.minimum(np.arange(first, first + size), count - 1)
            here = {name: value[chosen] if np.ndim(value) else value for name, value in p.items()}
            parts.append(block(here, tuple(np.asarray(r)[chosen] for r in rows)))
            first += size
        return jax.tree.map(lambda *outs: np.concatenate(outs)[:count], *parts)

    return call
