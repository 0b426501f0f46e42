"""Rows of a trajectory in the form that the compiled time loops store."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from integrators.kept_rows import most_rows
from integrators.native.step_records import Reading, largest
from problems.formulations import Start
from problems.runtime import jax, jnp

if TYPE_CHECKING:
    from collections.abc import Callable

    from jax import Array
    from jaxtyping import Bool, Float, Int

#: A run whose q and v, or x, have grown by this factor is called diverged.
GROWTH_LIMIT = 1e12
#: Rows that are spread over a run, besides the first; fewer of large scenes. They are halved.
_SPREAD_SLOTS = 400


def flat(reading: Reading) -> Float[Array, " n"]:
    """All numbers of a reading in one array."""
    return jnp.concatenate([jnp.atleast_1d(part) for part in jax.tree.leaves(reading)])


def bounded(first: Reading) -> Callable[[Reading], Bool[Array, ""]]:
    """The test that a reading is finite and has not grown beyond all bounds since the first one."""
    bound = GROWTH_LIMIT * (1.0 + largest(first.q, first.v))
    bound_x = GROWTH_LIMIT * (1.0 + largest(first.x, 0.0))

    def sane(now: Reading) -> Bool[Array, ""]:
        # A comparison with NaN is false: not finite counts as grown beyond the bound.
        grown_little = (largest(now.q, now.v) < bound) & (largest(now.x, 0.0) < bound_x)
        return grown_little & jnp.isfinite(largest(now.a, now.lam, now.xdot, now.y))

    return sane


class SpreadRows(NamedTuple):
    """Rows of a run with an unknown number of steps: wanted ones in order, others spread over it.

    When the spread is full, every other row of it is dropped and the stride doubles.
    """

    early: Float[Array, "e n"]
    spread: Float[Array, "s n"]
    stride: Int[Array, ""]

    @classmethod
    def empty(cls, slots: int, width: int, spread: bool) -> Self:
        """Room for ``slots`` rows in order, and for a spread if wanted."""
        room = min(_SPREAD_SLOTS, most_rows(width) // 2 * 2) if spread else 0
        return cls(jnp.zeros((slots, width)), jnp.zeros((room, width)), jnp.asarray(1))

    def with_row(self, n: Array, row: Array, wanted: Array) -> Self:
        """Store the row of the n-th step; rows in order begin with ``wanted``, 0 keeps none."""
        place = n - wanted
        at = jnp.where((wanted > 0) & (place >= 0), place, len(self.early))
        early = self.early.at[at].set(row, mode="drop")
        room = len(self.spread)
        slot, hit = n // self.stride - 1, (wanted > 0) & (n % self.stride == 0)
        spread = self.spread.at[jnp.where(hit, slot, room)].set(row, mode="drop")
        full = hit & (slot == room - 1)

        def thin(spread: Array) -> Array:
            return jnp.zeros_like(spread).at[: room // 2].set(spread[1::2])

        spread = jax.lax.cond(full, thin, lambda spread: spread, spread)
        return self._replace(early=early, spread=spread, stride=jnp.where(full, 2, 1) * self.stride)


def with_start(start: Start, rows: np.ndarray, noted: tuple[str, ...]) -> dict[str, Any]:
    """Fields of a Trajectory from rows ``(k, [t, q, v, a, lam, x, xdot, y, notes])`` of a kernel.

    The scene's start is the first row; its notes are NaN, because no step led to it.
    """
    z, nothing = start.z, np.full(len(noted), np.nan)
    first = [np.atleast_1d(p) for p in (z.t, z.q, z.v, z.a, z.lam, z.x, start.xdot, z.y, nothing)]
    table = np.concatenate([np.concatenate(first)[None], rows])
    cuts = np.cumsum([len(part) for part in first])[:-1]
    t, *groups, notes = np.split(table, cuts, axis=1)
    return {
        "t": t[:, 0],
        **dict(zip(Reading._fields[:-1], groups, strict=True)),
        "notes": dict(zip(noted, notes.T, strict=True)),
    }
