"""Positions and velocities: how coordinates q ``(nq,)`` follow velocities v ``(nv,)``.

Methods move coordinates by `advance`. Where velocities are the rates of the coordinates, q moves by
sums. Where a scene states ``kinematics``, q moves along dq/dt = T(q) w for unit time with the
displacement w, in one movement from the start of the step: movements one after the other would lose
an order, because rotations do not commute.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

from problems.base.runtime import Array, Float
from problems.system import MechatronicSystem


class Displaced(NamedTuple):
    """Coordinates q ``(nq,)`` from which a displacement w ``(nv,)`` leads on."""

    q: Float[Array, " nq"]
    w: Float[Array, " nv"]


#: Coordinates as an array, of scenes with ``kinematics`` also as `Displaced`.
Place: TypeAlias = Any


def q_rate(
    scene: MechatronicSystem, q: Float[Array, " nq"], v: Float[Array, " nv"]
) -> Float[Array, " nq"]:
    """Return dq/dt at velocity v, in units of q per s."""
    return scene.kinematics(q, v) if scene.has("kinematics") else v


def displaced(scene: MechatronicSystem, q: Place, *changes: Float[Array, " nv"]) -> Place:
    """Add a displacement, a velocity times a time, to which `advance` may add more.

    Parameters
    ----------
    changes
        Parts of the displacement; they are added one after the other.
    """
    if scene.has("kinematics"):
        first, *others = (q.w, *changes) if isinstance(q, Displaced) else changes
        return Displaced(origin(q), sum(others, first))
    for change in changes:
        q = q + change
    return q


def advance(
    scene: MechatronicSystem, q: Place, *changes: Float[Array, " nv"]
) -> Float[Array, " nq"]:
    """Move coordinates by a displacement; arguments as those of `displaced`."""
    place = displaced(scene, q, *changes)
    if not isinstance(place, Displaced):
        return place
    return scene.move(*place) if scene.has("move") else _along(scene, *place)


def origin(q: Place) -> Float[Array, " nq"]:
    """Return the coordinates before the displacement, if there is one."""
    return q.q if isinstance(q, Displaced) else q


def _along(scene: MechatronicSystem, q: Array, w: Array) -> Array:
    """Follow dq/dt = T(q) w for unit time by one classical Runge-Kutta step: up to w^5."""
    k1 = scene.kinematics(q, w)
    k2 = scene.kinematics(q + k1 / 2, w)
    k3 = scene.kinematics(q + k2 / 2, w)
    k4 = scene.kinematics(q + k3, w)
    return q + (k1 + 2 * k2 + 2 * k3 + k4) / 6
