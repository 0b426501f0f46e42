"""Andrews' squeezing mechanism: seven bodies in a plane, index 3, the mechanism of DAE solvers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, Published, State, jax, jnp, parameter

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
    often. Tests index 3 with six constraints on seven angles, a mass matrix that depends on q, and
    large accelerations (14 222 rad/s^2 at the start) of light bodies; also judged are accelerations
    and multipliers, which comparisons leave out. The motor's constant torque has the potential
    -mom beta, so that the energy is conserved. Left out, as in the source: gravity and friction.

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

        def turned(angle: float, x: float, y: float) -> np.ndarray:
            c, s = np.cos(angle), np.sin(angle)
            return np.array([c * x - s * y, s * x + c * y])

        crank = turned(be, _RR, 0.0)
        centre = crank - turned(be + th, _D, 0.0)  # where three loops meet
        a, b = np.array(_A), np.array(_B)
        held, tip = b + turned(ga, _SD, -_SC), b - turned(ga, 0.0, -_SS)
        return [
            np.array([[0.0, 0.0], crank, centre]),
            np.array([b, tip, held, b]),
            np.array([held, _C]),
            np.array([a, a + turned(de, _ZT, 0.0), centre]),
            np.array([a, a + turned(ep, 0.0, -_U), centre]),
        ]
