"""Bodies that roll or glide without slipping: a sleigh, a disc, and a bicycle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, State, jax, jnp, parameter
from problems.mechanics import drawing
from problems.mechanics.lagrange import OfEnergies

#: Nodes of Gauss' formula on each panel, and the longest panel in units of the sleigh's time.
_NODES, _PANEL = 20, 0.5


@dataclass(frozen=True)
class ChaplyginSleigh(MechatronicSystem):
    """A rigid body on a plane, on a blade at distance ``arm`` behind its centre of mass.

    Tests a nonholonomic constraint in its simplest setting, with coordinates of the plane and
    velocities v = (u, s, w) of the body. The start is backwards, which is unstable: the sleigh
    swings round and runs straight on. The motion has a limit, as nonholonomic systems keep no
    volume of states. Left out: friction, and a rotor, by which such a sleigh would be steered.

    With k^2 = (J + m arm^2)/m the motion keeps u^2 + k^2 w^2 = c^2 and is u = c tanh(T),
    w = c/k sech(T), T = arm c/k^2 (t - t*); the heading follows by the Gudermannian of T, the place
    of the blade by Gauss' formula to rounding.
    """

    interval = (0.0, 6.0)
    nominal_step = 0.05
    tags = ("constrained", "nonholonomic", "closed form", "conservative", "smooth")
    difficulties = (
        "a constraint of velocities: methods that need it as one of positions cannot take it",
        "velocities of the body: dq/dt = T(q) v",
    )
    coordinates = ("centre x [m]", "centre y [m]", "heading [rad]")
    velocities = ("along [m/s]", "across [m/s]", "turn [rad/s]")
    multipliers = ("blade [N]",)
    source = "Neimark & Fufaev (1972), Dynamics of Nonholonomic Systems; Bloch (2003), section 1.7"

    m: float = parameter(1.0, "kg", "mass", low=1e-12)
    j: float = parameter(0.3, "kg m^2", "inertia about the centre of mass", low=0.0)
    arm: float = parameter(0.5, "m", "distance of the blade behind the centre", low=1e-9)
    u0: float = parameter(-1.0, "m/s", "initial velocity along the blade, forwards")
    w0: float = parameter(0.3, "rad/s", "initial turn rate", low=1e-9)

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.diag(jnp.stack([self.m, self.m, self.j]))

    def kinematics(self, q: jax.Array, v: jax.Array) -> jax.Array:
        c, s = jnp.cos(q[2]), jnp.sin(q[2])
        return jnp.stack([c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]])

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return self.m * v[2] * jnp.stack([v[1], -v[0], 0.0])

    def velocity_constraint(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return (v[1] - self.arm * v[2])[None]

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return 0.5 * v @ self.mass(q) @ v

    def initial_state(self) -> State:
        return State(
            q=np.array([self.arm, 0.0, 0.0]), v=np.array([self.u0, self.arm * self.w0, self.w0])
        )

    def exact(self, t: np.ndarray) -> dict[str, np.ndarray]:
        k2 = self.j / self.m + self.arm**2
        k, start = np.sqrt(k2), np.arcsinh(self.u0 / (np.sqrt(k2) * self.w0))
        c = np.hypot(self.u0, k * self.w0)
        rate = self.arm * c / k2  # of T by t
        since = rate * (np.asarray(t, dtype=float) - self.interval[0])

        def heading(since: np.ndarray) -> np.ndarray:
            return k / self.arm * (np.arctan(np.sinh(start + since)) - np.arctan(np.sinh(start)))

        # The blade moves by tanh(T) (cos, sin)(heading) dT k^2/arm.
        x, weights = np.polynomial.legendre.leggauss(_NODES)
        panels = max(1, int(np.ceil(np.abs(since).max() / _PANEL)))
        parts = (np.arange(panels)[:, None] + (x + 1) / 2).ravel() / panels
        at = since[:, None] * parts
        speed = np.tanh(start + at) * np.exp(1j * heading(at))
        path = k2 / self.arm * since * (speed @ np.tile(weights, panels)) / (2 * panels)
        th = heading(since)
        place = path + self.arm * np.exp(1j * th)
        u, w = c * np.tanh(start + since), c / k / np.cosh(start + since)
        turning = -self.arm / k2 * u * w
        return {
            "q": np.column_stack([place.real, place.imag, th]),
            "v": np.column_stack([u, self.arm * w, w]),
            "a": np.column_stack([self.arm * w**2, self.arm * turning, turning]),
            "lam": (-self.j / k2 * u * w)[:, None],
        }

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        body = np.array([[1.0, 0.0], [-0.6, 0.6], [-0.6, -0.6], [1.0, 0.0]])
        blade = np.array([[-1.3, 0.0], [-0.7, 0.0]])
        return [drawing.placed(self.arm * line, q[2], q[:2]) for line in (body, blade)]


@dataclass(frozen=True)
class RollingDisc(OfEnergies):
    """A thin uniform disc rolls on a horizontal plane: two constraints of velocities, in space.

    Tests rolling, with rotation by three angles: heading (about the vertical, z up), lean (to the
    right) and spin. The point that touches the plane has no velocity along and across the heading;
    the height of the centre, r cos(lean), is put into the energies. At the start the disc rolls
    upright with a small rate of lean and spins too slowly to stay so: it is stable for
    spin^2 > g/(3 r) only, and sways in arcs. Left out: friction, slipping, and a disc that lies
    flat, where heading and spin are one angle (Euler's disc).
    """

    interval = (0.0, 5.0)
    nominal_step = 0.01
    tags = ("constrained", "nonholonomic", "conservative", "spatial", "smooth")
    difficulties = (
        "constraints of velocities whose multipliers follow the heading",
        "near lean = pi/2 heading and spin become one angle, and their rates large",
    )
    coordinates = ("centre x [m]", "centre y [m]", "heading [rad]", "lean [rad]", "spin [rad]")
    multipliers = ("along [N]", "across [N]")
    energy = OfEnergies._total
    source = "Neimark & Fufaev (1972); Bloch (2003), section 1.4; O'Reilly (1996)"

    m: float = parameter(1.0, "kg", "mass", low=1e-12)
    r: float = parameter(0.5, "m", "radius", low=1e-9)
    g: float = parameter(9.81, "m/s^2", "gravity", low=0.0)
    lean0: float = parameter(0.0, "rad", "initial lean", low=-1.5, high=1.5)
    turn0: float = parameter(0.0, "rad/s", "initial rate of the heading")
    lean_rate0: float = parameter(0.2, "rad/s", "initial rate of the lean")
    spin0: float = parameter(2.0, "rad/s", "initial rate of the spin")

    def _kinetic_energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        dx, dy, turn, lean_rate, spin = v
        axial = spin + turn * jnp.sin(q[3])
        across = lean_rate**2 + (turn * jnp.cos(q[3])) ** 2
        rise = self.r * lean_rate * jnp.sin(q[3])
        inertia = self.m * self.r**2 / 4  # across the axis; twice as much about it
        return self.m / 2 * (dx**2 + dy**2 + rise**2) + inertia / 2 * (across + 2 * axial**2)

    def _potential_energy(self, q: jax.Array) -> jax.Array:
        return self.m * self.g * self.r * jnp.cos(q[3])

    def velocity_constraint(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        _, _, heading, lean, _ = q
        dx, dy, turn, lean_rate, spin = v
        c, s = jnp.cos(heading), jnp.sin(heading)
        along = c * dx + s * dy - self.r * (spin + turn * jnp.sin(lean))
        return jnp.stack([along, c * dy - s * dx + self.r * lean_rate * jnp.cos(lean)])

    def initial_state(self) -> State:
        speed = self.r * (self.spin0 + self.turn0 * np.sin(self.lean0))
        aside = -self.r * self.lean_rate0 * np.cos(self.lean0)
        return State(
            q=np.array([0.0, 0.0, 0.0, self.lean0, 0.0]),
            v=np.array([speed, aside, self.turn0, self.lean_rate0, self.spin0]),
        )

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        # Oblique view: x to the right, y into the picture, z up.
        view = np.array([[1.0, 0.0], [0.4, 0.3], [0.0, 1.0]])
        x, y, heading, lean, spin = q
        (c, s), (cl, sl) = np.cos([heading, np.pi / 2 - heading]), (np.cos(lean), np.sin(lean))
        along, up = np.array([c, s, 0.0]), np.array([s * sl, -c * sl, cl])
        centre = np.array([x, y, self.r * cl])
        angle = np.linspace(0, 2 * np.pi, 33) + spin
        rim = centre + self.r * (np.outer(np.sin(angle), along) + np.outer(np.cos(angle), up))
        corners = drawing.box(0.0, 2 * self.r) + centre[:2]
        ground = np.column_stack([corners, np.zeros(5)])
        return [line @ view for line in (ground, rim, np.stack([centre, rim[0]]))]


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

    Tests rolling in space: both wheels stand on the ground (two constraints of positions, lowest
    points of tilted circles in closed form), and the points that touch it do not slip (four of
    velocities alone). Upright running at constant speed is
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
        return 0.5 * (v @ self.mass(q) @ v) - self.g * (self._centres(q)[:, 2] @ _MASSES)

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
        ground = drawing.rectangle(-0.5, 1.5, -0.5, 0.5) + q[:2]
        lines.append(np.column_stack([ground, np.zeros(5)]))
        return [(line - [q[0], q[1], 0.0]) @ view for line in lines]
