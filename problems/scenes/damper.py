"""A synthetic semi-active damper with compressible oil, for the vehicle scenes.

The layout is that of continuously variable dampers: oil can leave the rebound chamber only
through one valve, which a current throttles, into a gas accumulator. A check valve in the piston
lets it back from the compression chamber, one in the base from the accumulator::

    extending:    accumulator -> compression chamber;  rebound chamber -> valve -> accumulator
    compressing:  compression chamber -> rebound chamber -> valve -> accumulator

Extending, the compression chamber stays near the accumulator's low pressure; compressing, it
follows the rebound chamber. States are the two pressures in MPa, so that they are of the size of
the other variables, and relative to the accumulator's, so that they are exactly zero at rest: a
step from rest has to resolve tiny rates. The data are synthetic; they give the forces of a
passenger car's damper.
"""

from __future__ import annotations

from dataclasses import dataclass

from problems import MechatronicSystem, jax, jnp, parameter


def limited(value: jax.Array, low: float, high: float, soft: float) -> jax.Array:
    """Limit a value; the corners are rounded over about ``soft``."""
    return low + soft * (
        jax.nn.softplus((value - low) / soft) - jax.nn.softplus((value - high) / soft)
    )


@dataclass(frozen=True)
class SemiActiveDamper(MechatronicSystem):
    """Parameters and equations of the damper, to be inherited by a scene.

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

    def _valve_area(self, i: jax.Array) -> jax.Array:
        """Flow area in m^2, falling linearly with the current in A."""
        part = (i - self.i_min) / (self.i_max - self.i_min)
        return self.soft_area + part * (self.firm_area - self.soft_area)

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
        out = self._valve_area(i) * speed + self._relieved(p_reb)
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
        """Current in A that flows if the controller asks for i."""
        return limited(i, self.i_min, self.i_max, self.i_soft)
