"""Quarter cars: a semi-active damper with compressible oil, and a sampled controller."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, SampledSystem, State, Variables, held, jax, jnp, parameter
from problems.mechanics import drawing


@dataclass(frozen=True)
class SemiActiveDamper(MechatronicSystem):
    """A synthetic semi-active damper with compressible oil, to be inherited by a scene.

    The layout is that of continuously variable dampers: oil can leave the rebound chamber only
    through one valve, which a current throttles, into a gas accumulator. A check valve in the
    piston lets it back from the compression chamber, one in the base from the accumulator::

        extending:    accumulator -> compression chamber;  rebound chamber -> valve -> accumulator
        compressing:  compression chamber -> rebound chamber -> valve -> accumulator

    Extending, the compression chamber stays near the accumulator's low pressure; compressing, it
    follows the rebound chamber. States are the two pressures in MPa, so that they are of the size
    of the other variables, and relative to the accumulator's, so that they are exactly zero at
    rest: a step from rest has to resolve tiny rates. The data give the forces of a passenger car's
    damper.

    Left out: the chambers' change of volume with the stroke (it moves their poles by some ten
    percent), cavitation, friction, the valve's own motion, and the accumulator's: its pressure
    is constant, and the force of that pressure on the rod belongs to the spring's static load.
    """

    a_piston: float = parameter(8.0e-4, "m^2", "area of the piston", low=1e-9)
    a_rod: float = parameter(3.8e-4, "m^2", "cross section of the piston rod", low=1e-9)
    v_reb: float = parameter(8.4e-5, "m^3", "volume of the rebound chamber", low=1e-12)
    v_comp: float = parameter(1.6e-4, "m^3", "volume of the compression chamber", low=1e-12)
    bulk: float = parameter(120.0, "MPa", "bulk modulus of oil, bubbles and walls", low=1e-9)
    density: float = parameter(870.0, "kg/m^3", "density of the oil", low=1e-9)
    soft_area: float = parameter(3.2e-6, "m^2", "valve's flow area at i_min", low=1e-12)
    firm_area: float = parameter(3.0e-7, "m^2", "valve's flow area at i_max", low=1e-12)
    p_turb: float = parameter(
        0.05, "MPa", "pressure drop below which the valve's flow is laminar", low=1e-9
    )
    p_relief: float = parameter(3.6, "MPa", "pressure drop at which the relief opens", low=0.0)
    relief: float = parameter(
        5e-5, "m^3/(s MPa)", "flow through the relief per pressure drop", low=0.0
    )
    check: float = parameter(
        1e-3, "m^3/(s MPa)", "flow through a check valve per pressure drop", low=1e-12
    )
    p_check: float = parameter(0.02, "MPa", "drop over which a check valve opens", low=1e-9)
    i_min: float = parameter(0.3, "A", "least current: soft")
    i_max: float = parameter(1.6, "A", "largest current: firm")
    i_soft: float = parameter(0.05, "A", "rounding of the current's limits", low=1e-9)

    def _flows(
        self, p_reb: jax.Array, p_comp: jax.Array, i: jax.Array
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Flows in m^3/s; each has the sign of its pressure drop, so that none gives energy.

        The first goes through valve and relief out of the rebound chamber, the second through the
        check valve of the piston into it, the third through the check valve of the base into the
        compression chamber.
        """
        # Two square roots cost less than a power of 1/4 and its derivatives.
        root = jnp.sqrt(jnp.sqrt(p_reb**2 + self.p_turb**2))
        speed = jnp.sqrt(2e6 / self.density) * p_reb / root
        part = (i - self.i_min) / (self.i_max - self.i_min)
        area = self.soft_area + part * (self.firm_area - self.soft_area)
        out = area * speed + self._relieved(p_reb)
        return out, self._checked(p_comp - p_reb), self._checked(-p_comp)

    # The next two functions compute root(drop) - root(0) without cancellation.
    def _relieved(self, drop: jax.Array) -> jax.Array:
        """Flow through the relief; its opening is rounded over a twentieth of its pressure."""
        at, rounding = self.p_relief, 0.05 * self.p_relief
        roots = jnp.sqrt((drop - at) ** 2 + rounding**2) + jnp.sqrt(at**2 + rounding**2)
        return 0.5 * self.relief * drop * (1 + (drop - 2 * at) / roots)

    def _checked(self, drop: jax.Array) -> jax.Array:
        """Flow through a check valve: check * (drop + sqrt(drop^2 + p_check^2) - p_check)/2."""
        roots = jnp.sqrt(drop**2 + self.p_check**2) + self.p_check
        return 0.5 * self.check * drop * (1 + drop / roots)

    def _pressure_rates(
        self, p_reb: jax.Array, p_comp: jax.Array, i: jax.Array, speed: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Rates of both pressures in MPa/s at a speed of extension in m/s."""
        out, piston, base = self._flows(p_reb, p_comp, i)
        return (
            self.bulk / self.v_reb * ((self.a_piston - self.a_rod) * speed - out + piston),
            self.bulk / self.v_comp * (-self.a_piston * speed - piston + base),
        )

    def _damper_force(self, p_reb: jax.Array, p_comp: jax.Array) -> jax.Array:
        """Force in N with which the damper pulls its ends together."""
        return 1e6 * ((self.a_piston - self.a_rod) * p_reb - self.a_piston * p_comp)

    def _limited_current(self, i: jax.Array) -> jax.Array:
        """Current in A that flows if the controller asks for i; its limits have round corners."""
        above, beyond = ((i - limit) / self.i_soft for limit in (self.i_min, self.i_max))
        return self.i_min + self.i_soft * (jax.nn.softplus(above) - jax.nn.softplus(beyond))


#: Waves of the rough road: cycles per m, and phases that were drawn once. Their amplitudes fall
#: like 1/frequency, which is a road whose slope has no preferred frequency.
_WAVES = np.geomspace(0.05, 0.8, 9)
_PHASES = np.array([3.18, 2.74, 5.57, 3.53, 0.41, 5.02, 1.27, 0.63, 5.92])


@dataclass(frozen=True)
class _BodyAndWheel(MechatronicSystem):
    """Body and wheel over a bump: data and picture that the quarter cars share."""

    coordinates = ("body [m]", "wheel [m]")

    m_body: float = parameter(241.43, "kg", "quarter of the sprung mass", low=1e-9)
    m_wheel: float = parameter(31.896, "kg", "unsprung mass", low=1e-9)
    k: float = parameter(24453.1, "N/m", "stiffness of the spring", low=0.0)
    k_tyre: float = parameter(158294.0, "N/m", "vertical stiffness of the tyre", low=0.0)
    speed: float = parameter(15.0, "m/s", "speed of travel")
    bump: float = parameter(0.05, "m", "height of the bump")
    bump_length: float = parameter(1.5, "m", "half length of the bump, where 1/e is left", low=1e-9)
    bump_place: float = parameter(12.0, "m", "way to the middle of the bump")

    def _road(self, t: jax.Array) -> jax.Array:
        """Height of the road under the wheel in m, scalar."""
        far = (self.speed * t - self.bump_place) / self.bump_length
        return self.bump * jnp.exp(-(far**2))

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.diag(jnp.stack([self.m_body, self.m_wheel]))

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        spring = self.k * (q[1] - q[0])
        tyre = self.k_tyre * (self._road(t) - q[1])
        return jnp.stack([spring, tyre - spring])

    def initial_state(self) -> State:
        return State(q=np.zeros(2), v=np.zeros(2))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        # Motions are drawn four times as large: they are small against the heights.
        body, wheel = 1.1 + 4 * float(q[0]), 0.35 + 4 * float(q[1])
        box = drawing.rectangle(-0.6, 0.6, body, body + 0.4)
        spring = drawing.spring(wheel, body, reach=0.06, points=12)[:, ::-1] - [0.18, 0.0]
        return [drawing.circle(np.array([0.0, wheel]), 0.34), box, spring]


@dataclass(frozen=True)
class QuarterCar(SemiActiveDamper, _BodyAndWheel):
    """Body and wheel over a bump and a rough road; the damper's valve obeys a skyhook controller.

    A semi-active suspension in its smallest form. Tests a loop whose check valves, limits of the
    current and switching skyhook are nonlinear on very different scales. The controller integrates
    the body's acceleration to a velocity, with a leak. It asks for current if this velocity and
    the damper's have the same sign, so that the damper can oppose it.

    Pressures are relative to the accumulator's; q is counted from the static equilibrium, where
    weights and the spring's preload cancel. Left out: lift-off of the tyre and its damping,
    geometry of the suspension, sensor noise and delay; they would add linear states or corners.
    """

    interval = (0.0, 4.0)
    nominal_step = 5e-3
    tags = ("mechatronic", "smooth", "stiff controller states", "vehicle")
    difficulties = (
        "acceleration feedback: the controller reads a within the step",
        "chamber pressures have poles of hundreds to thousands of 1/s: explicit steps stay short",
        "currents run from limit to limit: the asymptotic range begins at small steps",
    )
    states = ("rebound pressure [MPa]", "compression pressure [MPa]", "body velocity [m/s]")
    outputs = ("valve current [A]", "damper force [N]")
    source = (
        "Application of Bruels & Arnold (2008), section 7, reduced to one wheel; masses, spring "
        "and tyre of the BMW 320i in CommonRoad's vehicle models; synthetic damper"
    )

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
        return super().initial_state()._replace(x=np.zeros(3))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        rim, box, spring = super().draw(q)
        (wheel, body), x = spring[[0, -1], 1], 0.18
        middle = 0.5 * (wheel + body)
        return [rim, box, spring, np.array([[x, wheel], [x, middle]]),
                np.array([[x, middle - 0.1], [x, body]])]  # fmt: skip


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


@dataclass(frozen=True)
class SampledQuarterCar(SampledSystem, _BodyAndWheel):
    """Body and wheel on a bump; a controller sets the rate of the damper at each sample.

    The controller is that of a real control unit: it reads the velocities every few milliseconds,
    asks for much damping where the damper can oppose the body's velocity (skyhook, on and off), in
    steps of its output, and its command acts one sample later. Tests samples in a stiff mechanical
    system. q is counted from the static equilibrium. Left out: the valve's own dynamics, lift-off
    of the tyre and the suspension's geometry.
    """

    interval = (0.0, 2.0)
    nominal_step = 0.01
    sample_time: float = parameter(0.01, "s", "time between two samples", low=1e-6)
    tags = ("mechatronic", "sampled", "vehicle")
    difficulties = ("accelerations jump at samples by the damper's rate",)
    outputs = ("damper force [N]",)
    source = "masses, spring and tyre of quarter_car; synthetic damper and controller"

    bump_place: float = parameter(6.0, "m", "way to the middle of the bump")
    least: float = parameter(400.0, "N s/m", "least rate of the damper", low=0.0)
    most: float = parameter(3000.0, "N s/m", "largest rate of the damper", low=0.0)
    gain: float = parameter(3000.0, "N s/m", "skyhook gain", low=0.0)
    quantum: float = parameter(100.0, "N s/m", "step of the controller's output", low=1e-9)
    demand: float = held(400.0, "N s/m", "rate asked for at the last sample")
    rate: float = held(400.0, "N s/m", "rate of the damper")

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
