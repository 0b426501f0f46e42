"""Rows of a trajectory in the form that the compiled time loops store."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from integrators.native.step_records import Reading, largest
from problems.formulations import Start
from problems.runtime import jax, jnp

if TYPE_CHECKING:
    from collections.abc import Callable

    from jax import Array
    from jaxtyping import Bool, Float, Int

#: A run whose q and v, or x, have grown by this factor is called diverged.
GROWTH_LIMIT = 1e12


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


class KeptRows(NamedTuple):
    """Rows of a run with an unknown number of steps: those of `is_row`, from ``first`` on."""

    table: Float[Array, "k n"]
    #: Number of rows so far, those before ``first`` included.
    number: Int[Array, ""]

    def with_row(self, row: Array, kept: Bool[Array, ""], first: Array) -> Self:
        """Take the row of a step if it is kept."""
        number = self.number + kept
        place = jnp.where(kept & (number >= first), number - first, len(self.table))
        return type(self)(self.table.at[place].set(row, mode="drop"), number)


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
