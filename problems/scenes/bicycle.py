"""The uncontrolled bicycle: four bodies on two wheels that roll without slipping."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, State, jax, jnp, parameter


def _about(axis: np.ndarray, angle: jax.Array) -> jax.Array:
    """Matrix ``(3, 3)`` of the rotation about a unit vector."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return jnp.eye(3) + jnp.sin(angle) * cross + (1 - jnp.cos(angle)) * cross @ cross


def _inertia(xx: float, yy: float, zz: float, xz: float = 0.0) -> np.ndarray:
    return np.array([[xx, 0.0, xz], [0.0, yy, 0.0], [xz, 0.0, zz]])


_X, _Y, _Z = np.eye(3)
# Data of the source in m, kg and kg m^2, in its axes: x forwards, y to the right, z down; positions
# in the upright bicycle are seen from the point where the rear wheel touches the ground.
_BASE, _TRAIL, _TILT, _REAR, _FRONT = 1.02, 0.08, np.pi / 10, 0.3, 0.35
_STEER_AXIS = np.array([np.sin(_TILT), 0.0, np.cos(_TILT)])
_ON_AXIS = np.array([_BASE + _TRAIL, 0.0, 0.0])
#: Bodies: rear frame with the rider, front frame, rear wheel, front wheel.
_MASSES = np.array([85.0, 4.0, 2.0, 3.0])
_CENTRES = np.array([[0.3, 0, -0.9], [0.9, 0, -0.7], [0, 0, -_REAR], [_BASE, 0, -_FRONT]])
_INERTIAS = np.stack([
    _inertia(9.2, 11.0, 2.8, 2.4), _inertia(0.05892, 0.06, 0.00708, -0.00756),
    _inertia(0.0603, 0.12, 0.0603), _inertia(0.1405, 0.28, 0.1405),
])  # fmt: skip


@dataclass(frozen=True)
class Bicycle(MechatronicSystem):
    """The benchmark bicycle with a rigid rider, no hands, in full nonlinear motion.

    Tests rolling in space with two kinds of constraints at once: both wheels stand on the ground
    (two constraints of positions, lowest points of tilted circles in closed form), and the points
    that touch it do not slip (four of velocities alone). Upright running at constant speed is
    stable between 4.292 m/s (weave) and 6.024 m/s (capsize); the start is the run M1 of the
    IFToMM library, at 4 m/s with a rate of lean, whose weave grows slowly. Left out: tyres, a
    rider who moves or steers, and drag, so that the energy is conserved.

    Coordinates are the centre of the rear wheel, the angles of the rear frame (yaw, then lean to
    the right, then pitch), the steer to the right, and both wheels against their frames; z points
    down. Wheels turn backwards about y when the bicycle runs forwards.
    """

    interval = (0.0, 5.0)
    nominal_step = 0.02
    tags = ("constrained", "index 3", "nonholonomic", "conservative", "spatial", "benchmark")
    difficulties = (
        "constraints of positions and of velocities at once",
        "M depends on q: methods for constant mass matrices lose their order or refuse",
    )
    coordinates = (
        "rear x [m]", "rear y [m]", "rear z [m]", "yaw [rad]", "lean [rad]", "pitch [rad]",
        "steer [rad]", "rear wheel [rad]", "front wheel [rad]",
    )  # fmt: skip
    multipliers = (
        "rear load [N]", "front load [N]", "rear grip x [N]", "rear grip y [N]",
        "front grip x [N]", "front grip y [N]",
    )  # fmt: skip
    source = (
        "Meijaard, Papadopoulos, Ruina & Schwab (2007), doi:10.1098/rspa.2007.1857; IFToMM "
        "benchmark library, uncontrolled bicycle"
    )

    g: float = parameter(9.81, "m/s^2", "gravity", low=0.0)
    speed: float = parameter(4.0, "m/s", "initial velocity forwards")
    lean_rate: float = parameter(0.05, "rad/s", "initial rate of the lean")

    def _frames(self, q: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Rotations of rear and front frame, each ``(3, 3)``."""
        rear = _about(_Z, q[3]) @ _about(_X, q[4]) @ _about(_Y, q[5])
        return rear, rear @ _about(_STEER_AXIS, q[6])

    def _centres(self, q: jax.Array) -> jax.Array:
        """Centres of mass of the bodies, ``(4, 3)``."""
        rear, front = self._frames(q)
        axis = q[:3] + rear @ (_ON_AXIS - _CENTRES[2])
        on_front = axis + (_CENTRES[1::2] - _ON_AXIS) @ front.T
        on_rear = q[:3] + (_CENTRES[::2] - _CENTRES[2]) @ rear.T
        return jnp.stack([on_rear, on_front], axis=1).reshape(4, 3)

    def _velocities(self, q: jax.Array, v: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Of the bodies' centres, and angular ones along their frames' axes, each ``(4, 3)``."""
        turning = _about(_X, -q[4]) @ (v[3] * _Z) + v[4] * _X
        rear = _about(_Y, -q[5]) @ turning + v[5] * _Y
        front = _about(_STEER_AXIS, -q[6]) @ rear + v[6] * _STEER_AXIS
        of_frames = jnp.stack([rear, front])
        angular = jnp.concatenate([of_frames, of_frames + v[7:, None] * _Y])
        return jax.jvp(self._centres, (q,), (v,))[1], angular

    def _lowest(self, q: jax.Array) -> jax.Array:
        """The lowest points of the wheels, seen from their centres, ``(2, 3)``."""
        axles = jnp.stack(self._frames(q))[:, :, 1]
        down = _Z - axles[:, 2:] * axles
        return jnp.array([[_REAR], [_FRONT]]) * down / jnp.sqrt(1 - axles[:, 2:] ** 2)

    def mass(self, q: jax.Array) -> jax.Array:
        moving, turning = jax.jacfwd(lambda v: self._velocities(q, v))(jnp.zeros(9))
        return jnp.einsum("b,bik,bil->kl", _MASSES, moving, moving) + jnp.einsum(
            "bij,bik,bjl->kl", _INERTIAS, turning, turning
        )

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        # Newton and Euler for each body at a = 0, along the directions of the coordinates; the
        # axes of a wheel's inertia are those of its frame, which turn as the frame does.
        (_, angular), rates = jax.jvp(self._velocities, (q, v), (v, jnp.zeros(9)))
        spins = jnp.einsum("bij,bj->bi", _INERTIAS, angular)
        push = _MASSES[:, None] * (self.g * _Z - rates[0])
        frames = angular[np.array([0, 1, 0, 1])]
        turn = -jnp.einsum("bij,bj->bi", _INERTIAS, rates[1]) - jnp.cross(frames, spins)
        return jax.vjp(lambda v: self._velocities(q, v), v)[1]((push, turn))[0]

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        return (self._centres(q)[2:] + self._lowest(q))[:, 2]

    def velocity_constraint(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        centres, angular = self._velocities(q, v)
        turning = jnp.einsum("fij,fj->fi", jnp.stack(self._frames(q)), angular[2:])
        return (centres[2:] + jnp.cross(turning, self._lowest(q)))[:, :2].ravel()

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        moving, turning = self._velocities(q, v)
        height = -self._centres(q)[:, 2] @ _MASSES
        spins = jnp.einsum("bi,bij,bj", turning, _INERTIAS, turning)
        return 0.5 * ((moving**2).sum(axis=1) @ _MASSES + spins) + self.g * height

    def initial_state(self) -> State:
        v = np.zeros(9)
        v[[0, 1, 4]] = self.speed, self.lean_rate * _REAR, self.lean_rate
        v[7:] = -self.speed / _REAR, -self.speed / _FRONT
        return State(q=np.array([*_CENTRES[2], 0, 0, 0, 0, 0, 0]), v=v)

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        # Oblique view by one who rides along: x to the right, y towards him, z down.
        view = np.array([[1.0, 0.0], [-0.4, -0.3], [0.0, -1.0]])
        rear, front = map(np.asarray, self._frames(jnp.asarray(q)))
        angle = np.linspace(0, 2 * np.pi, 25)
        lines = []
        centres = np.asarray(self._centres(jnp.asarray(q)))
        wheels = (rear, centres[2], _REAR, q[7]), (front, centres[3], _FRONT, q[8])
        for frame, centre, radius, turn in wheels:
            rim = np.column_stack([np.cos(angle - turn), 0 * angle, np.sin(angle - turn)]) * radius
            lines += [centre + rim @ frame.T, np.stack([centre, centre + frame @ rim[0]])]
        head = centres[3] + front @ (_ON_AXIS - 0.9 * _STEER_AXIS - _CENTRES[3])
        lines += [np.stack([centres[2], centres[0], head, centres[3]])]
        ground = np.array([[-0.5, -0.5], [1.5, -0.5], [1.5, 0.5], [-0.5, 0.5], [-0.5, -0.5]])
        lines.append(np.column_stack([ground + q[:2], np.zeros(5)]))
        return [(line - [q[0], q[1], 0.0]) @ view for line in lines]
