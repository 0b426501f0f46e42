"""A05 of the IFToMM benchmark library: a flyball governor with stiff spring-dampers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import Published, State, jax, jnp, parameter
from problems.mechanics import drawing
from problems.mechanics.lagrange import OfEnergies

#: Distance of hinges and slider points from the axis, length of the rods, height of the hinges, m.
_REACH, _ROD, _TOP = 0.05, 1.0, 1.0
#: Masses of shaft and of each rod, of the slider and of each ball in kg.
_BAR, _SLIDER, _BALL = 0.3, 3.0, 5.0
#: Inertias in kg m^2: of shaft or rod about its axis and across, of the slider about the axis.
_ALONG, _ACROSS, _OF_SLIDER = _BAR * 2e-4 / 12, _BAR * (1 + 1e-4) / 12, _SLIDER * 0.02 / 12
_START = np.pi / 6, 0.5


@dataclass(frozen=True)
class FlyballGovernor(OfEnergies):
    """Two balls on hinged rods turn about a shaft and hold a slider by stiff spring-dampers.

    The benchmark A05 of the library. Tests stiffness by damping: one rate of 8117 per s beside a
    swing of 6.1 rad/s, and an angle that grows without end. Both rods move alike, so that three
    coordinates are enough: the angle of the shaft, that of the rods below the horizontal, and the
    height of the slider. The angular momentum about the shaft is conserved. Left out: the motor, as
    the shaft turns freely.
    """

    name = "flyball_governor"
    interval = (0.0, 10.0)
    nominal_step = 0.01
    tags = ("stiff", "spatial", "benchmark")
    difficulties = ("a damper of rate 8117 per s: explicit methods need steps below 0.3 ms",)
    coordinates = ("shaft phi [rad]", "rods alpha [rad]", "slider s [m]")
    source = (
        "IFToMM benchmark library, A05; Gonzalez et al. (2006), doi:10.1007/s11044-006-9013-y; "
        "digits by Radau IIA at tolerances 1e-12 and 3e-13, which agree"
    )
    published = (
        Published("q", 1.0, (5.586346965869, 0.5218333016256, 0.5014209223796), 1e-11),
        Published("v", 1.0, (6.271125741877, 0.14088557948, -0.12215149290), 1e-10),
        Published("q", 5.0, (27.94253199104, 0.482874576587, 0.5355631037216), 1e-10),
        Published("v", 5.0, (6.022496499759, 0.61391704739, -0.54368269028), 1e-10),
    )

    omega: float = parameter(2 * np.pi, "rad/s", "angular velocity of the shaft at the start")
    k: float = parameter(8e5, "N/m", "stiffness of each spring", low=0.0)
    c: float = parameter(4e4, "N s/m", "damping of each damper", low=0.0)
    rest: float = parameter(0.5, "m", "length of the springs without force")
    g: float = parameter(9.81, "m/s^2", "gravity, along the shaft")

    def _axial_inertia(self, alpha: jax.Array) -> jax.Array:
        """Inertia of all bodies about the shaft in kg m^2."""
        cos, sin = jnp.cos(alpha), jnp.sin(alpha)
        rod = _ALONG * sin**2 + _ACROSS * cos**2 + _BAR * (_REACH + 0.5 * _ROD * cos) ** 2
        return _ALONG + _OF_SLIDER + 2 * (rod + _BALL * (_REACH + _ROD * cos) ** 2)

    def _kinetic_energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        swing = _ACROSS + _BAR * _ROD**2 / 4 + _BALL * _ROD**2
        turn = self._axial_inertia(q[1]) * v[0] ** 2
        return 0.5 * turn + swing * v[1] ** 2 + 0.5 * _SLIDER * v[2] ** 2

    def _potential_energy(self, q: jax.Array) -> jax.Array:
        weight = _SLIDER * q[2] - 2 * (0.5 * _BAR + _BALL) * _ROD * jnp.sin(q[1])
        return self.g * weight + self.k * (self._length(q) - self.rest) ** 2

    @staticmethod
    def _length(q: jax.Array) -> jax.Array:
        """Length of a spring in m, from the middle of a rod to the slider."""
        across, along = 0.5 * _ROD * jnp.cos(q[1]), _TOP - 0.5 * _ROD * jnp.sin(q[1]) - q[2]
        return jnp.sqrt(across**2 + along**2)

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        slope = jax.grad(self._length)(q)
        return super().force(q, v, t) - 2 * self.c * (slope @ v) * slope

    def momentum(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return self._axial_inertia(q[1])[None] * v[:1]

    def points(self, q: jax.Array) -> dict[str, jax.Array]:
        reach = _REACH + _ROD * jnp.cos(q[1])
        x, y, z = reach * jnp.cos(q[0]), reach * jnp.sin(q[0]), _TOP - _ROD * jnp.sin(q[1])
        return {"ball 1": jnp.stack([x, y, z]), "ball 2": jnp.stack([-x, -y, z])}

    def initial_state(self) -> State:
        return State(q=np.array([0.0, *_START]), v=np.array([self.omega, 0.0, 0.0]))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        # In the plane of the rods, which turns with the shaft.
        rod = np.array([[_REACH, _TOP], [_REACH + _ROD * np.cos(q[1]), _TOP - _ROD * np.sin(q[1])]])
        spring = np.array([rod.mean(axis=0), [_REACH, q[2]]])
        right = [rod, spring, drawing.circle(rod[1], 0.08)]
        left = [line * [-1.0, 1.0] for line in right]
        shaft = np.array([[0.0, 0.0], [0.0, _TOP], [_REACH, _TOP], [-_REACH, _TOP]])
        slider = drawing.box(0.0, _REACH) + np.array([0.0, q[2]])
        return [shaft, slider, *right, *left]
