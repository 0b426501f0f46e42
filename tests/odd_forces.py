"""Scenes whose force goes wrong at half the time; used by test_sundials_endings.py as plugins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from probe import Probe

from problems import jnp, parameter
from problems.runtime import jax


@dataclass(frozen=True)
class Odd(Probe):
    """A probe whose force is that of a spring until it breaks."""

    interval = (0.0, 1.0)

    breaks_at: float = parameter(0.5, "s", "time after which the force is another one")


@dataclass(frozen=True)
class CeasingForce(Odd):
    """The force turns NaN."""


@dataclass(frozen=True)
class CeasingSearch(Odd):
    """The force turns NaN within a loop."""

    def force(self, q, v, t):
        def turn(at):
            k, sum_ = at
            return k + 1, sum_ + jnp.where(t > self.breaks_at, jnp.nan, -self.k * q / 4)

        return jax.lax.while_loop(lambda at: at[0] < 4, turn, (0, jnp.zeros(1)))[1]


@dataclass(frozen=True)
class EndlessForce(Odd):
    """The force goes round for ever."""

    def force(self, q, v, t):
        turns = jnp.where(t > self.breaks_at, jnp.inf, 3.0)
        last = jax.lax.while_loop(lambda k: k < turns, lambda k: k + 1.0, 0.0)
        return -self.k * q * (last / 3)


@dataclass(frozen=True)
class LongForce(Odd):
    """The force takes a minute."""

    def force(self, q, v, t):
        turns = jnp.where(t > self.breaks_at, 1e11, 3.0)
        last = jax.lax.while_loop(lambda k: k < turns, lambda k: k + 1.0, 0.0)
        return -self.k * q * jnp.minimum(last / 3, 1.0)


@dataclass(frozen=True)
class RaisingForce(Odd):
    """The force is a function of Python that raises."""

    def force(self, q, v, t):
        def value(q, t, breaks_at):
            if t > breaks_at:
                raise ValueError("no force is known here")
            return np.asarray(-4.0 * q)

        @jax.custom_jvp
        def called(q, t):
            result, given = jax.ShapeDtypeStruct((1,), float), (q, t, self.breaks_at)
            return jax.pure_callback(value, result, *given, vmap_method="sequential")

        called.defjvp(lambda at, along: (called(*at), -4.0 * along[0]))
        return called(q, t)
