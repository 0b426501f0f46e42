"""Masses on springs: linear, nonlinear, driven, with dry friction, and controlled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems import (
    MechatronicSystem,
    Published,
    SampledSystem,
    State,
    Variables,
    held,
    jax,
    jnp,
    parameter,
)
from problems.mechanics import drawing
from problems.mechanics.points import PointMasses


class _MassOnSpring(PointMasses):
    """Start and picture of a mass on a spring; wall and half of the mass are for the picture, m."""

    coordinates = ("position [m]",)
    q0, v0 = 0.0, 0.0
    _wall, _half = -3.0, 0.25

    def initial_state(self) -> State:
        return State(np.array([self.q0]), np.array([self.v0]), np.zeros(len(self.states)))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        wall, half = self._wall, self._half
        line = np.array([[wall, -1.7 * half], [wall, 1.7 * half]])
        return [line, drawing.spring(wall, q[0] - half, 0.65 * half), drawing.box(q[0], half)]


@dataclass(frozen=True)
class Oscillator(_MassOnSpring):
    """One mass on one spring.

    Tests amplitude and phase over many periods, in which a method's damping and phase error add
    up, and the stability limit in omega h. Left out: damping, which would hide the method's own.
    """

    interval = (0.0, 20.0)
    nominal_step = 0.1
    tags = ("linear", "smooth", "closed form", "conservative")
    difficulties = ("errors of amplitude and phase add up over many periods",)
    source = "q = q0 cos(omega t); e.g. Hughes (1987), The Finite Element Method, ch. 9"

    omega: float = parameter(1.0, "rad/s", "frequency", low=1e-12)
    q0: float = parameter(1.0, "m", "initial position")

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return -(self.omega**2) * q

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return 0.5 * (v @ v + self.omega**2 * (q @ q))

    def exact(self, t: np.ndarray) -> dict[str, np.ndarray]:
        phase = self.omega * np.asarray(t, dtype=float)[:, None]
        q = self.q0 * np.cos(phase)
        return {"q": q, "v": -self.q0 * self.omega * np.sin(phase), "a": -(self.omega**2) * q}


@dataclass(frozen=True)
class Duffing(_MassOnSpring):
    """One mass on a hardening spring, damped and driven: m a + c v + k q + k3 q^3 = F cos(w t).

    Tests the order of the acceleration on the simplest scene with damping, nonlinearity and
    explicit time: no symmetry or conservation cancels an error, and a method that reports its
    auxiliary acceleration shows first order. Left out: constraints and a controller, which have
    scenes of their own; a long interval, on which the driven oscillator can become chaotic, so
    that errors would no longer show the order.
    """

    interval = (0.0, 3.0)
    nominal_step = 0.05
    tags = ("smooth", "nonlinear", "driven", "damped")
    difficulties = ("the classical forms of generalized-alpha report a first-order acceleration",)
    source = "Duffing (1918), Erzwungene Schwingungen bei veraenderlicher Eigenfrequenz"
    _wall, _half = -3.0, 0.3

    m: float = parameter(1.0, "kg", "mass", low=1e-12)
    c: float = parameter(0.3, "N s/m", "damping")
    k: float = parameter(1.0, "N/m", "linear stiffness")
    k3: float = parameter(0.5, "N/m^3", "cubic stiffness")
    amplitude: float = parameter(1.0, "N", "amplitude of the driving force")
    w: float = parameter(2.0, "rad/s", "angular frequency of the driving force")
    q0: float = parameter(1.0, "m", "initial position")
    v0: float = parameter(0.5, "m/s", "initial velocity")

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return self.amplitude * jnp.cos(self.w * t) - self.c * v - self.k * q - self.k3 * q**3


@dataclass(frozen=True)
class DrivenSprings(MechatronicSystem):
    """A point that is moved as sin(omega t) pulls a mass by a nearly rigid spring, and this mass a
    second one by a soft spring.

    Tests methods on a frequency that their steps cannot resolve: the stiff spring stands for a
    rigid connection. In the exact solution the vibration dies out within milliseconds, because of
    a weak damper that the published model does not have; undamped methods have accelerations off
    by many times their size, while positions look right. Left out: the massless driven point.
    """

    interval = (0.0, 10.0)
    nominal_step = 0.25
    tags = ("linear", "stiff", "closed form", "driven")
    difficulties = (
        "BDF above order 2 and corrected starts need short steps for stiff springs",
        "the stiff vibration has 3162 rad/s and is damped by 5 %; the motion has 1.2 rad/s",
        "the start excites the stiff spring: undamped methods keep a spurious acceleration",
    )
    # The start makes an acceleration of thousands of m/s^2 for milliseconds; errors are relative to
    # the motion of the driven point instead.
    coordinates = ("first mass [m] ~ 1, 1.2, 1.44", "second mass [m]")
    source = (
        "Bathe & Noh (2012), Insight into an implicit time integration scheme for structural "
        "dynamics, doi:10.1016/j.compstruc.2012.01.009, with a weak damper added"
    )

    m1: float = parameter(1.0, "kg", "mass at the stiff spring", low=1e-12)
    m2: float = parameter(1.0, "kg", "mass at the soft spring", low=1e-12)
    k1: float = parameter(1e7, "N/m", "stiff spring", low=0.0)
    k2: float = parameter(1.0, "N/m", "soft spring", low=0.0)
    c1: float = parameter(300.0, "N s/m", "damper beside the stiff spring", low=0.0)
    omega: float = parameter(1.2, "rad/s", "frequency of the driven point", low=1e-9)

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.diag(jnp.stack([self.m1, self.m2]))

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        u, u_dot = jnp.sin(self.omega * t), self.omega * jnp.cos(self.omega * t)
        stiff = self.k1 * (u - q[0]) + self.c1 * (u_dot - v[0])
        soft = self.k2 * (q[0] - q[1])
        return jnp.stack([stiff - soft, soft])

    def initial_state(self) -> State:
        return State(q=np.zeros(2), v=np.zeros(2))

    def exact(self, t: np.ndarray) -> dict[str, np.ndarray]:
        """s = Re(p exp(i omega t)) + sum of c_k w_k exp(r_k t), with the eigenpairs (r, w) of the
        first-order form s' = A s + Re(b exp(i omega t)), s = [q, v]."""
        t = np.asarray(t, dtype=float)
        stiffness = np.array([[self.k1 + self.k2, -self.k2], [-self.k2, self.k2]])
        masses = np.array([[self.m1], [self.m2]])
        a = np.zeros((4, 4))
        a[:2, 2:] = np.eye(2)
        a[2:, :2], a[2, 2] = -stiffness / masses, -self.c1 / self.m1
        # sin = Re(-i exp), cos = Re(exp)
        b = np.array([0, 0, (-1j * self.k1 + self.c1 * self.omega) / self.m1, 0])
        p = np.linalg.solve(1j * self.omega * np.eye(4) - a, b)
        roots, vectors = np.linalg.eig(a)
        weights = vectors * np.linalg.solve(vectors, -p.real.astype(complex))
        homogeneous, driven = np.exp(np.outer(t, roots)), np.exp(1j * self.omega * t)[:, None]
        s = (driven * p).real + (homogeneous @ weights.T).real
        rate = (driven * (1j * self.omega * p)).real + (homogeneous @ (weights * roots).T).real
        return {"q": s[:, :2], "v": s[:, 2:], "a": rate[:, 2:]}

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        half, first, second = 0.3, float(q[0]) + 1.5, float(q[1]) + 4.0
        return [
            np.array([[first - 1.5, 0.0], [first - half, 0.0]]),
            drawing.box(first, half),
            drawing.spring(first + half, second - half, reach=0.2, points=14),
            drawing.box(second, half),
        ]


@dataclass(frozen=True)
class Friction(_MassOnSpring):
    """An oscillator that slides on a rough plane; friction changes its sign within ``eps``.

    Tests the order and step-size control under a force that jumps. Steps much shorter than
    eps/(acceleration) resolve the jump. The mass never comes to rest in the interval. Left out:
    sticking, which is another problem (complementarity), and a larger friction at rest.
    """

    interval = (0.0, 10.0)
    nominal_step = 0.05
    tags = ("smooth", "nearly discontinuous", "dissipative")
    difficulties = (
        "the force jumps at every turn: with equal steps longer than the jump the order is 1",
    )
    source = "Coulomb friction with a smoothed sign; the amplitude falls by 2 mu/k at every turn"
    _wall, _half = -14.0, 0.8

    m: float = parameter(1.0, "kg", "mass", low=1e-12)
    k: float = parameter(1.0, "N/m", "stiffness of the spring", low=0.0)
    mu: float = parameter(1.0, "N", "friction force", low=0.0)
    eps: float = parameter(0.1, "m/s", "velocity over which friction changes sign", low=1e-12)
    q0: float = parameter(10.0, "m", "initial position")

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return -self.k * q - self.mu * jnp.tanh(v / self.eps)

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        floor = np.array([[self._wall, -self._half], [-self._wall, -self._half]])
        return [floor, *super().draw(q)]


@dataclass(frozen=True)
class SpringMass(_MassOnSpring):
    """Active damping of one mass by acceleration feedback through a saturated actuator.

    Tests the whole mechatronic loop in its smallest form: the measured acceleration drives a
    filter, the filter demands a force, the actuator saturates, and its force acts back on the
    acceleration within the same step. The outputs y = [demanded force, actuator force] are not
    eliminated: their coupling within the step is tested. Left out: actuator dynamics and sensor
    delay, which would only add linear states.
    """

    interval = (0.0, 20.0)
    nominal_step = 0.1
    tags = ("mechatronic", "smooth", "nonlinear output", "conformance")
    difficulties = (
        "the acceleration is fed back in the step: a first-order one spoils everything",
    )
    states = ("controller [N]",)
    outputs = ("demanded force [N]", "limited force [N]")
    source = "Bruels & Arnold (2008), section 6, Figs 3-6"
    _wall, _half = -8.0, 0.6

    m: float = parameter(1.0, "kg", "mass", low=1e-12)
    k: float = parameter(1.0, "N/m", "spring stiffness")
    sigma: float = parameter(0.1, "1/s", "leak of the controller's integrator")
    b: float = parameter(1.4, "N s/m", "feedback gain on the acceleration")
    g_max: float = parameter(1.0, "N", "saturation of the actuator", low=1e-12)
    q0: float = parameter(5.0, "m", "initial position")

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return -self.k * q

    def state_rate(self, z: Variables) -> jax.Array:
        return -self.sigma * z.x - self.b * z.a

    def output(self, z: Variables) -> jax.Array:
        return jnp.stack([z.x[0], self.g_max * jnp.tanh(z.y[0] / self.g_max)])

    def actuation(self) -> np.ndarray:
        return np.array([[0.0, 1.0]])


@dataclass(frozen=True)
class SampledPd(SampledSystem, _MassOnSpring):
    """A spring-mass system whose controller sees it at samples alone and holds its force between.

    The smallest loop of a digital controller: q'' + q = u with u = -2 q - q' at the last sample.
    Tests whether a method hits the samples: one that steps over them gives the motion of the
    continuous controller, which looks as smooth, and is another one. With a delay the force of a
    sample acts from the next one on. The loop without a delay loses stability at a sample time of
    2 arctan(1/2) = 0.927 s. Left out: noise and quantisation.
    """

    interval = (0.0, 5.0)
    nominal_step = 0.1
    tags = ("mechatronic", "linear", "sampled", "conformance")
    difficulties = ("the force jumps at each sample: a step across it is of first order",)
    outputs = ("force [N]",)
    source = "digits of t = 5 s by matrix exponentials"
    published = (
        Published("q", 5.0, (-0.0412160715525846,), 1e-14),
        Published("v", 5.0, (-0.133917365855531,), 1e-14),
    )
    q0, _wall, _half = 1.0, -2.0, 0.2

    kp: float = parameter(2.0, "N/m", "proportional gain")
    kd: float = parameter(1.0, "N s/m", "derivative gain")
    delay: int = parameter(0, "1", "delay in samples: 0 or 1", low=0, high=1)
    demand: float = held(0.0, "N", "force demanded at the last sample")
    u: float = held(0.0, "N", "force of the actuator")

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return -q

    def output(self, z: Variables) -> jax.Array:
        return jnp.stack([self.u])

    def actuation(self) -> np.ndarray:
        return np.eye(1)

    def sample(self, z: Variables) -> dict[str, jax.Array | float]:
        demand = -self.kp * z.q[0] - self.kd * z.v[0]
        return {"demand": demand, "u": demand if self.delay == 0 else self.demand}
