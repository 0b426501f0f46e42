"""A coin that rolls on a plane without slipping."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import State, jax, jnp, parameter
from problems.mechanics.lagrange import OfEnergies


@dataclass(frozen=True)
class RollingDisc(OfEnergies):
    """A thin uniform disc rolls on a horizontal plane: two constraints of velocities, in space.

    Tests rolling, with rotation by three angles: heading (about the vertical, z up), lean (to the
    right) and spin. The point that touches the plane has no velocity along and across the heading;
    the height of the centre, r cos(lean), is put into the energies. At the start the disc rolls
    upright with a small rate of lean and spins too slowly to stay so: it is stable for
    spin^2 > g/(3 r) only, and sways in arcs. Left out: friction, slipping, and a disc that lies
    flat, where heading and spin are one angle (Euler's disc).
    """

    interval = (0.0, 5.0)
    nominal_step = 0.01
    tags = ("constrained", "nonholonomic", "conservative", "spatial", "smooth")
    difficulties = (
        "constraints of velocities whose multipliers follow the heading",
        "near lean = pi/2 heading and spin become one angle, and their rates large",
    )
    coordinates = ("centre x [m]", "centre y [m]", "heading [rad]", "lean [rad]", "spin [rad]")
    multipliers = ("along [N]", "across [N]")
    energy = OfEnergies._total
    source = "Neimark & Fufaev (1972); Bloch (2003), section 1.4; O'Reilly (1996)"

    m: float = parameter(1.0, "kg", "mass", low=1e-12)
    r: float = parameter(0.5, "m", "radius", low=1e-9)
    g: float = parameter(9.81, "m/s^2", "gravity", low=0.0)
    lean0: float = parameter(0.0, "rad", "initial lean", low=-1.5, high=1.5)
    turn0: float = parameter(0.0, "rad/s", "initial rate of the heading")
    lean_rate0: float = parameter(0.2, "rad/s", "initial rate of the lean")
    spin0: float = parameter(2.0, "rad/s", "initial rate of the spin")

    def _kinetic_energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        dx, dy, turn, lean_rate, spin = v
        axial = spin + turn * jnp.sin(q[3])
        across = lean_rate**2 + (turn * jnp.cos(q[3])) ** 2
        rise = self.r * lean_rate * jnp.sin(q[3])
        inertia = self.m * self.r**2 / 4  # across the axis; twice as much about it
        return self.m / 2 * (dx**2 + dy**2 + rise**2) + inertia / 2 * (across + 2 * axial**2)

    def _potential_energy(self, q: jax.Array) -> jax.Array:
        return self.m * self.g * self.r * jnp.cos(q[3])

    def velocity_constraint(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        _, _, heading, lean, _ = q
        dx, dy, turn, lean_rate, spin = v
        c, s = jnp.cos(heading), jnp.sin(heading)
        along = c * dx + s * dy - self.r * (spin + turn * jnp.sin(lean))
        return jnp.stack([along, c * dy - s * dx + self.r * lean_rate * jnp.cos(lean)])

    def initial_state(self) -> State:
        speed = self.r * (self.spin0 + self.turn0 * np.sin(self.lean0))
        aside = -self.r * self.lean_rate0 * np.cos(self.lean0)
        return State(
            q=np.array([0.0, 0.0, 0.0, self.lean0, 0.0]),
            v=np.array([speed, aside, self.turn0, self.lean_rate0, self.spin0]),
        )

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        # Oblique view: x to the right, y into the picture, z up.
        view = np.array([[1.0, 0.0], [0.4, 0.3], [0.0, 1.0]])
        x, y, heading, lean, spin = q
        (c, s), (cl, sl) = np.cos([heading, np.pi / 2 - heading]), (np.cos(lean), np.sin(lean))
        along, up = np.array([c, s, 0.0]), np.array([s * sl, -c * sl, cl])
        centre = np.array([x, y, self.r * cl])
        angle = np.linspace(0, 2 * np.pi, 33) + spin
        rim = centre + self.r * (np.outer(np.sin(angle), along) + np.outer(np.cos(angle), up))
        corners = np.array([[-2, -2], [2, -2], [2, 2], [-2, 2], [-2, -2]]) * self.r
        ground = np.column_stack([corners + centre[:2], np.zeros(5)])
        return [line @ view for line in (ground, rim, np.stack([centre, rim[0]]))]
