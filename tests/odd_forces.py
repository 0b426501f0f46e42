"""Scenes whose force goes wrong at half the time; used by test_sundials.py as plugins."""

from dataclasses import dataclass

import numpy as np
from helpers import Probe

from problems import jnp, parameter
from problems.base.runtime import jax


@dataclass(frozen=True)
class CeasingForce(Probe):
    """A spring whose force turns NaN."""

    interval = (0.0, 1.0)
    breaks_at: float = parameter(0.5, "s", "time after which the force is another one")

    def _turns(self, t, most):
        """The spring's force in three turns of a loop, and in ``most`` after the time."""
        turns = jnp.where(t > self.breaks_at, most, 3.0)
        return jax.lax.while_loop(lambda k: k < turns, lambda k: k + 1.0, 0.0) / 3


@dataclass(frozen=True)
class CeasingSearch(CeasingForce):
    """The force turns NaN within a loop."""

    def force(self, q, v, t):
        def turn(at):
            k, sum_ = at
            return k + 1, sum_ + jnp.where(t > self.breaks_at, jnp.nan, -self.k * q / 4)

        return jax.lax.while_loop(lambda at: at[0] < 4, turn, (0, jnp.zeros(1)))[1]


@dataclass(frozen=True)
class EndlessForce(CeasingForce):
    """The force goes round for ever."""

    def force(self, q, v, t):
        return -self.k * q * self._turns(t, jnp.inf)


@dataclass(frozen=True)
class LongForce(CeasingForce):
    """The force takes a minute."""

    def force(self, q, v, t):
        return -self.k * q * jnp.minimum(self._turns(t, 1e11), 1.0)


@dataclass(frozen=True)
class RaisingForce(CeasingForce):
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
