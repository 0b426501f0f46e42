"""An oscillator under a sampled proportional-derivative controller, with its exact motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import Published, SampledSystem, State, Variables, held, jax, jnp, parameter
from problems.mechanics import drawing


@dataclass(frozen=True)
class SampledPd(SampledSystem):
    """A spring-mass system whose controller sees it at samples alone and holds its force between.

    The smallest loop of a digital controller: q'' + q = u with u = -2 q - q' at the last sample.
    Tests whether a method hits the samples: one that steps over them gives the motion of the
    continuous controller, which looks as smooth, and is another one. With a delay the force of a
    sample acts from the next one on. The loop without a delay loses stability at a sample time of
    2 arctan(1/2) = 0.927 s. Left out: noise and quantisation.
    """

    interval = (0.0, 5.0)
    nominal_step = 0.1
    tags = ("mechatronic", "linear", "sampled", "conformance")
    difficulties = ("the force jumps at each sample: a step across it is of first order",)
    coordinates = ("position [m]",)
    outputs = ("force [N]",)
    source = "digits of t = 5 s by matrix exponentials"
    published = (
        Published("q", 5.0, (-0.0412160715525846,), 1e-14),
        Published("v", 5.0, (-0.133917365855531,), 1e-14),
    )

    kp: float = parameter(2.0, "N/m", "proportional gain")
    kd: float = parameter(1.0, "N s/m", "derivative gain")
    delay: int = parameter(0, "1", "delay in samples: 0 or 1", low=0, high=1)
    demand: float = held(0.0, "N", "force demanded at the last sample")
    u: float = held(0.0, "N", "force of the actuator")

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.eye(1)

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return -q

    def output(self, z: Variables) -> jax.Array:
        return jnp.stack([self.u])

    def actuation(self) -> np.ndarray:
        return np.eye(1)

    def sample(self, z: Variables) -> dict[str, jax.Array | float]:
        demand = -self.kp * z.q[0] - self.kd * z.v[0]
        return {"demand": demand, "u": demand if self.delay == 0 else self.demand}

    def initial_state(self) -> State:
        return State(q=np.ones(1), v=np.zeros(1))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        x, wall = float(q[0]), -2.0
        spring = drawing.spring(wall, x - 0.2, reach=0.1)
        return [np.array([[wall, -0.3], [wall, 0.3]]), spring, drawing.box(x, 0.2)]
