"""A four-bar linkage in space: crank and rocker turn about axes that are not parallel."""

from __future__ import annotations

from dataclasses import dataclass

from problems import GROUND, Body, Revolute, RigidBodies, Spherical, Universal, jnp, parameter


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
