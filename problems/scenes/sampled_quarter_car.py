"""A quarter car with a skyhook controller that is sampled, delayed and quantised."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import SampledSystem, State, Variables, held, jax, jnp, parameter
from problems.mechanics import drawing


@dataclass(frozen=True)
class SampledQuarterCar(SampledSystem):
    """Body and wheel on a bump; a controller sets the rate of the damper at each sample.

    The controller is that of a real control unit: it reads the velocities every few milliseconds,
    asks for much damping where the damper can oppose the body's velocity (skyhook, on and off), in
    steps of its output, and its command acts one sample later. Tests samples in a stiff mechanical
    system: the damper's rate jumps, and with it the accelerations. q is counted from the static
    equilibrium. Left out: the valve's own dynamics, lift-off of the tyre and the suspension's
    geometry.
    """

    interval = (0.0, 2.0)
    nominal_step = 0.01
    sample_time: float = parameter(0.01, "s", "time between two samples", low=1e-6)
    tags = ("mechatronic", "sampled", "vehicle")
    difficulties = ("accelerations jump at samples by the damper's rate",)
    coordinates = ("body [m]", "wheel [m]")
    outputs = ("damper force [N]",)
    source = "masses, spring and tyre of quarter_car; synthetic damper and controller"

    m_body: float = parameter(241.43, "kg", "quarter of the sprung mass", low=1e-9)
    m_wheel: float = parameter(31.896, "kg", "unsprung mass", low=1e-9)
    k: float = parameter(24453.1, "N/m", "stiffness of the spring", low=0.0)
    k_tyre: float = parameter(158294.0, "N/m", "vertical stiffness of the tyre", low=0.0)
    speed: float = parameter(15.0, "m/s", "speed of travel")
    bump: float = parameter(0.05, "m", "height of the bump")
    bump_length: float = parameter(1.5, "m", "half length of the bump, where 1/e is left", low=1e-9)
    bump_place: float = parameter(6.0, "m", "way to the middle of the bump")
    least: float = parameter(400.0, "N s/m", "least rate of the damper", low=0.0)
    most: float = parameter(3000.0, "N s/m", "largest rate of the damper", low=0.0)
    gain: float = parameter(3000.0, "N s/m", "skyhook gain", low=0.0)
    quantum: float = parameter(100.0, "N s/m", "step of the controller's output", low=1e-9)
    demand: float = held(400.0, "N s/m", "rate asked for at the last sample")
    rate: float = held(400.0, "N s/m", "rate of the damper")

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.diag(jnp.stack([self.m_body, self.m_wheel]))

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        far = (self.speed * t - self.bump_place) / self.bump_length
        spring = self.k * (q[1] - q[0])
        tyre = self.k_tyre * (self.bump * jnp.exp(-(far**2)) - q[1])
        return jnp.stack([spring, tyre - spring])

    def output(self, z: Variables) -> jax.Array:
        return jnp.stack([self.rate * (z.v[0] - z.v[1])])

    def actuation(self) -> np.ndarray:
        return np.array([[-1.0], [1.0]])

    def sample(self, z: Variables) -> dict[str, jax.Array | float]:
        across = z.v[0] - z.v[1]
        helps = z.v[0] * across > 0
        # gain v_body = rate (v_body - v_wheel), as far as the damper can
        asked = self.gain * z.v[0] / jnp.where(jnp.abs(across) > 1e-9, across, 1e-9)
        rate = self.quantum * jnp.round(jnp.where(helps, asked, 0.0) / self.quantum)
        return {"demand": jnp.clip(rate, self.least, self.most), "rate": self.demand}

    def initial_state(self) -> State:
        return State(q=np.zeros(2), v=np.zeros(2))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        # Motions are drawn four times as large: they are small against the heights.
        body, wheel = 1.1 + 4 * float(q[0]), 0.35 + 4 * float(q[1])
        box = np.array([[-3, 0], [3, 0], [3, 2], [-3, 2], [-3, 0]]) * 0.2 + [0.0, body]
        spring = drawing.spring(wheel, body, reach=0.06, points=12)[:, ::-1] - [0.18, 0.0]
        return [drawing.circle(np.array([0.0, wheel]), 0.34), box, spring]
