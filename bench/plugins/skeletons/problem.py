"""A scene for stepbench: change it, and check it with `stepbench check`."""

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, State, jnp, parameter


@dataclass(frozen=True)
class NewProblem(MechatronicSystem):
    """A bead on a parabolic wire y = c x^2 under gravity.

    Say here what the scene tests, what it leaves out, and why that does not matter.
    """

    interval = (0.0, 2.0)  # s
    nominal_step = 0.02  # s: the largest step of a convergence study
    tags = ("constrained", "conservative")
    coordinates = ("x [m]", "y [m]")  # names of the entries of q, with units
    source = ""  # where it is published, with its DOI

    m: float = parameter(1.0, "kg", "mass", low=1e-9)
    c: float = parameter(0.5, "1/m", "curvature of the wire at its lowest point, halved")
    g: float = parameter(9.81, "m/s^2", "gravity")
    x0: float = parameter(1.0, "m", "place of release, at rest")

    # Blocks are pure functions in jax.numpy. State only those that the scene has; there are also
    # state_rate, output and actuation for controllers, and exact for a closed form.
    def mass(self, q):
        return self.m * jnp.eye(2)

    def force(self, q, v, t):
        return jnp.stack([0.0 * self.m, -self.m * self.g])

    def constraint(self, q, t):
        return jnp.stack([q[1] - self.c * q[0] ** 2])

    def initial_state(self):
        return State(q=np.array([self.x0, self.c * self.x0**2]), v=np.zeros(2))

    def energy(self, q, v):  # only where it is conserved
        return 0.5 * self.m * (v @ v) + self.m * self.g * q[1]

    def draw(self, q):  # lines, each of shape (points, 2)
        x = np.linspace(-1.2, 1.2, 49) * abs(self.x0)
        ring = 0.05 * np.exp(1j * np.linspace(0, 2 * np.pi, 17))
        return [np.column_stack([x, self.c * x**2]), np.column_stack([ring.real, ring.imag]) + q]
