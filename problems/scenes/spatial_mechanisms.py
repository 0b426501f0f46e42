"""Closed loops in space, put together from bodies and joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import (
    GROUND,
    Body,
    Prismatic,
    Revolute,
    RigidBodies,
    Spherical,
    Universal,
    jnp,
    parameter,
)


@dataclass(frozen=True)
class SpatialFourBar(RigidBodies):
    """Crank about z, rocker about y, and a coupler with a ball and a universal joint: mobility 1.

    Tests a closed loop in space, with rotations as quaternions, 18 velocities and 17 constraints,
    none of which is redundant: the universal joint keeps the coupler from spinning about itself.
    The crank goes round and round, the rocker to and fro. Left out: friction, and a drive.
    """

    interval = (0.0, 1.0)
    nominal_step = 0.01
    tags = ("constrained", "index 3", "conservative", "spatial", "rotations")
    difficulties = ("lam loses an order on index 3 with the plain start",)

    crank: float = parameter(0.1, "m", "length of the crank", low=1e-3)
    rocker: float = parameter(0.3, "m", "length of the rocker", low=1e-3)
    base: float = parameter(0.4, "m", "distance of the bearings along x", low=1e-3)
    shift: float = parameter(0.1, "m", "distance of the bearings along y")
    density: float = parameter(2.0, "kg/m", "mass of the bars by their length", low=1e-9)
    radius: float = parameter(0.01, "m", "radius of the bars, solid cylinders", low=1e-6)
    speed: float = parameter(12.0, "rad/s", "angular velocity of the crank at the start")
    g: float = parameter(9.81, "m/s^2", "gravity, along -z")

    def _corners(self):
        """Bearing and tip of the crank, tip and bearing of the rocker, at the start."""
        bearing = jnp.array([self.base, self.shift, 0.0])
        tips = jnp.array([self.crank, 0.0, 0.0]), bearing + jnp.array([0.0, 0.0, self.rocker])
        return jnp.zeros(3), *tips, bearing

    def bodies(self):
        a, b, c, d = self._corners()
        spin = {"angular_velocity": (0.0, 0.0, self.speed)}
        bars = ("crank", (a, b), spin), ("coupler", (b, c), {}), ("rocker", (c, d), {})
        return tuple(
            Body.rod(name, self.density * jnp.linalg.norm(x - y), (x, y), self.radius, **more)
            for name, (x, y), more in bars
        )

    def joints(self):
        a, b, c, d = self._corners()
        y = jnp.array([0.0, 1.0, 0.0])
        return (
            Revolute(GROUND, "crank", a, axis=(0.0, 0.0, 1.0)),
            Spherical("crank", "coupler", b),
            Universal("coupler", "rocker", c, axis=jnp.cross(b - c, y), other_axis=y),
            Revolute("rocker", GROUND, d, axis=y),
        )

    def gravity(self):
        return (0.0, 0.0, -self.g)


@dataclass(frozen=True)
class SpatialSliderCrank(RigidBodies):
    """A crank about x drives a slider along x through a rod with a ball and a universal joint.

    Tests a closed loop in space whose parts differ: 18 velocities, 17 constraints, a heavy slider
    that must not turn, and gravity that lets the crank swing on. The axes of the universal joint
    are in a figure of the source only. They are chosen here: along the slide on the slider, across
    slide and rod on the rod, which gives the source's angular velocity of the rod at the start,
    (1.92, -0.96, 0.48) rad/s. Published digits are therefore not shown. Left out: friction.
    """

    interval = (0.0, 5.0)
    nominal_step = 0.02
    tags = ("constrained", "index 3", "conservative", "spatial", "rotations", "benchmark")
    difficulties = ("lam loses an order on index 3 with the plain start",)
    source = "Haug (1989), p. 396; IFToMM benchmark library, spatial rigid slider-crank mechanism"

    length: float = parameter(0.3, "m", "length of the rod", low=0.225)
    speed: float = parameter(6.0, "rad/s", "angular velocity of the crank at the start")
    m: float = parameter(2.0, "kg", "mass of the slider", low=1e-9)
    g: float = parameter(9.81, "m/s^2", "gravity, along -z")

    def _pins(self):
        """Bearing and tip of the crank, and the joint of the slider, at the start."""
        b = np.array([0.0, 0.1, 0.2])
        slider = jnp.array([jnp.sqrt(self.length**2 - b @ b), 0.0, 0.0])
        return np.array([0.0, 0.1, 0.12]), b, slider

    def bodies(self):
        a, b, c = self._pins()
        e = (c - b) / self.length
        rod = 0.004 * np.eye(3) - (0.004 - 0.0004) * e[:, None] * e
        spin = (self.speed, 0.0, 0.0)
        return (
            Body("crank", 0.12, (1e-4, 1e-4, 1e-5), (a + b) / 2, angular_velocity=spin),
            Body("rod", 0.5, rod, (b + c) / 2),
            Body("slider", self.m, (1e-4, 1e-4, 1e-4), c),
        )

    def joints(self):
        a, b, c = self._pins()
        x = np.array([1.0, 0.0, 0.0])
        return (
            Revolute(GROUND, "crank", a, axis=x),
            Spherical("crank", "rod", b),
            Universal("rod", "slider", c, axis=jnp.cross(c - b, x), other_axis=x),
            Prismatic("slider", GROUND, c, axis=x),
        )

    def gravity(self):
        return (0.0, 0.0, -self.g)
