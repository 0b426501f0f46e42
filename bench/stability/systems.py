"""Linear test systems; time is measured in their own unit, so that a step is omega h.

All of them rest at zero, where a step maps a deviation linearly to the next one.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np

from problems import State, Variables, jnp, parameter
from problems.base.runtime import Float
from problems.mechanics.points import PointMasses
from problems.variables import Layout, Sizes, state_layout


@dataclass(frozen=True, kw_only=True)
class LinearSystem(PointMasses):
    """Base of the test systems, unit masses on unit springs if a system states no others.

    ``excited`` are the places in [q, v, x] of unit deviations.
    """

    offered = ("from_deviation", "deviations")
    #: All entries if None; entries that they never reach take no part in the spectrum.
    excited: ClassVar[tuple[int, ...] | None] = None
    size: ClassVar[tuple[int, int]] = (1, 0)
    deviation: np.ndarray | None = field(default=None, compare=False)

    @property
    def layout(self) -> Layout:
        """Places of q, v and x in a deviation."""
        nq, nx = self.size
        return state_layout(Sizes(nq, nq, 0, nx, 0, 0))

    def from_deviation(self, s: np.ndarray) -> Self:
        """Return the same system, started from s = [q, v, x] instead of rest."""
        return self.with_parameters({"deviation": np.asarray(s, dtype=float)})

    def deviations(self) -> Float[np.ndarray, "k n"]:
        """Return unit deviations of the excited entries of [q, v, x], as rows."""
        units = np.eye(self.layout.size)
        return units if self.excited is None else units[list(self.excited)]

    def force(self, q: Any, v: Any, t: Any) -> Any:
        return -q

    def initial_state(self) -> State:
        s = np.zeros(self.layout.size) if self.deviation is None else self.deviation
        return State(*self.layout.split(s))


@dataclass(frozen=True)
class Oscillator(LinearSystem):
    """q'' + 2 zeta q' + q = 0: the test equation of structural dynamics with omega = 1."""

    zeta: float = parameter(0.0, "1", "damping ratio", low=0.0)

    def force(self, q: Any, v: Any, t: Any) -> Any:
        return -q - 2 * self.zeta * v

    def energy(self, q: Any, v: Any) -> Any:
        return (q @ q + v @ v) / 2  # conserved without damping


@dataclass(frozen=True)
class Relaxation(LinearSystem):
    """x' = -x: the test equation of the controller; a mass beside it stays at rest."""

    excited: ClassVar[tuple[int, ...] | None] = (2,)
    size: ClassVar[tuple[int, int]] = (1, 1)

    def state_rate(self, z: Variables) -> Any:
        return -z.x


@dataclass(frozen=True)
class Loop(LinearSystem):
    """A mass on a spring whose acceleration is fed back: q'' + q = y, x' = -sigma x - b q'', y = x.

    The linear part of the controlled spring-mass system of Bruels & Arnold (2008), section 6.
    """

    size: ClassVar[tuple[int, int]] = (1, 1)
    sigma: float = parameter(0.1, "1", "leak of the controller's integrator")
    b: float = parameter(1.4, "1", "feedback gain on the acceleration")

    def state_rate(self, z: Variables) -> Any:
        return -self.sigma * z.x - self.b * z.a

    def output(self, z: Variables) -> Any:
        return z.x

    def actuation(self) -> Any:
        return np.eye(1)


@dataclass(frozen=True)
class Coupled(LinearSystem):
    """Two masses on soft springs, and a stiff one between them: frequencies 1 and about 100."""

    size: ClassVar[tuple[int, int]] = (2, 0)
    stiffness: float = parameter(1e4, "1", "of the spring between the masses", low=0.0)

    def mass(self, q: Any) -> Any:
        return jnp.eye(2) / 2

    def force(self, q: Any, v: Any, t: Any) -> Any:
        between = self.stiffness / 4 * (q[1] - q[0])
        return jnp.stack([between - q[0] / 2, -between - q[1] / 2])


@dataclass(frozen=True)
class Joined(LinearSystem):
    """Two masses on springs that a constraint makes one: the oscillator, and infinite frequency."""

    size: ClassVar[tuple[int, int]] = (2, 0)

    def mass(self, q: Any) -> Any:
        return jnp.diag(jnp.array([0.25, 0.75]))

    def force(self, q: Any, v: Any, t: Any) -> Any:
        return -q * jnp.array([0.6, 0.4])

    def constraint(self, q: Any, t: Any) -> Any:
        return q[:1] - q[1:]
