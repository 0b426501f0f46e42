"""The controlled spring-mass system of Bruels & Arnold (2008), Figs 3-6."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, State, Variables, jax, jnp, parameter
from problems.mechanics import drawing


@dataclass(frozen=True)
class SpringMass(MechatronicSystem):
    """Active damping of one mass by acceleration feedback through a saturated actuator.

    Tests the whole mechatronic loop in its smallest form: the measured acceleration drives a
    filter, the filter demands a force, the actuator saturates, and its force acts back on the
    acceleration within the same step. The outputs y = [demanded force, actuator force] are not
    eliminated: their coupling within the step is tested. Left out: actuator dynamics and sensor
    delay, which would only add linear states.
    """

    interval = (0.0, 20.0)
    nominal_step = 0.1
    tags = ("mechatronic", "smooth", "nonlinear output", "conformance")
    difficulties = (
        "the acceleration is fed back in the step: a first-order one spoils everything",
    )
    coordinates = ("position [m]",)
    states = ("controller [N]",)
    outputs = ("demanded force [N]", "limited force [N]")
    source = "Bruels & Arnold (2008), section 6, Figs 3-6"

    m: float = parameter(1.0, "kg", "mass", low=1e-12)
    k: float = parameter(1.0, "N/m", "spring stiffness")
    sigma: float = parameter(0.1, "1/s", "leak of the controller's integrator")
    b: float = parameter(1.4, "N s/m", "feedback gain on the acceleration")
    g_max: float = parameter(1.0, "N", "saturation of the actuator", low=1e-12)
    q0: float = parameter(5.0, "m", "initial position")

    def mass(self, q: jax.Array) -> jax.Array:
        return self.m * jnp.eye(1)

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return -self.k * q

    def state_rate(self, z: Variables) -> jax.Array:
        return -self.sigma * z.x - self.b * z.a

    def output(self, z: Variables) -> jax.Array:
        return jnp.stack([z.x[0], self.g_max * jnp.tanh(z.y[0] / self.g_max)])

    def actuation(self) -> np.ndarray:
        return np.array([[0.0, 1.0]])

    def initial_state(self) -> State:
        return State(q=np.array([self.q0]), v=np.zeros(1), x=np.zeros(1))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        x, wall, half = float(q[0]), -8.0, 0.6
        spring = drawing.spring(wall, x - half, reach=0.4)
        return [np.array([[wall, -1.0], [wall, 1.0]]), spring, drawing.box(x, half)]
