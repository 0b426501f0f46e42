"""A quarter car with a semi-active damper, controlled by the body's acceleration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import State, Variables, held, jax, jnp, parameter
from problems.mechanics import drawing
from problems.scenes.damper import SemiActiveDamper

#: Waves of the rough road: cycles per m, and phases that were drawn once. Their amplitudes fall
#: like 1/frequency, which is a road whose slope has no preferred frequency.
_WAVES = np.geomspace(0.05, 0.8, 9)
_PHASES = np.array([3.18, 2.74, 5.57, 3.53, 0.41, 5.02, 1.27, 0.63, 5.92])


@dataclass(frozen=True)
class QuarterCar(SemiActiveDamper):
    """Body and wheel over a bump and a rough road; the damper's valve obeys a skyhook controller.

    A semi-active suspension in its smallest form. Tests the difficulties of the loop: the measured
    acceleration enters the controller's rates; the pressures are stiff (poles of 1e2 to 4e3 1/s),
    and their output is the force on body and wheel; check valves, the current's limits and the
    skyhook's switching are nonlinear on very different scales. The controller integrates the
    body's acceleration to a velocity, with a leak. It asks for current if this velocity and the
    damper's have the same sign, so that the damper can oppose it.

    x = [pressures of the rebound and of the compression chamber, relative to the accumulator's;
    estimated velocity]; y = [current, damper force]. q is counted from the static equilibrium,
    where weights and the spring's preload cancel. Left out: lift-off of the tyre and its damping,
    geometry of the suspension, sensor noise and delay; they would add linear states or corners.
    """

    interval = (0.0, 4.0)
    nominal_step = 5e-3
    tags = ("mechatronic", "smooth", "stiff controller states", "vehicle")
    difficulties = (
        "the acceleration is fed back in the step",
        "chamber pressures have poles of hundreds to thousands of 1/s: explicit methods crawl",
        "currents run from limit to limit: the asymptotic range begins at small steps",
    )
    coordinates = ("body [m]", "wheel [m]")
    states = ("rebound pressure [MPa]", "compression pressure [MPa]", "body velocity [m/s]")
    outputs = ("valve current [A]", "damper force [N]")
    source = (
        "Application of Bruels & Arnold (2008), section 7, reduced to one wheel; masses, spring "
        "and tyre of the BMW 320i in CommonRoad's vehicle models; synthetic damper"
    )

    m_body: float = parameter(241.43, "kg", "quarter of the sprung mass", low=1e-9)
    m_wheel: float = parameter(31.896, "kg", "unsprung mass", low=1e-9)
    k: float = parameter(24453.1, "N/m", "stiffness of the spring", low=0.0)
    k_tyre: float = parameter(158294.0, "N/m", "vertical stiffness of the tyre", low=0.0)
    speed: float = parameter(15.0, "m/s", "speed of travel")
    bump: float = parameter(0.05, "m", "height of the bump")
    bump_length: float = parameter(1.5, "m", "half length of the bump, where 1/e is left", low=1e-9)
    bump_place: float = parameter(12.0, "m", "way to the middle of the bump")
    corner: float = parameter(
        0.0, "1", "0: a smooth bump; 1: two planes that meet in corners", low=0.0, high=1.0
    )
    rough: float = parameter(2e-3, "m", "amplitude of the road's longest wave")
    leak: float = parameter(0.5, "1/s", "leak of the controller's integrator", low=0.0)
    gain: float = parameter(3.0, "A s/m", "current asked for per velocity of the body")
    v_switch: float = parameter(
        0.03, "m/s", "damper speed over which the skyhook switches", low=1e-9
    )

    def _road(self, t: jax.Array) -> jax.Array:
        """Height of the road under the wheel in m, scalar; zero where the run starts."""
        way = self.speed * t
        waves = jnp.sin(2 * np.pi * _WAVES * way + _PHASES) @ (_WAVES[0] / _WAVES)
        fade_in = jnp.tanh(way / 5.0)
        far = (way - self.bump_place) / self.bump_length
        smooth, planes = jnp.exp(-(far**2)), jnp.maximum(1 - jnp.abs(far), 0.0)
        shape = smooth + self.corner * (planes - smooth)
        return self.rough * fade_in * waves + self.bump * shape

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.diag(jnp.stack([self.m_body, self.m_wheel]))

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        spring = self.k * (q[1] - q[0])
        tyre = self.k_tyre * (self._road(t) - q[1])
        return jnp.stack([spring, tyre - spring])

    def state_rate(self, z: Variables) -> jax.Array:
        p_reb, p_comp, v_body = z.x
        rates = self._pressure_rates(p_reb, p_comp, z.y[0], z.v[0] - z.v[1])
        return jnp.stack([*rates, z.a[0] - self.leak * v_body])

    def output(self, z: Variables) -> jax.Array:
        p_reb, p_comp, v_body = z.x
        direction = jnp.tanh((z.v[0] - z.v[1]) / self.v_switch)
        current = self._limited_current(self.i_min + self.gain * v_body * direction)
        return jnp.stack([current, self._damper_force(p_reb, p_comp)])

    def actuation(self) -> np.ndarray:
        return np.array([[0.0, -1.0], [0.0, 1.0]])

    def initial_state(self) -> State:
        return State(q=np.zeros(2), v=np.zeros(2), x=np.zeros(3))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        # Motions are drawn four times as large: they are small against the heights.
        body, wheel = 1.1 + 4 * float(q[0]), 0.35 + 4 * float(q[1])
        rim = drawing.circle(np.array([0.0, wheel]), 0.34)
        box = np.array([[-3, 0], [3, 0], [3, 2], [-3, 2], [-3, 0]]) * 0.2 + [0.0, body]
        spring = drawing.spring(wheel, body, reach=0.06, points=12)[:, ::-1] - [0.18, 0.0]
        middle = 0.5 * (wheel + body)
        cylinder = np.array([[0.18, wheel], [0.18, middle]])
        rod = np.array([[0.18, middle - 0.1], [0.18, body]])
        return [rim, box, spring, cylinder, rod]


@dataclass(frozen=True)
class QuarterCarStop(QuarterCar):
    """The quarter car on a bump so high that its suspension strikes an elastic stop.

    Tests an event without a jump in the loop: the force of the stop sets in with a kink, at times
    that the motion decides. Methods that restart there keep their order; those that step over it
    lose it. Left out: the damping of the stop, and lift-off of the tyre.
    """

    interval = (0.0, 1.5)
    tags = ("mechatronic", "events", "stiff controller states", "vehicle")
    difficulties = ("the suspension's stiffness is tenfold from one instant to the next",)

    bump: float = parameter(0.1, "m", "height of the bump")
    travel: float = parameter(0.04, "m", "compression at which the stop is reached", low=0.0)
    k_stop: float = parameter(2.4e5, "N/m", "stiffness of the stop", low=0.0)
    touches: float = held(0.0, "1", "1: the stop is pressed")

    def _room(self, q: jax.Array) -> jax.Array:
        """Way to the stop in m, scalar; negative where it is pressed."""
        return self.travel + q[0] - q[1]

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        stop = -self.touches * self.k_stop * self._room(q)
        return super().force(q, v, t) + jnp.stack([stop, -stop])

    def events(self, z: Variables) -> jax.Array:
        return (jnp.where(self.touches > 0, -1.0, 1.0) * self._room(z.q))[None]

    def jump(self, z: Variables, event: int) -> dict[str, float]:
        return {"touches": 1.0 - self.touches}
