"""The car axis of the IVP test set: index 3 on stiff springs over a moving road."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, State, jax, jnp, parameter
from problems.base.spec import SpecError


@dataclass(frozen=True)
class CarAxis(MechatronicSystem):
    """An axle between two stiff springs, one of which stands on a bumpy road.

    The left wheel rests on the ground, the right one moves up and down and stays at the distance
    L; two point masses are the ends of the axle. One constraint keeps the axle's length, the
    other the left spring perpendicular to the line between the wheels. Tests a published
    benchmark: two constraints, one of them rheonomic, and forces that are large against the
    masses M eps^2/2. Left out: the body's own inertia and damping, as in the source. Energy is
    not conserved, because the road does work.
    """

    interval = (0.0, 3.0)
    nominal_step = 0.005
    tags = ("constrained", "index 3", "rheonomic", "stiff", "benchmark")
    difficulties = (
        "stiff springs against light masses: explicit methods are held to short steps",
        "the right wheel's motion makes a constraint depend on time: velocities need Phi_t, too",
    )
    coordinates = ("left x [m]", "left y [m]", "right x [m]", "right y [m]")
    multipliers = ("wheel [N/m]", "axle [N/m]")
    source = "Mazzia & Magherini, Test Set for IVP Solvers, problem caraxis; Schneider (1995)"

    eps: float = parameter(0.01, "-", "stiffness parameter: the springs are 1/eps^2", low=1e-9)
    m: float = parameter(10.0, "kg", "mass of the body (M)", low=1e-12)
    length: float = parameter(1.0, "m", "length of the axle and distance of the wheels", low=1e-9)
    spring: float = parameter(0.5, "m", "length of the springs at rest (L0)", low=1e-9)
    r: float = parameter(0.1, "m", "amplitude of the road")
    w: float = parameter(10.0, "rad/s", "angular frequency of the road")
    g: float = parameter(1.0, "m/s^2", "gravity")

    def __post_init__(self) -> None:
        if not abs(self.r) < self.length:
            raise SpecError(
                f"The road's amplitude r={self.r:g} m must be below the length={self.length:g} m, "
                f"which the moving wheel keeps from the other one."
            )

    def _wheel(self, t: jax.Array) -> jax.Array:
        y = self.r * jnp.sin(self.w * t)
        return jnp.stack([jnp.sqrt(self.length**2 - y**2), y])

    def mass(self, q: jax.Array) -> jax.Array:
        return 0.5 * self.m * self.eps**2 * jnp.eye(4)

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        # The source multiplies its equations by eps^2: springs have the stiffness 1.
        def spring(s: jax.Array) -> jax.Array:
            now = jnp.sqrt(s @ s)
            return (self.spring - now) / now * s

        weight = 0.5 * self.m * self.eps**2 * self.g * jnp.array([0.0, 1.0])
        left, right = q[:2], q[2:]
        return jnp.concatenate([spring(left) - weight, spring(right - self._wheel(t)) - weight])

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        # Signs that give the source's multipliers.
        left, axle = q[:2], q[:2] - q[2:]
        return jnp.stack([-(self._wheel(t) @ left), self.length**2 - axle @ axle])

    def initial_state(self) -> State:
        v = -self.r * self.w * self.spring / self.length
        q = [0.0, self.spring, self.length, self.spring]
        return State(q=np.array(q), v=np.array([v, 0.0, v, 0.0]))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        # q holds no time, but the moving wheel is where the left spring is perpendicular to it.
        left, right = np.asarray(q[:2]), np.asarray(q[2:])
        wheel = self.length * np.array([left[1], -left[0]]) / np.linalg.norm(left)
        return [
            np.array([left, right]),
            np.array([[0.0, 0.0], left]),
            np.array([wheel, right]),
            np.array([[0.0, 0.0], wheel]),
        ]
