"""The slider crank of the IVP test set, with an elastic rod."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import State, jax, jnp, parameter
from problems.base.spec import SpecError
from problems.mechanics import drawing
from problems.mechanics.lagrange import OfEnergies

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
    6841 and 24613 rad/s, the crank turns at 150 rad/s, and nothing damps. The coordinates are
    crank angle, rod angle, slider position, two amplitudes of bending, and the elongations of
    the rod at its middle and end.

    Kept from the source for the sake of its published digits: the longitudinal block of the
    elastic mass matrix lacks a factor 1/15, so that the two longitudinal frequencies are lower by
    sqrt(15) than those of the rod. Corrected: the published initial values satisfy the constraints
    only to 1e-8; rod angle and slider position are computed here from the crank angle and the
    elastic coordinates. Left out: gravity, damping and the nonlinear stiffness, all of which are
    off in the published run, too. Energy is not conserved, because the drive does work.

    With these parameters the motion from the published start is almost smooth: vibrations of about
    1e-5 of the velocities and 1e-3 of the accelerations and multipliers remain. Steps above some
    2e-6 s do not resolve 24613 rad/s and cannot follow them: the errors stall at that size, first
    those of a and lam, and only shorter steps show second order. With other parameters the start
    remains consistent, but vibrates more.
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
        s, (c2, s2) = np.linspace(0, 1, 21), (np.cos(q[1]), np.sin(q[1]))
        enlarged = 20.0  # the deflections are too small to be seen
        along = self.l2 * s + 4 * s * (1 - s) * q[5] + s * (2 * s - 1) * q[6]
        across = enlarged * (np.sin(_PI * s) * q[3] + np.sin(2 * _PI * s) * q[4])
        tip = self.l1 * np.array([np.cos(q[0]), np.sin(q[0])])
        rod = tip + np.column_stack([c2 * along - s2 * across, s2 * along + c2 * across])
        return [np.array([[0.0, 0.0], tip]), rod, drawing.box(q[2], 0.2 * self.l1)]
