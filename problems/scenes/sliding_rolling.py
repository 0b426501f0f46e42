"""A ball that slides until it rolls: friction in lasting contact, and its exact motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, Published, State, Variables, held, jax, jnp, parameter
from problems.mechanics import drawing


@dataclass(frozen=True)
class SlidingRolling(MechatronicSystem):
    """A ball is set on the ground with a speed and no spin: it slides, then rolls.

    It rolls from t = k v0/((1 + k) mu g) on at the speed v0/(1 + k), with the moment of inertia
    k m r^2: 2 v0/(7 mu g) and 5 v0/7 for a sphere, v0/(3 mu g) and 2 v0/3 for a disc (k = 1/2).
    Tests an event without an impact, at which a force jumps, and contact that lasts: the ground's
    forces set in at the start by an event of the scene, and are in ``force`` where a held value
    says so. Time stepping methods (`moreau_jean`) find them by ``gaps`` and ``sliding``. Left out:
    rolling friction, and friction that depends on the speed.
    """

    interval = (0.0, 1.0)
    nominal_step = 0.05
    tags = ("events", "friction")
    difficulties = ("friction vanishes at a time that the motion decides",)
    coordinates = ("way [m]", "height [m]", "angle [rad]")
    source = "closed form, as in textbooks of mechanics"
    published = (
        Published("v", 1.0, (10 / 7, 0.0, 10 / 7 / 0.1), 1e-12),
        Published("q", 1.0, (1.51178514219143315, 0.1, 12.2053714452141713), 1e-12),
    )

    m: float = parameter(1.0, "kg", "mass", low=1e-9)
    r: float = parameter(0.1, "m", "radius", low=1e-9)
    k: float = parameter(0.4, "1", "moment of inertia by m r^2", low=1e-9)
    friction: float = parameter(0.2, "1", "Coulomb's coefficient", low=0.0)
    g: float = parameter(9.81, "m/s^2", "gravity", low=1e-9)
    v0: float = parameter(2.0, "m/s", "speed at the start", low=1e-9)
    contact: float = held(0.0, "1", "0: free, 1: sliding, 2: rolling")

    def mass(self, q: jax.Array) -> jax.Array:
        return self.m * jnp.diag(jnp.stack([1.0, 1.0, self.k * self.r**2]))

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        weight = self.m * self.g
        touches, slides = self.contact > 0, self.contact == 1
        rub = jnp.where(slides, self.friction * weight, 0.0)
        return jnp.stack([-rub, jnp.where(touches, 0.0, -weight), rub * self.r])

    def gaps(self, q: jax.Array, t: jax.Array) -> jax.Array:
        return q[1:2] - self.r

    def sliding(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return v[:1] - self.r * v[2:]

    def events(self, z: Variables) -> jax.Array:
        falls = jnp.where(self.contact == 0, self.gaps(z.q, z.t)[0], 1.0)
        slides = jnp.where(self.contact == 1, self.sliding(z.q, z.v, z.t)[0], 1.0)
        return jnp.stack([falls, slides])

    def jump(self, z: Variables, event: int) -> dict[str, float]:
        return {"contact": 1.0 + event}

    def initial_state(self) -> State:
        return State(q=np.array([0.0, self.r, 0.0]), v=np.array([self.v0, 0.0, 0.0]))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        x, y, angle = q
        rim = self.r * np.array([np.sin(angle), np.cos(angle)])
        ground = np.array([[-0.2, 0.0], [1.8, 0.0]])
        centre = np.array([x, y])
        return [ground, drawing.circle(centre, self.r), np.array([centre, centre + rim])]
