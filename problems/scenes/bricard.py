"""A04 of the IFToMM benchmark library: Bricard's mechanism, one of its constraints redundant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import Published, State, jax, jnp, parameter
from problems.mechanics.lagrange import OfEnergies

#: Axes of the joints P0 to P4: y, z, x, y, z of the frame of the rod that begins there.
_AXES = np.eye(3)[[1, 2, 0, 1, 2]]
#: Rods from joint to joint in lengths, in their own frames and, at the start, in space.
_RODS = np.array([[1, 0, 0], [0, -1, 0], [0, 0, 1], [-1, 0, 0], [0, 1, 0]], dtype=float)
#: A turn by q about an axis n is n n^T + cos(q) (1 - n n^T) + sin(q) times the last matrix, with
#: the turned axes as rows.
_IDLE = np.einsum("ki,kj->kij", _AXES, _AXES)
_ALONG = np.eye(3) - _IDLE
_ACROSS = np.cross(_AXES[:, None], np.eye(3))


@dataclass(frozen=True)
class Bricard(OfEnergies):
    """Five rods in a closed loop of six hinges, which moves although it should be rigid.

    The benchmark A04 of the library. The hinges of six bodies, the ground among them, leave no
    freedom by count, yet the axes are such that the loop has one. Five joint angles of the chain
    that is cut at the last hinge are the coordinates; P5 has to stay in place and the last rod's x
    axis, which is that of the last hinge, in its direction. Of these five constraints one depends
    on the others at every position, so that multipliers are not unique: the least ones are taken.
    Left out: friction.
    """

    interval = (0.0, 10.0)
    nominal_step = 0.02
    tags = ("constrained", "index 3", "conservative", "spatial", "benchmark")
    redundant = 1
    difficulties = (
        "four of the five constraints are independent: methods whose steps solve for unique "
        "multipliers refuse the scene; ali3p and methods on the explicit ODE take it",
    )
    coordinates = tuple(f"joint P{k} [rad]" for k in range(5))
    multipliers = ("P5 x [N]", "P5 y [N]", "P5 z [N]", "axis y [N m]", "axis z [N m]")
    energy = OfEnergies._total
    source = (
        "IFToMM benchmark library, A04; Gonzalez et al. (2006), doi:10.1007/s11044-006-9013-y; "
        "digits by a null-space method with DOP853, two settings of which agree"
    )
    published = (
        Published("P3", 1.0, (0.510501461187, -1.649167599395, 0.140123114553), 1e-10),
        Published("P3", 2.0, (-0.969340344778, -1.221246894956, 0.754278010780), 1e-10),
    )

    m: float = parameter(1.0, "kg", "mass of each rod", low=1e-12)
    length: float = parameter(1.0, "m", "length of each rod", low=1e-12)
    side: float = parameter(0.1, "m", "side of the rods' square section", low=1e-6)
    g: float = parameter(9.81, "m/s^2", "gravity, along -y")

    def _rods(self, q: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Frames of the rods, whose rows are their axes, and the rods as vectors in m."""
        turns = _IDLE + jnp.cos(q)[:, None, None] * _ALONG + jnp.sin(q)[:, None, None] * _ACROSS
        frames = [turns[0]]
        for turn in turns[1:]:
            frames.append(turn @ frames[-1])
        found = jnp.stack(frames)
        return found, self.length * jnp.einsum("ki,kij->kj", _RODS, found)

    def _joints(self, q: jax.Array) -> jax.Array:
        """P0 to P5 in m, a row each."""
        return jnp.concatenate([jnp.zeros((1, 3)), jnp.cumsum(self._rods(q)[1], axis=0)])

    def _kinetic_energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        frames, rods = self._rods(q)
        turning = jnp.cumsum(v[:, None] * jnp.einsum("ki,kij->kj", _AXES, frames), axis=0)
        ends = jnp.cross(turning, rods)
        centres = jnp.cumsum(ends, axis=0) - ends / 2
        across = self.m * (self.length**2 + self.side**2) / 12
        along = self.m * self.side**2 / 6 - across
        spins = jnp.sum(turning * rods, axis=1) / self.length
        squares = self.m * jnp.sum(centres**2) + across * jnp.sum(turning**2)
        return (squares + along * jnp.sum(spins**2)) / 2

    def _potential_energy(self, q: jax.Array) -> jax.Array:
        joints = self._joints(q)
        return self.m * self.g * jnp.sum(joints[:-1] + joints[1:], axis=0)[1] / 2

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        frames, rods = self._rods(q)
        gap = jnp.sum(rods, axis=0) - self.length * jnp.array([0.0, 0.0, 1.0])
        return jnp.concatenate([gap, frames[-1, 0, 1:]])

    def points(self, q: jax.Array) -> dict[str, jax.Array]:
        return {"P3": self._joints(q)[3]}

    def initial_state(self) -> State:
        return State(q=np.zeros(5), v=np.zeros(5))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        # Oblique view: x to the right, y up, z towards the lower left.
        view = np.array([[1.0, 0.0, -0.4], [0.0, 1.0, -0.4]])
        return [np.asarray(self._joints(jnp.asarray(q))) @ view.T]
