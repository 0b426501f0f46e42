"""Rotations in space as unit quaternions p ``(4,)``, and rigid displacements: a small library.

p = (p0, p1, p2, p3) has the scalar part first, R(p) turns components in body axes into those in
space axes, and theta ``(3,)`` is a rotation vector in body axes, in rad. All functions are smooth
everywhere, at theta = 0 too; p and -p are the same rotation.
"""

from __future__ import annotations

import numpy as np

from problems.base.runtime import Array, Float, jnp

#: Squares of angles below which series of three terms have no more error than rounding.
_SMALL = 1e-4


def product(p: Float[Array, " 4"], r: Float[Array, " 4"]) -> Float[Array, " 4"]:
    """Return the quaternion p o r: R(p o r) = R(p) R(r)."""
    scalar = p[0] * r[0] - p[1:] @ r[1:]
    return jnp.concatenate([scalar[None], p[0] * r[1:] + r[0] * p[1:] + jnp.cross(p[1:], r[1:])])


def conjugate(p: Float[Array, " 4"]) -> Float[Array, " 4"]:
    """Return the quaternion of the inverse rotation."""
    return jnp.concatenate([p[:1], -p[1:]])


def rotated(p: Float[Array, " 4"], x: Float[Array | np.ndarray, " 3"]) -> Float[Array, " 3"]:
    """Return R(p) x, whatever the norm of p."""
    u = p[1:]
    return 2 * jnp.cross(u, p[0] * x + jnp.cross(u, x)) / (p @ p) + x


def rotation_matrix(p: Float[Array, " 4"]) -> Float[Array, "3 3"]:
    """Return R(p), whatever the norm of p."""
    return jnp.stack([rotated(p, axis) for axis in np.eye(3)], axis=1)


def quaternion_rate(p: Float[Array, " 4"], omega: Float[Array, " 3"]) -> Float[Array, " 4"]:
    """Return p' = 1/2 p o (0, omega) per s, of the angular velocity omega in body axes, rad/s."""
    return product(p, jnp.concatenate([jnp.zeros(1), omega / 2]))


def exponential(theta: Float[Array, " 3"]) -> Float[Array, " 4"]:
    """Return the unit quaternion of a rotation vector: exp on S^3."""
    cosine, part = _half_angle(theta @ theta)
    return jnp.concatenate([cosine[None], part * theta])


def turned(p: Float[Array, " 4"], theta: Float[Array, " 3"]) -> Float[Array, " 4"]:
    """Return p o exp(theta), its norm brought back to 1 by one step of Newton's method."""
    moved = product(p, exponential(theta))
    return moved * (1.5 - 0.5 * (moved @ moved))


def screwed(theta: Float[Array, " 3"], u: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """Return T(theta)^T u in m, in the axes before it: the translation of exp(u, theta) on SE(3).

    A body goes there that turns by theta while it moves by u in its own axes.
    """
    square = theta @ theta
    cosine, part = _half_angle(square)
    small = square < _SMALL
    series = 1 / 6 - square / 120 + square**2 / 5040
    third = jnp.where(small, series, (1 - 2 * part * cosine) / jnp.where(small, 1.0, square))
    across = jnp.cross(theta, u)
    return u + 2 * part**2 * across + third * jnp.cross(theta, across)


def _half_angle(square: Array) -> tuple[Array, Array]:
    """cos(n/2) and sin(n/2)/n of the angle n, from its square."""
    small = square < _SMALL
    angle = jnp.sqrt(jnp.where(small, 1.0, square))
    cosine = 1 - square / 8 + square**2 / 384
    part = 0.5 - square / 48 + square**2 / 3840
    return (
        jnp.where(small, cosine, jnp.cos(angle / 2)),
        jnp.where(small, part, jnp.sin(angle / 2) / angle),
    )
