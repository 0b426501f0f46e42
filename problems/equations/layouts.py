"""Vectors of all groups of a system's variables, one after the other: their places and sizes."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from problems.base.runtime import jax, jnp

if TYPE_CHECKING:
    from problems.variables import Sizes


class Layout:
    """Groups of a vector by name: ``layout.q`` is the slice of q.

    Parameters
    ----------
    sizes
        Number of entries of each group, in the order of the vector.

    Attributes
    ----------
    size
        Number of all entries.
    cuts
        Indices between the groups.
    """

    q: slice
    v: slice
    a: slice
    lam: slice
    x: slice
    xdot: slice
    y: slice
    mu: slice
    notes: slice

    def __init__(self, **sizes: int) -> None:
        ends = np.cumsum([0, *sizes.values()]).tolist()
        self.size, self.cuts = ends[-1], ends[1:-1]
        places = (slice(*ends) for ends in pairwise(ends))
        vars(self).update(zip(sizes, places, strict=True))

    def split(self, w: Any) -> list[Any]:
        """Return the groups of an array, whose last axis is laid out so."""
        return (jnp if isinstance(w, jax.Array) else np).split(w, self.cuts, axis=-1)


def state_layout(sizes: Sizes) -> Layout:
    """Lay out s = [q, v, x], the state of the explicit ODE."""
    return Layout(q=sizes.nq, v=sizes.nv, x=sizes.nx)


def algebraic_layout(sizes: Sizes) -> Layout:
    """Lay out u = [a, lam, y], the unknowns of the index-1 equations at a given state."""
    return Layout(a=sizes.nv, lam=sizes.nl, y=sizes.ny)


def stage_layout(sizes: Sizes, formulation: str = "index3") -> Layout:
    """Lay out u = [a, lam, mu, xdot, y], the unknowns of a stage; mu as in `dae_layout`."""
    n_mu = _multipliers(sizes, formulation)
    return Layout(a=sizes.nv, lam=sizes.nl, mu=n_mu, xdot=sizes.nx, y=sizes.ny)


def dae_layout(sizes: Sizes, formulation: str) -> Layout:
    """Lay out w = [q, v, x, lam, y, mu]; "stabilised_index2" alone has multipliers mu ``(nh,)``."""
    n_mu = _multipliers(sizes, formulation)
    s = sizes
    return Layout(q=s.nq, v=s.nv, x=s.nx, lam=s.nl, y=s.ny, mu=n_mu)


def row_layout(sizes: Sizes, notes: int = 0) -> Layout:
    """Lay out the row of a trajectory without its time: [q, v, a, lam, x, xdot, y, notes]."""
    groups = ("q", "v", "a", "lam", "x", "xdot", "y")
    return Layout(**{group: sizes.of(group) for group in groups}, notes=notes)


def _multipliers(sizes: Sizes, formulation: str) -> int:
    return sizes.nh if formulation == "stabilised_index2" else 0
