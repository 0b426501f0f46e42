"""A rod that slides on rough ground, up to where rigid bodies with friction have no answer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, State, Variables, jax, jnp, parameter


@dataclass(frozen=True)
class PainleveRod(MechatronicSystem):
    """A rod slides on its tip with Coulomb friction, which tips it towards Painleve's paradox.

    The normal force is (m g - m s sin(phi) w^2)/(1 + 3 cos(phi) (cos(phi) - mu sin(phi))); the
    divisor, 1.00 at the start and 0.14 at the end, vanishes at tan(phi) = 1: no force keeps the
    contact then, and rigid bodies have no unique motion. Tests a force that depends on lam, where
    the equations for a and lam turn singular: how long a method follows. Left out: the motion
    behind that point, a tip that comes to rest, and one that lifts off; the default does neither.
    """

    interval = (0.0, 0.8)
    nominal_step = 0.02
    tags = ("constrained", "index 3", "friction", "dissipative")
    difficulties = (
        "a force depends on lam: methods that know lam only after the step cannot take it",
        "the matrix for a and lam is nearly singular at the end, and lam grows",
    )
    coordinates = ("x [m]", "y [m]", "angle [rad]")
    multipliers = ("minus the normal force [N]",)
    source = "Painleve (1895); data of Glocker (1995), section 5.3.4"

    m: float = parameter(1.0, "kg", "mass", low=1e-9)
    s: float = parameter(1.0, "m", "half of the length", low=1e-9)
    mu: float = parameter(5 / 3, "1", "coefficient of friction", low=0.0)
    g: float = parameter(10.0, "m/s^2", "gravity", low=0.0)
    phi0: float = parameter(np.radians(31.0), "rad", "angle at the start, from the ground")
    speed: float = parameter(30.0, "m/s", "speed at the start")

    def mass(self, q: jax.Array) -> jax.Array:
        return self.m * jnp.diag(jnp.stack([1.0, 1.0, self.s**2 / 3]))

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return jnp.stack([0.0, -self.m * self.g, 0.0])

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        return (q[1] - self.s * jnp.sin(q[2]))[None]

    def coupled_force(self, z: Variables) -> jax.Array:
        rub = -self.mu * z.lam[0]
        return rub * jnp.stack([-1.0, 0.0, self.s * jnp.sin(z.q[2])])

    def initial_state(self) -> State:
        q = np.array([0.0, self.s * np.sin(self.phi0), self.phi0])
        return State(q=q, v=np.array([self.speed, 0.0, 0.0]))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        half = self.s * np.array([np.cos(q[2]), -np.sin(q[2])])
        centre = np.array([0.0, q[1]])  # it would leave the picture
        ground = np.array([[-1.5, 0.0], [1.5, 0.0]]) * self.s
        return [ground, np.array([centre - half, centre + half])]
