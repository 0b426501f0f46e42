"""The heavy top about a fixed point: in Euler parameters, and on three groups."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from problems import MechatronicSystem, Published, State, jax, jnp, parameter
from problems.mechanics import drawing
from problems.mechanics.rotations import (
    conjugate,
    quaternion_rate,
    rotated,
    rotation_matrix,
    screwed,
    turned,
)


@dataclass(frozen=True)
class HeavyTop(MechatronicSystem):
    """A spinning symmetric top in gravity: position and four Euler parameters, index 3.

    Tests rotation in space, with a mass matrix and constraints that depend on q. M is singular
    along the Euler parameters. The position of the centre of mass is not eliminated: otherwise the
    unit norm would be the only constraint, in whose direction there is no inertia, and no order
    reduction of the multipliers would show. Left out: friction.

    The data are the literature's benchmark, with the top level at the start. ``nod`` is added,
    because steady precession hides errors of the start. -(lam1, lam2, lam3) is the force of the
    joint; lam4, of the unit norm, has no mechanical meaning of its own.
    """

    interval = (0.0, 0.5)
    nominal_step = 2e-3
    tags = ("constrained", "index 3", "conservative", "spatial", "singular mass")
    difficulties = (
        "M(q) alone is singular: only with the constraints has it accelerations",
        "lam loses an order on index 3 with the plain start",
    )
    coordinates = ("x [m]", "y [m]", "z [m]", "p0", "p1", "p2", "p3")
    multipliers = ("x [N]", "y [N]", "z [N]", "unit length [N m]")
    source = "Geradin & Cardona (2001); data as in Bruels & Cardona (2010), doi:10.1115/1.4001370"

    m: float = parameter(15.0, "kg", "mass", low=1e-12)
    length: float = parameter(1.0, "m", "distance of the centre of mass from the fixed point")
    j: float = parameter(
        0.234375, "kg m^2", "inertia across the axis, about the centre of mass", low=1e-12
    )
    j_axis: float = parameter(0.46875, "kg m^2", "inertia about the body's axis", low=1e-12)
    g: float = parameter(9.81, "m/s^2", "gravity, along -z")
    spin: float = parameter(150.0, "rad/s", "initial angular velocity about the body's axis")
    turn: float = parameter(-4.61538, "rad/s", "initial angular velocity about the vertical")
    nod: float = parameter(2.0, "rad/s", "initial angular velocity of the tip upwards")

    @staticmethod
    def _turning(p: jax.Array) -> jax.Array:
        """B(p) of the angular velocity B(p) p' in the body's axes, shape ``(3, 4)``.

        It is 2 times the vector of p* p', so B(p) r = -B(r) p.
        """
        p0, p1, p2, p3 = p
        rows = [[-p1, p0, p3, -p2], [-p2, -p3, p0, p1], [-p3, p2, -p1, p0]]
        return 2 * jnp.stack([jnp.stack(row) for row in rows])

    @staticmethod
    def _axis(p: jax.Array) -> jax.Array:
        """Direction of the body's axis in space (of length p.p), shape ``(3,)``."""
        p0, p1, p2, p3 = p
        return jnp.stack(
            [2 * (p1 * p2 - p0 * p3), p0**2 - p1**2 + p2**2 - p3**2, 2 * (p2 * p3 + p0 * p1)]
        )

    def _about_the_centre(self, p: jax.Array, rate: jax.Array) -> jax.Array:
        """Angular momentum J B(p) p' about the centre of mass, in the body's axes, kg m^2/s."""
        return jnp.stack([self.j, self.j_axis, self.j]) * (self._turning(p) @ rate)

    def mass(self, q: jax.Array) -> jax.Array:
        return jax.vmap(lambda a: self.mass_product(q, a))(jnp.eye(7))

    def mass_product(self, q: jax.Array, a: jax.Array) -> jax.Array:
        p = q[3:]
        return jnp.concatenate(
            [self.m * a[:3], self._about_the_centre(p, a[3:]) @ self._turning(p)]
        )

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        # Of T = (B(p) p')^T J B(p) p'/2: T_p - d/dt T_p' + B^T J B p'' = -2 B(p')^T J B(p) p'.
        p, rate = q[3:], v[3:]
        gyroscopic = -2 * self._about_the_centre(p, rate) @ self._turning(rate)
        return jnp.concatenate([jnp.stack([0.0, 0.0, -self.m * self.g]), gyroscopic])

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        x, p = q[:3], q[3:]
        return jnp.concatenate([x - self.length * self._axis(p), 0.5 * (p @ p - 1.0)[None]])

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return 0.5 * (v @ self.mass_product(q, v)) + self.m * self.g * q[2]

    def momentum(self, q: jax.Array, v: jax.Array) -> jax.Array:
        # About the vertical through the fixed point, and about the body's own axis.
        p, rate = q[3:], v[3:]
        upwards = 2 * (p[0] * rate[3] - rate[0] * p[3] + p[1] * rate[2] - p[2] * rate[1])
        spin = (self._turning(p) @ rate)[1]
        tilted = (self.j_axis - self.j) * spin * self._axis(p)[2]
        moving = self.m * (q[0] * v[1] - q[1] * v[0])
        return jnp.stack([moving + self.j * upwards + tilted, self.j_axis * spin])

    def points(self, q: jax.Array) -> dict[str, jax.Array]:
        return {"C": q[:3]}

    def initial_state(self) -> State:
        # Space and body axes coincide; the tip is at (0, length, 0).
        turning = np.array([self.nod, self.spin, self.turn])
        tip = self.length * np.array([-self.turn, 0.0, self.nod])
        return State(
            q=np.array([0.0, self.length, 0.0, 1.0, 0.0, 0.0, 0.0]),
            v=np.concatenate([tip, [0.0], turning / 2]),
        )

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        rotation = np.asarray(rotation_matrix(jnp.asarray(q[3:])))
        rim = np.insert(drawing.circle(np.zeros(2), 0.4, 32), 1, 1.0, axis=1)
        shaft = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        spoke = np.array([shaft[1], rim[0]])
        return [self.length * line @ rotation.T @ drawing.OBLIQUE for line in (shaft, rim, spoke)]


_AXIS = np.array([0.0, 1.0, 0.0])
_OMEGA = ("Omega 1 [rad/s]", "Omega 2 [rad/s]", "Omega 3 [rad/s]")
#: Computed from the equations of Euler parameters by an explicit method at two tolerances.
_CENTRE = (
    Published("C", 0.1, (0.4212966589254, 0.8945719743456, -0.1491647005620), 2e-12),
    Published("C", 1.0, (0.17334396410, 0.64008859207, -0.74849079113), 2e-10),
)
_TURNING = (4.80894133173, 150.0, 1.02830075671)


@dataclass(frozen=True)
class HeavyTopR3SO3(HeavyTop):
    """The heavy top on R^3 x SO(3): velocities in space axes, angular velocities in body axes.

    The literature's benchmark with its start. Tests how methods move rotations, with a constant
    mass matrix and three constraints, which a displacement of this group leaves: multipliers of
    index 3 lose an order at the start. The motion is that of `heavy_top[nod=0]`.
    """

    tags = ("constrained", "index 3", "conservative", "spatial", "rotations")
    difficulties = (
        "q has one entry more than v: methods that add velocities to coordinates cannot take it",
        "lam loses an order on index 3 with the plain start",
    )
    velocities = ("x [m/s]", "y [m/s]", "z [m/s]", *_OMEGA)
    multipliers = ("x [N]", "y [N]", "z [N]")
    source = (
        "Geradin & Cardona (2001); Bruels, Cardona & Arnold (2012), "
        "doi:10.1016/j.mechmachtheory.2011.07.017"
    )
    published = (
        *_CENTRE,
        Published("v", 0.1, (3.4085374633, -2.0834379506, -2.8678350450, *_TURNING), 2e-10),
    )

    nod: float = parameter(0.0, "rad/s", "initial angular velocity of the tip upwards")

    mass_product: ClassVar[Any] = None

    @property
    def _inertia(self) -> jax.Array:
        """About the centre of mass, in body axes."""
        return jnp.stack([self.j, self.j_axis, self.j])

    def _weight(self) -> jax.Array:
        return jnp.stack([0.0, 0.0, -self.m * self.g])

    def _gyroscopic(self, omega: jax.Array) -> jax.Array:
        return -jnp.cross(omega, self._inertia * omega)

    # On SO(3) coordinates end with p and velocities with Omega, too, but nothing is before these.
    def _speed(self, q: jax.Array, v: jax.Array) -> jax.Array:
        """Velocity of the centre of mass in space axes."""
        return v[:-3]

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.diag(jnp.concatenate([jnp.full(3, self.m), self._inertia]))

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return jnp.concatenate([self._weight(), self._gyroscopic(v[3:])])

    def kinematics(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return jnp.concatenate([self._speed(q, v), quaternion_rate(q[-4:], v[-3:])])

    def move(self, q: jax.Array, w: jax.Array) -> jax.Array:
        return jnp.concatenate([q[:-4] + w[:-3], turned(q[-4:], w[-3:])])

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        return q[:3] - self.length * rotated(q[3:], _AXIS)

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return 0.5 * (v @ self.mass(q) @ v) + self.m * self.g * self.points(q)["C"][2]

    def momentum(self, q: jax.Array, v: jax.Array) -> jax.Array:
        spinning = rotated(q[3:], self._inertia * v[3:])
        moving = self.m * jnp.cross(q[:3], self._speed(q, v))
        return jnp.stack([moving[2] + spinning[2], self.j_axis * v[4]])

    def initial_state(self) -> State:
        # Space and body axes coincide.
        q, v, _ = super().initial_state()
        return State(q=q, v=np.concatenate([v[:3], 2 * v[4:]]))


@dataclass(frozen=True)
class HeavyTopSE3(HeavyTopR3SO3):
    """The heavy top on SE(3): all velocities in body axes, displacements are screw motions.

    Tests the published difference between products of groups: here a displacement that obeys the
    constraints of velocities keeps the joint closed, so that index 3 costs no order and the motion
    is that of `heavy_top_so3` up to rounding.
    """

    difficulties = HeavyTopR3SO3.difficulties[:1]
    velocities = ("U 1 [m/s]", "U 2 [m/s]", "U 3 [m/s]", *_OMEGA)
    published = _CENTRE

    def _speed(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return rotated(q[3:], v[:3])

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        weight = rotated(conjugate(q[3:]), self._weight())
        moving = weight - self.m * jnp.cross(v[3:], v[:3])
        return jnp.concatenate([moving, self._gyroscopic(v[3:])])

    def move(self, q: jax.Array, w: jax.Array) -> jax.Array:
        there = q[:3] + rotated(q[3:], screwed(w[3:], w[:3]))
        return jnp.concatenate([there, turned(q[3:], w[3:])])


@dataclass(frozen=True)
class HeavyTopSO3(HeavyTopR3SO3):
    """The heavy top on SO(3): its rotation alone, about the fixed point and without constraints.

    Tests how methods move rotations, and nothing else; the joint's force is left out.
    """

    tags = ("conservative", "spatial", "rotations")
    difficulties = HeavyTopR3SO3.difficulties[:1]
    coordinates = HeavyTopR3SO3.coordinates[3:]
    velocities = HeavyTopR3SO3.velocities[3:]
    multipliers = ()
    published = (*_CENTRE, Published("v", 0.1, _TURNING, 2e-10))

    constraint: ClassVar[Any] = None

    @property
    def _inertia(self) -> jax.Array:
        """About the fixed point, in body axes."""
        across = self.j + self.m * self.length**2
        return jnp.stack([across, self.j_axis, across])

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.diag(self._inertia)

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        weight = rotated(conjugate(q), self._weight())
        return self._gyroscopic(v) + self.length * jnp.cross(_AXIS, weight)

    def momentum(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return jnp.stack([rotated(q, self._inertia * v)[2], self.j_axis * v[1]])

    def points(self, q: jax.Array) -> dict[str, jax.Array]:
        return {"C": self.length * rotated(q, _AXIS)}

    def initial_state(self) -> State:
        q, v, _ = super().initial_state()
        return State(q=q[3:], v=v[3:])

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        return super().draw(np.concatenate([np.zeros(3), q]))
