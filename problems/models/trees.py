"""Trees of rigid bodies in joint coordinates: M(q), bias forces and poses, without recursion.

A joint hangs below another one; poses are composed in the logarithm of the depth by jumping to
the ancestor of the ancestor. All else are sums over ancestors or descendants, that is, products
with constant matrices: the recursive Newton-Euler algorithm (Featherstone 2008,
doi:10.1007/978-1-4899-7560-7) as a few array operations, which compile in a moment. Vectors are
in space axes, and moments about the origin.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property, wraps
from typing import Any, NamedTuple

import numpy as np

from problems.base.runtime import Array, Float, jax, jnp
from problems.mechanics.rotations import rotation_matrix


def _turn(matrices: Any, vectors: Any) -> Any:
    """Products of matrices ``(n, 3, 3)`` and vectors ``(n, 3)``."""
    return jnp.einsum("nij,nj->ni", matrices, vectors)


def traced_once(method: Callable) -> Callable:
    """Return a method of arrays that JAX traces once for each object.

    Steps, starts, references and tangents call the same equations, whose tracing takes as long as
    all else before the first number.
    """

    @cache  # JAX is loaded late
    def traced() -> Callable:
        return jax.jit(method, static_argnums=0)

    return wraps(method)(lambda self, *arrays: traced()(self, *arrays))


class Poses(NamedTuple):
    """Axes ``(n, 3, 3)`` and origins ``(n, 3)`` of links, and motions by velocities ``(nv, 3)``:
    angular velocities, and velocities of the point that is at the origin."""

    axes: Float[Array, "n 3 3"]
    origins: Float[Array, "n 3"]
    turning: Float[Array, "nv 3"]
    moving: Float[Array, "nv 3"]


@dataclass(frozen=True, eq=False)
class Tree:
    """Links, each with at most one joint, parents first.

    Attributes
    ----------
    kind
        "hinge", "slide", "ball" or "fixed" ``(n,)``
    parent
        number of the link above ``(n,)``; -1: the ground
    place, axes
        of the link in that above at q = ``zero``: ``(n, 3)`` in m, and ``(n, 3, 3)``
    axis, anchor
        of the joint in the axes of the link ``(n, 3)``
    at_q, at_v
        first number of the joint's coordinates and velocities ``(n,)``
    zero
        coordinates of hinges and slides in which links stand in their places ``(n,)``
    mass, centre, inertia
        in kg, m, and kg m^2 about the centre in the axes of the link: ``(n,)``, ``(n, 3)``,
        ``(n, 3, 3)``
    gravity
        in m/s^2 ``(3,)``
    nq, nv
        numbers of coordinates and velocities
    """

    kind: tuple[str, ...]
    parent: np.ndarray
    place: np.ndarray
    axes: np.ndarray
    axis: np.ndarray
    anchor: np.ndarray
    at_q: np.ndarray
    at_v: np.ndarray
    zero: np.ndarray
    mass: np.ndarray
    centre: np.ndarray
    inertia: np.ndarray
    gravity: np.ndarray
    nq: int
    nv: int

    # ---- constant matrices
    @cached_property
    def _above(self) -> np.ndarray:
        """1 where the second link is the first one or above it."""
        above = np.eye(len(self.parent))
        for k, parent in enumerate(self.parent):
            if parent >= 0:
                above[k] += above[parent]
        return above

    @cached_property
    def _of(self) -> np.ndarray:
        """The link of each velocity ``(nv,)``."""
        sizes = [{"fixed": 0, "ball": 3}.get(kind, 1) for kind in self.kind]
        return np.repeat(np.arange(len(sizes)), sizes)

    @cached_property
    def _columns(self) -> tuple[np.ndarray, np.ndarray]:
        """The axis of each velocity in its link ``(nv, 3)``, and 1 where it turns ``(nv, 1)``."""
        kinds = np.array(self.kind)[self._of]
        axes, turns = self.axis[self._of], (kinds != "slide") * 1.0
        axes[kinds == "ball"] = np.tile(np.eye(3), (self.kind.count("ball"), 1))
        return axes, turns[:, None]

    def _moved(self, kind: str, q: Array) -> Any:
        """How far links with a joint of this kind have moved, others zero ``(n,)``."""
        picks = np.zeros((len(self.kind), self.nq))
        own = np.flatnonzero(np.array(self.kind) == kind)
        picks[own, self.at_q[own]] = 1.0
        return picks @ q - picks.any(1) * self.zero

    # ---- motion
    @traced_once
    def poses(self, q: Float[Array, " nq"]) -> Poses:
        """Return the poses of the links at coordinates q."""
        angle = self._moved("hinge", q)[:, None, None]
        across = np.cross(np.eye(3), self.axis[:, None])
        turned: Any = np.eye(3) + jnp.sin(angle) * across + (1 - jnp.cos(angle)) * across @ across
        for k, kind in enumerate(self.kind):
            if kind == "ball":
                ball = rotation_matrix(q[self.at_q[k] : self.at_q[k] + 4])
                turned += np.eye(len(self.kind))[k][:, None, None] * (ball - np.eye(3))
        way = self._moved("slide", q)[:, None] * self.axis
        origins = self.place + _turn(self.axes, way + self.anchor - _turn(turned, self.anchor))
        axes: Any = jnp.einsum("nij,njk->nik", self.axes, turned)
        above = self.parent
        while (above >= 0).any():
            below = np.flatnonzero(above >= 0)
            up = axes[above[below]]
            moved = origins[above[below]] + _turn(up, origins[below])
            origins = origins.at[below].set(moved)
            axes = axes.at[below].set(jnp.einsum("nij,njk->nik", up, axes[below]))
            above = np.where(above >= 0, above[above], -1)
        own, turns = self._columns
        along = _turn(axes[self._of], own)
        anchors = origins[self._of] + _turn(axes[self._of], self.anchor[self._of])
        moving = turns * jnp.cross(anchors, along) + (1 - turns) * along
        return Poses(axes, origins, jnp.asarray(turns * along), jnp.asarray(moving))

    def _bodies(self, at: Poses) -> tuple[Array, Array]:
        """Centres of mass ``(n, 3)``, and inertias about them in space axes ``(n, 3, 3)``."""
        centres = at.origins + _turn(at.axes, self.centre)
        return centres, jnp.einsum("nij,njk,nlk->nil", at.axes, self.inertia, at.axes)

    @traced_once
    def mass_matrix(self, q: Float[Array, " nq"]) -> Float[Array, "nv nv"]:
        """Return M(q)."""
        at = self.poses(q)
        centres, inertias = self._bodies(at)
        squares = jnp.sum(centres**2, axis=1)[:, None, None] * np.eye(3)
        around = squares - centres[:, :, None] * centres[:, None, :]
        about = inertias + self.mass[:, None, None] * around
        # Of all that hangs at the link of a velocity.
        hanging, of = self._above.T[self._of], self._of
        mass, moment = hanging @ self.mass, hanging @ (self.mass[:, None] * centres)
        inertia = jnp.einsum("dn,nij->dij", hanging, about)
        force = mass[:, None] * at.moving + jnp.cross(at.turning, moment)
        torque = _turn(inertia, at.turning) + jnp.cross(moment, at.moving)
        places = np.arange(self.nv)
        first = (of[:, None] != of) | (places[:, None] >= places)
        lower = self._above[of][:, of] * first * (force @ at.moving.T + torque @ at.turning.T)
        return lower + (1 - np.eye(self.nv)) * lower.T

    @traced_once
    def mass_product(self, q: Float[Array, " nq"], a: Float[Array, " nv"]) -> Float[Array, " nv"]:
        """Return M(q) a, in N (or N m), with fewer operations than by M."""
        at = self.poses(q)
        centres, inertias = self._bodies(at)
        above = self._above[:, self._of]
        spin = jnp.matmul(above, a[:, None] * at.turning)
        rise = jnp.matmul(above, a[:, None] * at.moving) + jnp.cross(spin, centres)
        return self._on_joints(at, centres, self.mass[:, None] * rise, _turn(inertias, spin))

    def _on_joints(self, at: Poses, centres: Array, force: Any, spin: Array) -> Array:
        """Forces of joints that balance forces at the centres, and moments about them."""
        hanging = self._above.T[self._of]
        moment = spin + jnp.cross(centres, force)
        return (at.moving * (hanging @ force) + at.turning * (hanging @ moment)).sum(axis=1)

    @traced_once
    def bias(self, q: Float[Array, " nq"], v: Float[Array, " nv"]) -> Float[Array, " nv"]:
        """Return the gyroscopic forces and weights, in N (or N m), on the side of M a."""
        at = self.poses(q)
        centres, inertias = self._bodies(at)
        own = self._above - np.eye(len(self.parent))
        belongs = np.eye(len(self.parent))[:, self._of]
        w, u = belongs @ (v[:, None] * at.turning), belongs @ (v[:, None] * at.moving)
        w_above, u_above = own @ w, own @ u
        # A joint's axes move with the link above it.
        angular = self._above @ jnp.cross(w_above, w)
        linear = self._above @ (jnp.cross(w_above, u) + jnp.cross(u_above, w))
        w, u = w_above + w, u_above + u
        rise = linear + jnp.cross(angular, centres) + jnp.cross(w, u + jnp.cross(w, centres))
        force = self.mass[:, None] * (rise - self.gravity)
        spin = _turn(inertias, angular) + jnp.cross(w, _turn(inertias, w))
        return self._on_joints(at, centres, force, spin)

    def centres(self, q: Float[Array, " nq"]) -> Float[Array, "n 3"]:
        """Return the centres of mass, in m."""
        return self._bodies(self.poses(q))[0]

    def weight_energy(self, q: Float[Array, " nq"]) -> Float[Array, ""]:
        """Return the potential energy of the weights, in J."""
        return -jnp.sum(self.mass * (self.centres(q) @ self.gravity))
