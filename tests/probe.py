"""A scene that breaks on demand, and the error of a run, for the tests of adaptive methods."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from helpers import reference

from integrators import Trajectory
from problems import MechatronicSystem, State, jnp, parameter


@dataclass(frozen=True)
class Probe(MechatronicSystem):
    """q'' = -k q + c q^2 until the force ceases to exist: linear, or with a pole at t = 1."""

    interval = (0.0, 2.0)

    k: float = parameter(4.0, "1/s^2", "stiffness per mass")
    c: float = parameter(0.0, "1/(m s^2)", "growth")
    v0: float = parameter(0.0, "m/s", "initial velocity")
    breaks_at: float = parameter(1e9, "s", "time after which the force is NaN")

    def mass(self, q):
        return jnp.eye(1)

    def force(self, q, v, t):
        return jnp.where(t > self.breaks_at, jnp.nan, -self.k * q + self.c * q**2)

    def initial_state(self):
        return State(q=np.ones(1), v=np.array([self.v0]))


def worst(trajectory: Trajectory, scene: MechatronicSystem, group: str) -> float:
    """Largest error over the rows, relative to the largest value."""
    exact = reference(scene, float(trajectory.t[-1]))(trajectory.t)[group]
    return np.abs(getattr(trajectory, group) - exact).max() / np.abs(exact).max()
