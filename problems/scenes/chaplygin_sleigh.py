"""Chaplygin's sleigh: a blade that does not slide sideways, known in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import MechatronicSystem, State, jax, jnp, parameter

#: Nodes of Gauss' formula on each panel, and the longest panel in units of the sleigh's time.
_NODES, _PANEL = 20, 0.5


@dataclass(frozen=True)
class ChaplyginSleigh(MechatronicSystem):
    """A rigid body on a plane, on a blade at distance ``arm`` behind its centre of mass.

    Tests a nonholonomic constraint in its simplest setting, with coordinates of the plane and
    velocities of the body: u along the blade, s across it at the centre of mass, and the turn rate
    w. The start is backwards, which is unstable: the sleigh swings round and runs straight on. No
    friction, and yet the motion has a limit, as nonholonomic systems keep no volume of states.
    Left out: friction, and a rotor, by which such a sleigh would be steered.

    With k^2 = (J + m arm^2)/m the motion keeps u^2 + k^2 w^2 = c^2 and is
    u = c tanh(T), w = c/k sech(T), T = arm c/k^2 (t - t*); the heading follows by
    the Gudermannian of T. The place of the blade is the integral of a smooth function, by Gauss'
    formula to rounding.
    """

    interval = (0.0, 6.0)
    nominal_step = 0.05
    tags = ("constrained", "nonholonomic", "closed form", "conservative", "smooth")
    difficulties = (
        "a constraint of velocities: methods that need it as one of positions cannot take it",
        "velocities of the body: dq/dt = T(q) v",
    )
    coordinates = ("centre x [m]", "centre y [m]", "heading [rad]")
    velocities = ("along [m/s]", "across [m/s]", "turn [rad/s]")
    multipliers = ("blade [N]",)
    source = "Neimark & Fufaev (1972), Dynamics of Nonholonomic Systems; Bloch (2003), section 1.7"

    m: float = parameter(1.0, "kg", "mass", low=1e-12)
    j: float = parameter(0.3, "kg m^2", "inertia about the centre of mass", low=0.0)
    arm: float = parameter(0.5, "m", "distance of the blade behind the centre", low=1e-9)
    u0: float = parameter(-1.0, "m/s", "initial velocity along the blade, forwards")
    w0: float = parameter(0.3, "rad/s", "initial turn rate", low=1e-9)

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.diag(jnp.stack([self.m, self.m, self.j]))

    def kinematics(self, q: jax.Array, v: jax.Array) -> jax.Array:
        c, s = jnp.cos(q[2]), jnp.sin(q[2])
        return jnp.stack([c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]])

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return self.m * v[2] * jnp.stack([v[1], -v[0], 0.0])

    def velocity_constraint(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return (v[1] - self.arm * v[2])[None]

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return 0.5 * v @ self.mass(q) @ v

    def initial_state(self) -> State:
        return State(
            q=np.array([self.arm, 0.0, 0.0]), v=np.array([self.u0, self.arm * self.w0, self.w0])
        )

    def exact(self, t: np.ndarray) -> dict[str, np.ndarray]:
        k2 = self.j / self.m + self.arm**2
        k, start = np.sqrt(k2), np.arcsinh(self.u0 / (np.sqrt(k2) * self.w0))
        c = np.hypot(self.u0, k * self.w0)
        rate = self.arm * c / k2  # of T by t
        since = rate * (np.asarray(t, dtype=float) - self.interval[0])

        def heading(since: np.ndarray) -> np.ndarray:
            return k / self.arm * (np.arctan(np.sinh(start + since)) - np.arctan(np.sinh(start)))

        # The blade moves by tanh(T) (cos, sin)(heading) dT k^2/arm.
        x, weights = np.polynomial.legendre.leggauss(_NODES)
        panels = max(1, int(np.ceil(np.abs(since).max() / _PANEL)))
        parts = (np.arange(panels)[:, None] + (x + 1) / 2).ravel() / panels
        at = since[:, None] * parts
        speed = np.tanh(start + at) * np.exp(1j * heading(at))
        path = k2 / self.arm * since * (speed @ np.tile(weights, panels)) / (2 * panels)
        th = heading(since)
        place = path + self.arm * np.exp(1j * th)
        u, w = c * np.tanh(start + since), c / k / np.cosh(start + since)
        turning = -self.arm / k2 * u * w
        return {
            "q": np.column_stack([place.real, place.imag, th]),
            "v": np.column_stack([u, self.arm * w, w]),
            "a": np.column_stack([self.arm * w**2, self.arm * turning, turning]),
            "lam": (-self.j / k2 * u * w)[:, None],
        }

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        c, s = np.cos(q[2]), np.sin(q[2])
        body = np.array([[1.0, 0.0], [-0.6, 0.6], [-0.6, -0.6], [1.0, 0.0]])
        blade = np.array([[-1.3, 0.0], [-0.7, 0.0]])
        turned = np.array([[c, s], [-s, c]])
        return [q[:2] + self.arm * line @ turned for line in (body, blade)]
