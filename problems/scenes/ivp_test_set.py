"""Mechanisms of the Test Set for IVP Solvers: car axis, squeezer, flexible slider crank."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, Published, State, jax, jnp, parameter
from problems.base.spec import SpecError
from problems.mechanics import drawing
from problems.mechanics.lagrange import OfEnergies


@dataclass(frozen=True)
class CarAxis(MechatronicSystem):
    """An axle between two stiff springs, one of which stands on a bumpy road.

    The left wheel rests on the ground, the right one moves up and down and stays at the distance
    L; two point masses M eps^2/2 are the ends of the axle. One constraint keeps the axle's length,
    the other the left spring perpendicular to the line between the wheels. Left out: the body's own
    inertia and damping, as in the source. Energy is not conserved, because the road does work.
    """

    interval = (0.0, 3.0)
    nominal_step = 0.005
    tags = ("constrained", "index 3", "rheonomic", "stiff", "benchmark")
    difficulties = (
        "stiff springs against light masses: the smaller eps, the shorter explicit steps",
        "the right wheel's motion makes a constraint depend on time: velocities need Phi_t, too",
    )
    coordinates = ("left x [m]", "left y [m]", "right x [m]", "right y [m]")
    multipliers = ("wheel [N/m]", "axle [N/m]")
    source = "Mazzia & Magherini, Test Set for IVP Solvers, problem caraxis; Schneider (1995)"

    eps: float = parameter(0.01, "-", "stiffness parameter: the springs are 1/eps^2", low=1e-9)
    m: float = parameter(10.0, "kg", "mass of the body (M)", low=1e-12)
    length: float = parameter(1.0, "m", "length of the axle and distance of the wheels", low=1e-9)
    spring: float = parameter(0.5, "m", "length of the springs at rest (L0)", low=1e-9)
    r: float = parameter(0.1, "m", "amplitude of the road")
    w: float = parameter(10.0, "rad/s", "angular frequency of the road")
    g: float = parameter(1.0, "m/s^2", "gravity")

    def __post_init__(self) -> None:
        if not abs(self.r) < self.length:
            raise SpecError(
                f"The road's amplitude r={self.r:g} m must be below the length={self.length:g} m, "
                f"which the moving wheel keeps from the other one."
            )

    def _wheel(self, t: jax.Array) -> jax.Array:
        y = self.r * jnp.sin(self.w * t)
        return jnp.stack([jnp.sqrt(self.length**2 - y**2), y])

    def mass(self, q: jax.Array) -> jax.Array:
        return 0.5 * self.m * self.eps**2 * jnp.eye(4)

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        # The source multiplies its equations by eps^2: springs have the stiffness 1.
        def spring(s: jax.Array) -> jax.Array:
            now = jnp.sqrt(s @ s)
            return (self.spring - now) / now * s

        weight = 0.5 * self.m * self.eps**2 * self.g * jnp.array([0.0, 1.0])
        left, right = q[:2], q[2:]
        return jnp.concatenate([spring(left) - weight, spring(right - self._wheel(t)) - weight])

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        # Signs that give the source's multipliers.
        left, axle = q[:2], q[:2] - q[2:]
        return jnp.stack([-(self._wheel(t) @ left), self.length**2 - axle @ axle])

    def initial_state(self) -> State:
        v = -self.r * self.w * self.spring / self.length
        q = [0.0, self.spring, self.length, self.spring]
        return State(q=np.array(q), v=np.array([v, 0.0, v, 0.0]))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        # q holds no time, but the moving wheel is where the left spring is perpendicular to it.
        left, right = np.asarray(q[:2]), np.asarray(q[2:])
        wheel = self.length * np.array([left[1], -left[0]]) / np.linalg.norm(left)
        return [
            np.array([left, right]),
            np.array([[0.0, 0.0], left]),
            np.array([wheel, right]),
            np.array([[0.0, 0.0], wheel]),
        ]


# Data of the source in kg, m and kg m^2; lengths that stand in the constraints are no parameters,
# as the start would have to follow them.
_M1, _M2, _M3, _M4, _M5, _M6, _M7 = 0.04325, 0.00365, 0.02373, 0.00706, 0.07050, 0.00706, 0.05498
_I1, _I2, _I3, _I4 = 2.194e-6, 4.410e-7, 5.255e-6, 5.667e-7
_I5, _I6, _I7 = 1.169e-5, 5.667e-7, 1.912e-5
_A, _B, _C = (-0.06934, -0.00227), (-0.03635, 0.03273), (0.014, 0.072)
_RR, _RA, _D, _DA, _E, _EA = 0.007, 0.00092, 0.028, 0.0115, 0.02, 0.01421
_SS, _SA, _SB, _SC, _SD = 0.035, 0.01874, 0.01043, 0.018, 0.02
_ZT, _TA, _TB = 0.04, 0.02308, 0.00916
_U, _UA, _UB, _ZF, _FA = 0.04, 0.01228, 0.00449, 0.02, 0.01421
#: Angles at the start: beta, Theta, gamma, Phi, delta, Omega, epsilon.
_START = (
    -0.0617138900142764496358948458001, 0.0, 0.455279819163070380255912382449,
    0.222668390165885884674473185609, 0.487364979543842550225598953530,
    -0.222668390165885884674473185609, 1.23054744454982119249735015568,
)  # fmt: skip


@dataclass(frozen=True)
class Andrews(MechatronicSystem):
    """A motor squeezes seven bodies with three closed loops against a spring.

    The published benchmark by which solvers of differential-algebraic equations are compared most
    often. Tests six constraints on seven angles, and large accelerations (14 222 rad/s^2 at the
    start) of light bodies; also judged are a and lam, which comparisons leave out. The motor's
    constant torque has the potential -mom beta, so that the energy is conserved. Left out, as in
    the source: gravity and friction.

    The published angles at t = 0.03 s differ from ours, in which three methods agree to 1e-10 rad,
    by the angular velocities times 1.0e-12 s, all seven alike, as if they were taken 1 ps later.
    """

    interval = (0.0, 0.03)
    nominal_step = 1e-4
    tags = ("constrained", "index 3", "conservative", "smooth", "benchmark")
    difficulties = (
        "M depends on q: methods for constant mass matrices lose their order or refuse",
        "the motor speeds up to 1140 rad/s: constant steps resolve the end worse than the start",
    )
    coordinates = (
        "beta [rad]", "Theta [rad]", "gamma [rad]", "Phi [rad]", "delta [rad]", "Omega [rad]",
        "epsilon [rad]",
    )  # fmt: skip
    multipliers = (
        "spring x [N]", "spring y [N]", "link 4 x [N]", "link 4 y [N]", "link 6 x [N]",
        "link 6 y [N]",
    )  # fmt: skip
    source = (
        "Mazzia & Magherini, Test Set for IVP Solvers, problem andrews; Schiehlen (1990); "
        "Hairer & Wanner, Solving ODEs II, section VII.7"
    )
    published = (
        Published(
            "q", 0.03,
            (15.81077119629904, -15.75637105984298, 0.04082224013073101, -0.5347301163226948,
             0.5244099658805304, 0.5347301163226948, 1.048080741042263), 5e-9,
        ),
        Published("a", 0.0, (14222.4439199541139, -10666.8329399655854, 0, 0, 0, 0, 0), 1e-8),
        Published("lam", 0.0, (98.5668703962410896, -6.12268834425566265, 0, 0, 0, 0), 1e-10),
    )  # fmt: skip

    mom: float = parameter(0.033, "N m", "torque of the motor")
    c0: float = parameter(4530.0, "N/m", "stiffness of the spring", low=0.0)
    l0: float = parameter(0.07785, "m", "length of the spring at rest", low=0.0)

    def mass(self, q: jax.Array) -> jax.Array:
        th, ph, om = q[1], q[3], q[5]
        e, z = _E - _EA, _ZF - _FA
        m21 = _M2 * (_DA**2 - _DA * _RR * jnp.cos(th)) + _I2
        m11 = _M1 * _RA**2 + _M2 * (_RR**2 - 2 * _DA * _RR * jnp.cos(th) + _DA**2) + _I1 + _I2
        m54 = _M4 * (e**2 + _ZT * e * jnp.sin(ph)) + _I4
        m55 = _M4 * (_ZT**2 + 2 * _ZT * e * jnp.sin(ph) + e**2) + _I4 + _I5
        m76 = _M6 * (z**2 - _U * z * jnp.sin(om)) + _I6
        m77 = _M6 * (z**2 - 2 * _U * z * jnp.sin(om) + _U**2) + _I6 + _I7
        fixed = jnp.diag(
            jnp.array([
                0.0, _M2 * _DA**2 + _I2, _M3 * (_SA**2 + _SB**2) + _I3, _M4 * e**2 + _I4,
                _M5 * (_TA**2 + _TB**2), _M6 * z**2 + _I6, _M7 * (_UA**2 + _UB**2),
            ])
        )  # fmt: skip
        first = jnp.array([0, 1, 0, 4, 3, 4, 6, 5, 6])
        second = jnp.array([0, 0, 1, 4, 4, 3, 6, 6, 5])
        moving = jnp.stack([m11, m21, m21, m55, m54, m54, m77, m76, m76])
        return fixed.at[first, second].add(moving)

    def _spring_end(self, ga: jax.Array) -> jax.Array:
        """The end of the spring on body 3, seen from its fixed end."""
        c, s = jnp.cos(ga), jnp.sin(ga)
        x = _SD * c + _SC * s + _B[0] - _C[0]
        return jnp.stack([x, _SD * s - _SC * c + _B[1] - _C[1]])

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        th, ga, ph, om = q[1], q[2], q[3], q[5]
        dbe, dth, _, dph, dde, dom, dep = v
        end = self._spring_end(ga)
        length = jnp.sqrt(end @ end)
        fx, fy = -self.c0 * (length - self.l0) / length * end
        e, z = _ZT * (_E - _EA) * _M4, _U * (_ZF - _FA) * _M6
        arm = _M2 * _DA * _RR * jnp.sin(th)
        c, s = jnp.cos(ga), jnp.sin(ga)
        return jnp.stack([
            self.mom - arm * dth * (dth + 2 * dbe),
            arm * dbe**2,
            fx * (_SC * c - _SD * s) + fy * (_SD * c + _SC * s),
            e * dde**2 * jnp.cos(ph),
            -e * dph * (dph + 2 * dde) * jnp.cos(ph),
            -z * dep**2 * jnp.cos(om),
            z * dom * (dom + 2 * dep) * jnp.cos(om),
        ])  # fmt: skip

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        be, th, ga, ph, de, om, ep = q
        x = _RR * jnp.cos(be) - _D * jnp.cos(be + th)
        y = _RR * jnp.sin(be) - _D * jnp.sin(be + th)
        return jnp.stack([
            x - _SS * jnp.sin(ga) - _B[0],
            y + _SS * jnp.cos(ga) - _B[1],
            x - _E * jnp.sin(ph + de) - _ZT * jnp.cos(de) - _A[0],
            y + _E * jnp.cos(ph + de) - _ZT * jnp.sin(de) - _A[1],
            x - _ZF * jnp.cos(om + ep) - _U * jnp.sin(ep) - _A[0],
            y - _ZF * jnp.sin(om + ep) + _U * jnp.cos(ep) - _A[1],
        ])  # fmt: skip

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        end = self._spring_end(q[2])
        stretch = jnp.sqrt(end @ end) - self.l0
        return 0.5 * v @ self.mass(q) @ v + 0.5 * self.c0 * stretch**2 - self.mom * q[0]

    def initial_state(self) -> State:
        return State(q=np.array(_START), v=np.zeros(7))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        be, th, ga, _, de, _, ep = q
        crank = drawing.placed((_RR, 0.0), be)
        centre = drawing.placed((-_D, 0.0), be + th, crank)  # where three loops meet
        body = drawing.placed([(0.0, 0.0), (0.0, _SS), (_SD, -_SC), (0.0, 0.0)], ga, _B)
        return [
            np.array([[0.0, 0.0], crank, centre]),
            body,
            np.array([body[2], _C]),
            np.array([_A, drawing.placed((_ZT, 0.0), de, _A), centre]),
            np.array([_A, drawing.placed((0.0, -_U), ep, _A), centre]),
        ]


_PI = np.pi
#: Integrals of products of the rod's shape functions: two sines across the rod; along it 4 s(1-s)
#: and s (2s-1), s = 0...1. The last block of the mass should be [[8, 1], [1, 2]]/15: see the scene.
_MASS = np.array([[0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 8, 1], [0, 0, 1, 2]])
_BEND = np.diag([_PI**4 / 24, 2 * _PI**4 / 3, 0, 0])
_STRETCH = np.array([[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 16, -8], [0, 0, -8, 7]]) / 3
_COUPLING = np.zeros((4, 4))
_COUPLING[0, 2:] = -16 / _PI**3, 8 / _PI**3 - 1 / _PI
_COUPLING[1, 3] = 0.5 / _PI
_COUPLING -= _COUPLING.T
_ALONG = np.array([0, 0, 2 / 3, 1 / 6])
_ACROSS = np.array([2 / _PI, 0, 0, 0])
_MOMENT_ALONG = np.array([0, 0, 1 / 3, 1 / 6])
_MOMENT_ACROSS = np.array([1 / _PI, -0.5 / _PI, 0, 0])


@dataclass(frozen=True)
class SliderCrankFlexible(OfEnergies):
    """A slider crank driven at constant speed whose rod bends and stretches: stiff, index 3.

    Tests high frequencies beside slow motion: the elastic rod's eigenfrequencies are 1277, 5107,
    6841 and 24613 rad/s, the crank turns at 150 rad/s, and nothing damps.

    Kept from the source for the sake of its published digits: the longitudinal block of the
    elastic mass matrix lacks a factor 1/15, so that the two longitudinal frequencies are lower by
    sqrt(15) than those of the rod. Corrected: the published initial values satisfy the constraints
    only to 1e-8; rod angle and slider position are computed here from the crank angle and the
    elastic coordinates. Left out: gravity, damping and the nonlinear stiffness, all of which are
    off in the published run, too. Energy is not conserved, because the drive does work.

    From the published start vibrations of about 1e-5 of v and 1e-3 of a and lam remain, which steps
    above some 2e-6 s do not resolve: their errors stall at that size, and only shorter steps show
    second order. With other parameters the start remains consistent, but vibrates more.
    """

    interval = (0.0, 0.1)
    nominal_step = 1e-4
    tags = ("constrained", "index 3", "rheonomic", "stiff", "flexible", "benchmark")
    difficulties = (
        "vibrations of the rod are a thousand times faster than the motion",
        "the benchmark's start excites them slightly: errors in a and lam stall at usual steps",
    )
    coordinates = (
        "crank angle [rad]", "rod angle [rad]", "slider x [m]", "bending 1 [m]", "bending 2 [m]",
        "elongation middle [m]", "elongation end [m]",
    )  # fmt: skip
    multipliers = ("guide [N]", "slider x [N]", "drive [N m]")
    source = "Mazzia & Magherini, Test Set for IVP Solvers, problem crank; Simeon (1996)"

    l1: float = parameter(0.15, "m", "length of the crank", low=1e-9)
    l2: float = parameter(0.3, "m", "length of the rod", low=1e-9)
    j1: float = parameter(0.002727, "kg m^2", "inertia of the crank about the bearing", low=0.0)
    m3: float = parameter(0.075552, "kg", "mass of the slider", low=0.0)
    width: float = parameter(0.008, "m", "width of the rod", low=1e-9)
    height: float = parameter(0.008, "m", "height of the rod", low=1e-9)
    density: float = parameter(7870.0, "kg/m^3", "density of the rod", low=1e-9)
    young: float = parameter(2e11, "N/m^2", "Young's modulus of the rod", low=1e-9)
    omega: float = parameter(150.0, "rad/s", "angular velocity of the crank")

    def __post_init__(self) -> None:
        if not self.l2 > self.l1:
            raise SpecError(
                f"The rod (l2={self.l2:g} m) must be longer than the crank (l1={self.l1:g} m), "
                f"which turns all the way round."
            )

    def _kinetic_energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        w1, w2, slider, rates = v[0], v[1], v[2], v[3:]
        cos, sin, e = jnp.cos(q[0] - q[1]), jnp.sin(q[0] - q[1]), q[3:]
        m2 = self.density * self.width * self.height * self.l2
        j2 = m2 * (self.l2**2 / 3 + self.height**2 / 12)
        rod = j2 + m2 * (e @ _MASS @ e + 2 * self.l2 * (_MOMENT_ALONG @ e))
        mixed = 0.5 * self.l2 * cos + sin * (_ACROSS @ e) + cos * (_ALONG @ e)
        crank = self.j1 + m2 * self.l1**2
        return (
            0.5 * (crank * w1**2 + rod * w2**2 + self.m3 * slider**2)
            + m2 * self.l1 * mixed * w1 * w2
            + m2 * self.l1 * w1 * ((cos * _ACROSS - sin * _ALONG) @ rates)
            + m2 * w2 * ((self.l2 * _MOMENT_ACROSS + e @ _COUPLING) @ rates)
            + 0.5 * m2 * (rates @ _MASS @ rates)
        )

    def _potential_energy(self, q: jax.Array) -> jax.Array:
        e, stiffness = q[3:], self.young * self.width * self.height / self.l2
        slender = (self.height / self.l2) ** 2
        return 0.5 * stiffness * (e @ (slender * _BEND + _STRETCH) @ e)

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        length = self.l2 + q[6]
        return jnp.stack(
            [
                self.l1 * jnp.sin(q[0]) + length * jnp.sin(q[1]),
                q[2] - self.l1 * jnp.cos(q[0]) - length * jnp.cos(q[1]),
                q[0] - self.omega * t,
            ]
        )

    def initial_state(self) -> State:
        # The crank starts at angle 0: the rod is straight ahead, whatever its length.
        end, end_rate = 0.169327969e-4, -0.268938672e-5
        length = self.l2 + end
        turn = -self.l1 / length * self.omega
        return State(
            q=np.array([0, 0, self.l1 + length, 0, 0, 0.103339863e-4, end]),
            v=np.array([self.omega, turn, end_rate,
                        0.444896105, 0.463434311e-2, -0.178591076e-5, end_rate]),
        )  # fmt: skip

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        s, enlarged = np.linspace(0, 1, 21), 20.0  # the deflections are too small to be seen
        along = self.l2 * s + 4 * s * (1 - s) * q[5] + s * (2 * s - 1) * q[6]
        across = enlarged * (np.sin(_PI * s) * q[3] + np.sin(2 * _PI * s) * q[4])
        tip = self.l1 * np.array([np.cos(q[0]), np.sin(q[0])])
        rod = drawing.placed(np.column_stack([along, across]), q[1], tip)
        return [np.array([[0.0, 0.0], tip]), rod, drawing.box(q[2], 0.2 * self.l1)]
