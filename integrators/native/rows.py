"""Rows of a trajectory in the form that the compiled time loops store."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from integrators.native.step_records import Reading
from problems.formulations import Start
from problems.runtime import jax, jnp

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Float

#: A run whose q or v has grown by this factor is called diverged.
GROWTH_LIMIT = 1e12


def flat(reading: Reading) -> Float[Array, " n"]:
    """All numbers of a reading in one array."""
    return jnp.concatenate([jnp.atleast_1d(part) for part in jax.tree.leaves(reading)])


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
