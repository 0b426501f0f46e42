"""A scene that breaks on demand, and the error of a run, for the tests of adaptive methods."""

import numpy as np
from helpers import reference, toy

from problems import State, jnp, parameter


def _force(self, q, v, t):
    return jnp.where(t > self.breaks_at, jnp.nan, -self.k * q + self.c * q**2)


#: q'' = -k q + c q^2 until the force ceases to exist: linear, or with a pole at t = 1.
Probe = toy(
    "Probe", interval=(0.0, 2.0), force=_force,
    initial_state=lambda self: State(np.ones(1), np.array([self.v0])),
    k=parameter(4.0, "1/s^2", "stiffness per mass"),
    c=parameter(0.0, "1/(m s^2)", "growth"),
    v0=parameter(0.0, "m/s", "initial velocity"),
    breaks_at=parameter(1e9, "s", "time after which the force is NaN"),
)  # fmt: skip


def worst(trajectory, scene, group):
    """Largest error over the rows, relative to the largest value."""
    exact = reference(scene, float(trajectory.t[-1]))(trajectory.t)[group]
    return np.abs(getattr(trajectory, group) - exact).max() / np.abs(exact).max()
