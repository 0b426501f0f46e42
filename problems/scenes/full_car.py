"""A car with semi-active dampers in a lane change, and the same car with passive ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import State, Variables, completed, jax, jnp, parameter
from problems.mechanics import drawing, lagrange
from problems.mechanics.lagrange import OfEnergies
from problems.scenes.quarter_car import SemiActiveDamper

#: Waves of the road: cycles per m, with phases on the left and on the right that were drawn once.
_WAVES = np.array([0.07, 0.11, 0.16, 0.25, 0.41])
_PHASES = np.array([[2.4, 1.8, 5.8, 1.5, 4.2], [3.1, 0.9, 5.1, 2.5, 3.0]])
_WHEELS = ("front left", "front right", "rear left", "rear right")
_LEFT = np.array([1.0, -1.0, 1.0, -1.0])
_FRONT = np.array([1.0, 1.0, 0.0, 0.0])


@dataclass(frozen=True)
class _Car(OfEnergies):
    """Body, wheels, tyres and steering of both cars: everything but the dampers.

    Axes: x forward, y to the left, z up; roll is positive with the left side up, pitch with the
    nose down. Wheels: front left, front right, rear left, rear right. Roll and pitch are small
    angles, about axes on the ground: a point (x, y) of the body rises by z + y roll - x pitch,
    and its centre of mass, h above, moves by (h pitch, -h roll) in the plane. With this
    kinematics the equations are Lagrange's, and nothing else is neglected.
    """

    interval = (0.0, 12.0)
    nominal_step = 0.01
    coordinates = (
        *("x [m]", "y [m]", "heave [m]", "roll [rad]", "pitch [rad]", "yaw [rad]"),
        *(f"wheel {wheel} [m]" for wheel in _WHEELS),
        *("steer left [rad]", "steer right [rad]"),
    )
    multipliers = ("tie rod left [N]", "tie rod right [N]")
    source = (
        "Scenario of Bruels & Arnold (2008), section 7, Figs 12-15; data of the BMW 320i in "
        "CommonRoad's vehicle models; steering linkage, road and dampers are synthetic"
    )

    speed: float = parameter(10.0, "m/s", "initial speed")
    m: float = parameter(965.711, "kg", "sprung mass", low=1e-9)
    m_front: float = parameter(31.896, "kg", "unsprung mass per front wheel", low=1e-9)
    m_rear: float = parameter(31.896, "kg", "unsprung mass per rear wheel", low=1e-9)
    i_x: float = parameter(207.265, "kg m^2", "roll inertia of the body", low=1e-9)
    i_y: float = parameter(1565.818, "kg m^2", "pitch inertia of the body", low=1e-9)
    i_z: float = parameter(1791.6, "kg m^2", "yaw inertia of the car", low=1e-9)
    i_steer: float = parameter(1.0, "kg m^2", "inertia of a steered wheel about z", low=1e-9)
    h: float = parameter(0.61373, "m", "height of the body's centre of mass above the ground")
    a: float = parameter(1.1562, "m", "distance of the front axle", low=1e-9)
    b: float = parameter(1.42272, "m", "distance of the rear axle", low=1e-9)
    track_front: float = parameter(1.38684, "m", "track of the front axle", low=1e-9)
    track_rear: float = parameter(1.36398, "m", "track of the rear axle", low=1e-9)
    offset_front: float = parameter(
        0.0, "m", "offset of the centre of mass to the left of the front axle's middle"
    )
    offset_rear: float = parameter(0.0, "m", "the same for the rear axle")
    k_front: float = parameter(24453.1, "N/m", "spring per front wheel", low=0.0)
    k_rear: float = parameter(19635.5, "N/m", "spring per rear wheel", low=0.0)
    k_tyre: float = parameter(158294.0, "N/m", "vertical stiffness of a tyre", low=0.0)
    anti_roll_front: float = parameter(6914.9, "N m/rad", "anti-roll bar in front", low=0.0)
    anti_roll_rear: float = parameter(2643.6, "N m/rad", "the same at the rear axle", low=0.0)
    gravity: float = parameter(9.81, "m/s^2", "gravity")
    friction: float = parameter(1.0489, "1", "largest lateral tyre force per load (D)", low=0.0)
    shape: float = parameter(1.3507, "1", "shape of the tyre's force (C)", low=1e-9)
    slope: float = parameter(21.92, "1/rad", "tyre's slope per load (B C D)", low=0.0)
    curvature: float = parameter(-0.0074722, "1", "curvature of the tyre's force (E)")
    trail: float = parameter(0.03, "m", "trail of the tyre forces behind the wheel's centre")
    arm: float = parameter(0.12, "m", "length of the steering arms, forward", low=1e-9)
    arm_out: float = parameter(0.02, "m", "their ends' offset to the outside")
    rack_width: float = parameter(0.7, "m", "distance of the rack's ends", low=1e-9)
    rack: float = parameter(0.014, "m", "displacement of the rack, left and then right")
    t_left: float = parameter(2.5, "s", "time of the displacement to the left")
    t_right: float = parameter(3.5, "s", "time of the displacement to the right")
    pulse: float = parameter(
        0.45, "s", "half length of a displacement, where 42 percent are left", low=1e-9
    )
    rough: float = parameter(8e-3, "m", "amplitude of the road's longest wave")

    # ---- geometry -----------------------------------------------------------------------
    def _axles(self, front: float, rear: float) -> jax.Array:
        """A value per wheel from those of the axles."""
        return jnp.asarray(_FRONT * front + (1 - _FRONT) * rear)

    def _places(self) -> tuple[jax.Array, jax.Array]:
        """x and y of the wheels from the body's centre of mass."""
        half = self._axles(self.track_front, self.track_rear) / 2
        offset = self._axles(self.offset_front, self.offset_rear)
        return self._axles(self.a, -self.b), jnp.asarray(_LEFT * half - offset)

    def _corners(self) -> jax.Array:
        """Heights of the corners by heave, roll and pitch, shape ``(4, 3)``."""
        x, y = self._places()
        return jnp.stack([jnp.ones(4), y, -x], axis=1)

    def _stretch(self, q: jax.Array) -> jax.Array:
        """Extension of springs and dampers in m, shape ``(4,)``; with v for q, their speed."""
        return self._corners() @ q[2:5] - q[6:10]

    def _road(self, t: jax.Array | float) -> jax.Array:
        """Height of the road under each wheel in m, at the initial speed; zero at t = 0."""
        x, _ = self._places()
        way = self.speed * t + x
        phases = np.where(_LEFT[:, None] > 0, _PHASES[0], _PHASES[1])
        waves = jnp.sin(2 * np.pi * _WAVES * way[:, None] + phases) @ (_WAVES[0] / _WAVES)
        return self.rough * jnp.tanh(0.1 * self.speed * t) * waves

    def _rack_displacement(self, t: jax.Array) -> jax.Array:
        """Displacement of the rack to the left in m."""
        left, right = ((t - at) / self.pulse for at in (self.t_left, self.t_right))
        return self.rack * (jnp.cosh(left) ** -2 - jnp.cosh(right) ** -2)

    # ---- equations of motion ------------------------------------------------------------
    def _kinetic_energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        c, s = jnp.cos(q[5]), jnp.sin(q[5])
        ahead, aside = c * v[0] + s * v[1], c * v[1] - s * v[0]
        (roll, pitch), (roll_rate, pitch_rate, yaw_rate) = q[3:5], v[3:6]
        body = jnp.stack(
            [
                ahead + self.h * (pitch_rate + yaw_rate * roll),
                aside - self.h * (roll_rate - yaw_rate * pitch),
                v[2],
            ]
        )
        unsprung = self._axles(self.m_front, self.m_rear)
        turning = jnp.stack([self.i_x, self.i_y, self.i_z]) @ v[3:6] ** 2
        turning = turning + self.i_steer * jnp.sum((yaw_rate + v[10:]) ** 2)
        plane = jnp.sum(unsprung) * (ahead**2 + aside**2)
        return 0.5 * (self.m * (body @ body) + plane + turning + unsprung @ v[6:10] ** 2)

    def _potential_energy(self, q: jax.Array, t: jax.Array | float = 0.0) -> jax.Array:
        springs = self._axles(self.k_front, self.k_rear) @ self._stretch(q) ** 2
        tyres = self.k_tyre * jnp.sum((q[6:10] - self._road(t)) ** 2)
        front = q[3] - (q[6] - q[7]) / self.track_front
        rear = q[3] - (q[8] - q[9]) / self.track_rear
        bars = self.anti_roll_front * front**2 + self.anti_roll_rear * rear**2
        falling = self.m * self.gravity * self.h * (q[3] ** 2 + q[4] ** 2)
        return 0.5 * (springs + tyres + bars - falling)

    def _tyre_loads(self, q: jax.Array, t: jax.Array) -> jax.Array:
        """Vertical forces on the tyres in N, shape ``(4,)``."""
        lever = self._axles(
            self.offset_front / self.track_front, self.offset_rear / self.track_rear
        )
        share = self._axles(self.b, self.a) / (self.a + self.b) * (0.5 + lever * _LEFT)
        weight = self.gravity * (self.m * share + self._axles(self.m_front, self.m_rear))
        return weight - self.k_tyre * (q[6:10] - self._road(t))

    def _contact_velocities(self, q: jax.Array, v: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Velocities of the tyres' contacts along and across the wheels, each ``(4,)``."""
        x, y = self._places()
        c, s = jnp.cos(q[5]), jnp.sin(q[5])
        ahead = c * v[0] + s * v[1] - y * v[5]
        aside = c * v[1] - s * v[0] + x * v[5]
        steer, rate = (jnp.concatenate([w[10:], jnp.zeros(2)]) for w in (q, v))
        c, s = jnp.cos(steer), jnp.sin(steer)
        return c * ahead + s * aside, c * aside - s * ahead - self.trail * (v[5] + rate)

    def _tyre_forces(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        """Lateral forces on the tyres in N, to the left of each wheel, shape ``(4,)``.

        The magic formula D sin(C atan(B s - E (B s - atan(B s)))) at the slip angle s.
        """
        along, across = self._contact_velocities(q, v)
        stiff = self.slope / (self.shape * self.friction) * -jnp.arctan2(across, along)
        bent = stiff - self.curvature * (stiff - jnp.arctan(stiff))
        return self.friction * self._tyre_loads(q, t) * jnp.sin(self.shape * jnp.arctan(bent))

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        g = lagrange.force(self._kinetic_energy, lambda q: self._potential_energy(q, t), q, v)
        _, transposed = jax.vjp(lambda v: self._contact_velocities(q, v)[1], v)
        return g + transposed(self._tyre_forces(q, v, t))[0]

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        # (d.d - l^2)/(2 l), so that a multiplier is a tie rod's force: positive when compressed.
        left, steer = _LEFT[:2], q[10:]
        c, s = jnp.cos(steer), jnp.sin(steer)
        inside = (self.track_front - self.rack_width) / 2
        length = inside + self.arm_out
        dx = self.arm * (c - 1) - left * self.arm_out * s
        dy = left * (inside + self.arm_out * c) + self.arm * s - self._rack_displacement(t)
        dz = self._stretch(q)[:2]
        return (dx**2 + dy**2 + dz**2 - length**2) / (2 * length)

    def initial_state(self) -> State:
        # In equilibrium; only the steered wheels move, which follow the rack.
        steer = [10, 11]
        return completed(self, np.zeros(12), [self.speed, *np.zeros(11)], steer, steer)

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        # Oblique, from behind; it travels with x. Heights and tilts are enlarged five times.
        view = np.array([[0.75, -0.75, 0.0], [0.35, 0.25, 1.0]])
        (x, y), enlarged = map(np.asarray, self._places()), 5.0

        def seen(points: np.ndarray) -> np.ndarray:
            plane = drawing.placed(points[:, :2], q[5], (0.0, q[1]))
            return np.column_stack([plane, points[:, 2]]) @ view.T

        def outline(front: float, rear: float, wide: float, height: float) -> np.ndarray:
            along = np.array([front, front, -rear, -rear, front])
            across = wide * np.array([1, -1, -1, 1, 1])
            rise = enlarged * (q[2] + across * q[3] - along * q[4])
            lean = enlarged * height * np.array([q[4], -q[3]])
            return np.column_stack([along + lean[0], across + lean[1], height + rise])

        floor, roof = outline(2.0, 2.1, 0.8, 0.45), outline(0.5, 1.3, 0.6, 1.4)
        lines = [floor, roof, *(np.array(pair) for pair in zip(floor[:4], roof[:4], strict=True))]
        ahead, up = drawing.circle(np.zeros(2), 0.34, 20).T
        for k, steer in enumerate([q[10], q[11], 0.0, 0.0]):
            plane = drawing.placed(np.column_stack([ahead, 0.0 * ahead]), steer, (x[k], y[k]))
            lines.append(np.column_stack([plane, 0.34 + up + enlarged * q[6 + k]]))
        return [seen(line) for line in lines]


@dataclass(frozen=True)
class FullCarPassive(_Car):
    """A car with linear dampers in a lane change, to be compared with ``full_car``.

    Tests a rheonomic index-3 system with a slow motion, unbounded coordinates and tyre forces that
    saturate, without a controller. Left out: the same effects as in ``full_car``.
    """

    tags = ("constrained", "index 3", "rheonomic", "vehicle", "multibody")
    difficulties = ("the rack moves the constraints: velocities need Phi_t, too",)

    c_front: float = parameter(1786.24, "N s/m", "damper per front wheel", low=0.0)
    c_rear: float = parameter(1649.08, "N s/m", "damper per rear wheel", low=0.0)

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        pull = self._axles(self.c_front, self.c_rear) * self._stretch(v)
        _, transposed = jax.vjp(self._stretch, q)
        return super().force(q, v, t) - transposed(pull)[0]


@dataclass(frozen=True)
class FullCar(SemiActiveDamper, _Car):
    """A car with semi-active dampers in a lane change: constraints and controller in one loop.

    The example for which generalized-alpha was extended to mechatronic systems, in the smallest
    size that keeps its structure: a body with six freedoms and four wheels, a steering linkage
    whose tie rods are constraints that the moving rack drives (index 3), four dampers with stiff
    chamber pressures, and a controller in three stages, from the currents up: (a) the inverse of
    the damper's characteristic makes a current from the demanded force and the damper's speed; (b)
    the accelerations of the four corners are transformed to heave, roll and pitch, and forces back;
    (c) each of the three is integrated, with a leak, and multiplied by a gain. Steering is open
    loop, without drive or brakes: after the lane change the car drifts sideways and has lost speed.

    Against ``full_car_passive`` the controller lowers the RMS accelerations of heave, roll and
    pitch over the 12 s by 11, 2 and 3 percent, and the largest roll angle by 10.

    Vertical coordinates are counted from the static equilibrium; lam is positive when a tie rod is
    compressed.

    Left out: spin and longitudinal slip of the wheels, camber, lift-off and lag of the tyres, roll
    centres above the ground, lateral play between body and axles (data set: 175 kN/m), the inertia
    of unsprung masses in load transfer, products of roll, pitch and their rates in the inertia, and
    dynamics of sensors and valves. None of them changes the kind of equations. The road passes
    under the wheels at the initial speed.
    """

    tags = ("mechatronic", "constrained", "index 3", "rheonomic", "stiff controller states",
            "vehicle", "multibody")  # fmt: skip
    difficulties = (
        "index 3 and acceleration feedback in one step",
        "stiff chamber pressures and currents that run from limit to limit",
        "at the nominal step a and y are far from the asymptotic range",
    )

    states = (
        *(f"rebound pressure {wheel} [MPa]" for wheel in _WHEELS),
        *(f"compression pressure {wheel} [MPa]" for wheel in _WHEELS),
        *("heave velocity [m/s]", "roll velocity [rad/s]", "pitch velocity [rad/s]"),
    )
    outputs = (
        *(f"current {wheel} [A]" for wheel in _WHEELS),
        *(f"damper {wheel} [N]" for wheel in _WHEELS),
    )

    # Softer than for one wheel, as with bushings, so that an explicit reference takes little time.
    bulk: float = parameter(60.0, "MPa", "bulk modulus of oil, bubbles and walls", low=1e-9)
    # Below this drop a check valve leaks both ways. With 0.02 MPa, strokes of 0.02 m/s would have
    # less than 1000 N s/m even at the largest current.
    p_check: float = parameter(0.005, "MPa", "drop over which a check valve opens", low=1e-9)
    leak: float = parameter(0.5, "1/s", "leak of the controller's integrators", low=0.0)
    gain_heave: float = parameter(20000.0, "N s/m", "damping asked for in heave")
    gain_roll: float = parameter(10000.0, "N m s/rad", "damping asked for in roll")
    gain_pitch: float = parameter(40000.0, "N m s/rad", "damping asked for in pitch")
    v_switch: float = parameter(
        0.02, "m/s", "damper speed over which its demanded force changes sides", low=1e-9
    )
    p_demand: float = parameter(0.1, "MPa", "rounding of the demanded pressure at zero", low=1e-9)

    def _modal(self) -> jax.Array:
        """Heave, roll and pitch by the four corners, shape ``(3, 4)``; least squares."""
        corners = self._corners()
        return jnp.linalg.solve(corners.T @ corners, corners.T)

    def _demanded_current(self, force: jax.Array, speed: jax.Array) -> jax.Array:
        """Current in A at which the steady damper has this force at this speed of extension.

        The area that carries the rebound pressure and displaces the oil is a_piston - a_rod in
        extension, and a_rod in compression, with equal pressures in both chambers. For a force that
        the damper cannot have, the valve opens as wide as possible.
        """
        side = jnp.tanh(speed / self.v_switch)
        area = 0.5 * ((1 + side) * (self.a_piston - self.a_rod) + (1 - side) * self.a_rod)
        pressure = 1e-6 * force * side / area
        pressure = 0.5 * (pressure + jnp.sqrt(pressure**2 + self.p_demand**2))
        flow = area * jnp.sqrt(speed**2 + self.v_switch**2)
        opened = flow / jnp.sqrt(2e6 * pressure / self.density)
        part = (opened - self.soft_area) / (self.firm_area - self.soft_area)
        return self.i_min + part * (self.i_max - self.i_min)

    def state_rate(self, z: Variables) -> jax.Array:
        rates = self._pressure_rates(z.x[:4], z.x[4:8], z.y[:4], self._stretch(z.v))
        accelerations = self._corners() @ z.a[2:5]
        velocities = self._modal() @ accelerations - self.leak * z.x[8:]
        return jnp.concatenate([*rates, velocities])

    def output(self, z: Variables) -> jax.Array:
        gains = jnp.stack([self.gain_heave, self.gain_roll, self.gain_pitch])
        demanded = self._modal().T @ (gains * z.x[8:])
        currents = self._demanded_current(demanded, self._stretch(z.v))
        forces = self._damper_force(z.x[:4], z.x[4:8])
        return jnp.concatenate([self._limited_current(currents), forces])

    def actuation(self) -> jax.Array:
        pull = jax.jacfwd(self._stretch)(jnp.zeros(12)).T
        return jnp.concatenate([jnp.zeros((12, 4)), -pull], axis=1)

    def initial_state(self) -> State:
        return super().initial_state()._replace(x=np.zeros(11))
