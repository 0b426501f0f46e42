"""The damped and driven Duffing oscillator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, State, jax, jnp, parameter
from problems.mechanics import drawing


@dataclass(frozen=True)
class Duffing(MechatronicSystem):
    """One mass on a hardening spring, damped and driven: m a + c v + k q + k3 q^3 = F cos(w t).

    Tests the order of the acceleration on the simplest scene with damping, nonlinearity and
    explicit time: no symmetry or conservation cancels an error, and a method that reports its
    auxiliary acceleration shows first order. Left out: constraints and a controller, which have
    scenes of their own; a long interval, on which the driven oscillator can become chaotic, so
    that errors would no longer show the order.
    """

    interval = (0.0, 3.0)
    nominal_step = 0.05
    tags = ("smooth", "nonlinear", "driven", "damped")
    difficulties = ("the classical forms of generalized-alpha report a first-order acceleration",)
    coordinates = ("position [m]",)
    source = "Duffing (1918), Erzwungene Schwingungen bei veraenderlicher Eigenfrequenz"

    m: float = parameter(1.0, "kg", "mass", low=1e-12)
    c: float = parameter(0.3, "N s/m", "damping")
    k: float = parameter(1.0, "N/m", "linear stiffness")
    k3: float = parameter(0.5, "N/m^3", "cubic stiffness")
    amplitude: float = parameter(1.0, "N", "amplitude of the driving force")
    w: float = parameter(2.0, "rad/s", "angular frequency of the driving force")
    q0: float = parameter(1.0, "m", "initial position")
    v0: float = parameter(0.5, "m/s", "initial velocity")

    def mass(self, q: jax.Array) -> jax.Array:
        return self.m * jnp.eye(1)

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return self.amplitude * jnp.cos(self.w * t) - self.c * v - self.k * q - self.k3 * q**3

    def initial_state(self) -> State:
        return State(q=np.array([self.q0]), v=np.array([self.v0]))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        x, wall, half = float(q[0]), -3.0, 0.3
        spring = drawing.spring(wall, x - half, reach=0.2, points=16)
        return [np.array([[wall, -0.5], [wall, 0.5]]), spring, drawing.box(x, half)]
