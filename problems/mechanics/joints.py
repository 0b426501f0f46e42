"""Joints and springs between rigid bodies, as equations of how these moved since the start.

All points and axes are those at the start, in space axes, in m: this is how a person knows them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np

from problems.base.runtime import Array, Float, jnp
from problems.base.spec import SpecError

#: Three numbers, in m or without unit, which may be traced.
Vector: TypeAlias = Sequence[Any] | Array | np.ndarray


def vector(given: Any) -> Any:
    """Return an array, of NumPy as long as nothing in it is traced: constants cost no operation."""
    try:
        return np.asarray(given, dtype=float)
    except TypeError:
        return jnp.array(given, dtype=float)


class Frame(NamedTuple):
    """Displacement of a body since the start, which all its points and axes share.

    ``start``, ``now``
        its centre of mass, in m
    ``axes``
        where the space axes of the start have turned, in rows ``(3, 3)``; None of the ground
    """

    start: Any = 0.0
    now: Any = 0.0
    axes: Any = None

    def point(self, point: Vector) -> Float[Array, "*k 3"]:
        """Return the places now, in m, of points of the body that were at ``point`` before."""
        return self.now + self.axis(vector(point) - self.start)

    def axis(self, axis: Vector) -> Float[Array, "*k 3"]:
        """Return the directions now of axes of the body that had these at the start."""
        given: Any = vector(axis)
        return given if self.axes is None else given @ self.axes


@dataclass(frozen=True)
class Link:
    """Two bodies, by name, and the points of both between which something is."""

    first: str
    second: str
    point: Vector

    @property
    def ends(self) -> tuple[Vector, Vector]:
        """The points on both bodies at the start, in m."""
        return self.point, getattr(self, "other_point", self.point)

    def apart(self, one: Frame, other: Frame) -> Float[Array, " 3"]:
        """Way from the point of the first body to that of the second, in m."""
        here, there = self.ends
        return other.point(there) - one.point(here)


@dataclass(frozen=True)
class Joint(Link):
    """A joint, whose multipliers are the force and the torque of the second body on the first."""

    rows: ClassVar[tuple[str, ...]] = ("x [N]", "y [N]", "z [N]")

    def residual(self, one: Frame, other: Frame) -> Float[Array, " n"]:
        """Return what the joint keeps at zero, as many entries as it has ``rows``."""
        raise NotImplementedError


class Spherical(Joint):
    """Both bodies keep the point in common: three equations."""

    def residual(self, one: Frame, other: Frame) -> Float[Array, " 3"]:
        return self.apart(one, other)


@dataclass(frozen=True)
class Fixed(Joint):
    """The second body moves with the first: six equations."""

    rows = (*Joint.rows, "torque 1 [N m]", "torque 2 [N m]", "torque 3 [N m]")

    def residual(self, one: Frame, other: Frame) -> Float[Array, " 6"]:
        return jnp.concatenate([self.apart(one, other), _turn(np.eye(3), one, other)])


@dataclass(frozen=True)
class Revolute(Joint):
    """The second body turns about an axis of the first through the point: five equations."""

    axis: Vector
    rows = (*Joint.rows, "torque 1 [N m]", "torque 2 [N m]")

    def residual(self, one: Frame, other: Frame) -> Float[Array, " 5"]:
        axes = _axes(self.axis)
        return jnp.concatenate([self.apart(one, other), other.axis(axes[1:]) @ one.axis(axes[0])])


@dataclass(frozen=True)
class Universal(Joint):
    """The bodies turn about an axis of each, which cross at a right angle: four equations."""

    axis: Vector
    other_axis: Vector
    rows = (*Joint.rows, "torque [N m]")

    def residual(self, one: Frame, other: Frame) -> Float[Array, " 4"]:
        here, there = _axes(self.axis)[0], _axes(self.other_axis)[0]
        square = jnp.atleast_1d(one.axis(here) @ other.axis(there))
        return jnp.concatenate([self.apart(one, other), square])


@dataclass(frozen=True)
class Prismatic(Joint):
    """The second body slides along an axis of the first and does not turn: five equations."""

    axis: Vector
    rows = ("across 1 [N]", "across 2 [N]", *Fixed.rows[3:])

    def residual(self, one: Frame, other: Frame) -> Float[Array, " 5"]:
        axes, apart = _axes(self.axis), self.apart(one, other)
        return jnp.concatenate([one.axis(axes[1:]) @ apart, _turn(axes, one, other)])


@dataclass(frozen=True)
class Distance(Joint):
    """A bar without mass keeps ``point`` of the first body and ``other_point`` of the second apart:
    one equation, whose multiplier is the tension times -1."""

    other_point: Vector
    rows = ("along [N]",)

    def residual(self, one: Frame, other: Frame) -> Float[Array, " 1"]:
        way, first = self.apart(one, other), self.apart(Frame(), Frame())
        square = first @ first
        return jnp.atleast_1d(0.5 * (way @ way - square) / square**0.5)


def _axes(axis: Vector) -> Any:
    """The unit vector of an axis and two across it, in rows (Duff et al. 2017)."""
    given = vector(axis)
    if isinstance(given, np.ndarray) and not given.any():
        raise SpecError("The axis of a joint is (0, 0, 0); give its direction.")
    xp: Any = np if isinstance(given, np.ndarray) else jnp
    x, y, z = given / (given @ given) ** 0.5
    sign = xp.where(z < 0, -1.0, 1.0)
    part = -1.0 / (sign + z)
    one = [1 + sign * x * x * part, sign * x * y * part, -sign * x]
    return xp.array([[x, y, z], one, [x * y * part, sign + y * y * part, -y]])


def _turn(axes: Any, one: Frame, other: Frame) -> Float[Array, " 3"]:
    """Zero if the bodies have not turned against each other: axes of both stay square."""
    return jnp.sum(jnp.roll(one.axis(axes), -1, 0) * jnp.roll(other.axis(axes), -2, 0), axis=1)


@dataclass(frozen=True)
class SpringDamper(Link):
    """A spring and a damper side by side, from ``point`` to ``other_point``.

    ``stiffness`` in N/m, ``damping`` in N s/m; ``length`` without force in m, by default that at
    the start.
    """

    other_point: Vector
    stiffness: Any
    damping: Any = 0.0
    length: Any = None

    def stretched(self, one: Frame, other: Frame) -> Float[Array, ""]:
        """Return by how much it is longer than without force, in m."""
        way, first = self.apart(one, other), self.apart(Frame(), Frame())
        rest = (first @ first) ** 0.5 if self.length is None else self.length
        return jnp.sqrt(way @ way) - rest
