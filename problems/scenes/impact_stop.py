"""A forced mass that strikes a rigid stop: the rigid twin of `soft_impact`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import ContactSystem, State, jax, jnp, parameter
from problems.mechanics import drawing


@dataclass(frozen=True)
class ImpactStop(ContactSystem):
    """A mass on a spring, driven by a harmonic force, strikes a rigid stop with restitution.

    Between impacts the motion is the closed form of a linear oscillator, so that times of impact
    are roots of known functions: they test how contact is located or passed, at velocities that
    differ from impact to impact. Left out: damping, friction, and impacts that accumulate.
    """

    interval = (0.0, 4.0)
    nominal_step = 0.02
    tags = ("events", "impact")
    difficulties = (
        "the velocity jumps at times that the motion decides",
        "an error in the time of an impact is an error in the phase of the force behind it",
    )
    coordinates = ("distance from the stop [m]",)
    source = "linear oscillator in closed form, with Newton's law of impact"

    m: float = parameter(1.0, "kg", "mass", low=1e-9)
    k: float = parameter(40.0, "N/m", "stiffness of the spring", low=1e-9)
    rest: float = parameter(0.05, "m", "distance at which the spring is not stretched")
    amplitude: float = parameter(6.0, "N", "amplitude of the force")
    omega: float = parameter(8.0, "rad/s", "frequency of the force", low=0.0)
    restitution: float = parameter(
        0.7, "1", "part of the velocity that an impact leaves", low=0.0, high=1.0
    )

    def mass(self, q: jax.Array) -> jax.Array:
        return self.m * jnp.eye(1)

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return self.k * (self.rest - q) + self.amplitude * jnp.cos(self.omega * t)

    def gaps(self, q: jax.Array, t: jax.Array) -> jax.Array:
        return q

    def initial_state(self) -> State:
        return State(q=np.array([0.1]), v=np.zeros(1))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        at, half = float(q[0]), 0.04
        stop = np.array([[0.0, -2 * half], [0.0, 2 * half]])
        wall = np.array([[0.8, -2 * half], [0.8, 2 * half]])
        spring = drawing.spring(at + 2 * half, 0.8, half / 2)
        return [stop, wall, drawing.box(at + half, half), spring]
