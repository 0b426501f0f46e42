"""Planar slider cranks of rigid bodies: moving freely (in two forms), and driven."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np

from problems import MechatronicSystem, State, Variables, jax, jnp, parameter
from problems.base.spec import SpecError
from problems.mechanics import drawing
from problems.mechanics.lagrange import OfEnergies


def _polylines(l1: float, tip: np.ndarray, slider: float) -> list[np.ndarray]:
    """Guide, crank and rod, slider; all in m."""
    half, reach = 0.2 * l1, 1.4 * l1
    guide = np.array([[slider - reach, -half], [slider + reach, -half]])
    return [guide, np.array([[0.0, 0.0], tip, [slider, 0.0]]), drawing.box(slider, half)]


def _check_reach(l1: float, l2: float, angle: float) -> None:
    if not l2 > l1 * abs(np.sin(angle)):
        raise SpecError(
            f"The rod (l2={l2:g} m) does not reach the guide from a crank of l1={l1:g} m at the "
            f"angle of {angle:g} rad; give l2 > l1 |sin(angle)|, and l2 > l1 for full turns."
        )


@dataclass(frozen=True)
class _FreeCrank(MechatronicSystem):
    interval = (0.0, 5.0)
    nominal_step = 0.005

    l1: float = parameter(0.15, "m", "length of the crank", low=1e-9)
    l2: float = parameter(0.3, "m", "length of the rod", low=1e-9)
    m1: float = parameter(0.36, "kg", "mass of the crank, a uniform bar", low=1e-12)
    m2: float = parameter(0.15, "kg", "mass of the rod, a uniform bar", low=1e-12)
    m3: float = parameter(0.075, "kg", "mass of the slider", low=0.0)
    g: float = parameter(9.81, "m/s^2", "gravity, along -y")
    th0: float = parameter(0.7, "rad", "initial angle of the crank from the guide")
    w0: float = parameter(10.0, "rad/s", "initial angular velocity of the crank")

    def __post_init__(self) -> None:
        _check_reach(self.l1, self.l2, self.th0)

    def _inertias(self) -> jax.Array:
        """The diagonal mass matrix of the bodies in absolute coordinates, shape ``(7,)``."""
        m1, m2, m3 = self.m1, self.m2, self.m3
        return jnp.stack([m1, m1, m1 * self.l1**2 / 12, m2, m2, m2 * self.l2**2 / 12, m3])

    def _assembled(self, th: jax.Array | float, xp: ModuleType = np) -> jax.Array | np.ndarray:
        """Absolute coordinates ``(7,)`` at the crank angle th, with the slider beyond the crank.

        The module ``xp`` is numpy, or jax.numpy for traced angles.
        """
        ph = -xp.arcsin(self.l1 / self.l2 * xp.sin(th))
        x, y = self.l1 * xp.cos(th), self.l1 * xp.sin(th)
        u, w = self.l2 * xp.cos(ph), self.l2 * xp.sin(ph)
        return xp.stack([x / 2, y / 2, th, x + u / 2, y + w / 2, ph, x + u])


@dataclass(frozen=True)
class SliderCrank(_FreeCrank):
    """A slider crank in absolute coordinates, moving freely under gravity: seven coordinates,
    six constraints.

    The standard mechanism: -(lam1, lam2) and -(lam3, lam4) are the sums of the joint forces on
    crank and rod, -lam5 is the force of the rod on the slider, -lam6 that of the guide on the rod's
    end. The energy shows the damping of an integrator. Left out: friction, play and a drive, so
    that ``slider_crank_minimal`` is the same motion by other equations; the slider's height and
    weight, which the guide takes. With l2 <= l1 the crank can run into a singular position.
    """

    tags = ("constrained", "index 3", "conservative", "multibody")
    difficulties = (
        "six constraints on seven coordinates: index 3 with one freedom left",
        "the plain start leaves a first-order transient in a and lam",
    )
    coordinates = (
        "crank x [m]", "crank y [m]", "crank angle [rad]", "rod x [m]", "rod y [m]",
        "rod angle [rad]", "slider x [m]",
    )  # fmt: skip
    multipliers = (
        "crank x [N]", "crank y [N]", "rod x [N]", "rod y [N]", "slider x [N]", "guide [N]",
    )  # fmt: skip
    source = "Standard planar mechanism; data of the IVP test set's crank, rounded, rigid rod"

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.diag(self._inertias())

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        weights = jnp.array([0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0])
        return -self.g * weights * self._inertias()

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        x1, y1, th, x2, y2, ph, x3 = q
        x, y = self.l1 * jnp.cos(th), self.l1 * jnp.sin(th)
        u, w = self.l2 * jnp.cos(ph), self.l2 * jnp.sin(ph)
        return jnp.stack(
            [x1 - x / 2, y1 - y / 2, x2 - x - u / 2, y2 - y - w / 2, x3 - x - u, y + w]
        )

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return 0.5 * (self._inertias() * v) @ v + self.g * (self.m1 * q[1] + self.m2 * q[4])

    def initial_state(self) -> State:
        q = np.asarray(self._assembled(np.float64(self.th0)))
        w1, (c1, c2), (s1, s2) = self.w0, np.cos(q[[2, 5]]), np.sin(q[[2, 5]])
        w2 = -self.l1 * c1 * w1 / (self.l2 * c2)
        tip = self.l1 * w1 * np.array([-s1, c1])
        half = self.l2 / 2 * w2 * np.array([-s2, c2])
        v = [*(tip / 2), w1, *(tip + half), w2, (tip + 2 * half)[0]]
        return State(q=q, v=np.array(v))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        return _polylines(self.l1, 2 * np.asarray(q[:2]), float(q[6]))


@dataclass(frozen=True)
class SliderCrankFriction(SliderCrank):
    """The free slider crank whose slider rubs in its guide, by the force between both.

    Friction is mu times the size of the guide's force, which is lam6 with the slider's weight, so
    an error of lam becomes one of the motion. It in turn changes lam, by the slope of the rod;
    equations for a and lam are nonlinear. Size and sign are smoothed, as friction turns at both
    dead centres. Left out: friction in the pins, sticking, and a larger friction at rest.
    """

    interval = (0.0, 1.0)
    nominal_step = 0.0025
    tags = ("constrained", "index 3", "dissipative", "multibody", "friction")
    difficulties = (
        "a force depends on lam: methods that know lam only after the step cannot take it",
        "friction changes its sign within ``eps`` at the dead centres, its size where lam does",
    )
    source = "slider_crank with Coulomb friction, smoothed by tanh(v/eps) and sqrt(N^2 + soft^2)"
    energy = None  # pyright: ignore[reportAssignmentType]

    mu: float = parameter(0.1, "1", "coefficient of friction", low=0.0)
    eps: float = parameter(0.2, "m/s", "velocity over which friction changes sign", low=1e-12)
    soft: float = parameter(0.1, "N", "force over which its size turns", low=1e-12)

    def coupled_force(self, z: Variables) -> jax.Array:
        normal = self.m3 * self.g - z.lam[5]
        size = self.mu * jnp.sqrt(normal**2 + self.soft**2)
        return jnp.zeros(7).at[6].set(-size * jnp.tanh(z.v[6] / self.eps))


@dataclass(frozen=True)
class SliderCrankMinimal(_FreeCrank, OfEnergies):
    """The free slider crank by its crank angle alone: an ODE of one degree of freedom.

    Tests the cost of absolute coordinates: the motion is that of ``slider_crank``, and serves as a
    reference for it without constraints. Left out are the same effects as there, and the
    multipliers, which this form does not have.
    """

    tags = ("smooth", "nonlinear", "conservative", "multibody")
    coordinates = ("crank angle [rad]",)
    source = "Lagrange's equation of slider_crank"
    energy = OfEnergies._total

    def _kinetic_energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        _, rate = jax.jvp(lambda q: self._assembled(q[0], jnp), (q,), (v,))
        return 0.5 * (self._inertias() * rate) @ rate

    def _potential_energy(self, q: jax.Array) -> jax.Array:
        at = self._assembled(q[0], jnp)
        return self.g * (self.m1 * at[1] + self.m2 * at[4])

    def initial_state(self) -> State:
        return State(q=np.array([self.th0]), v=np.array([self.w0]))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        at = np.asarray(self._assembled(np.float64(q[0])))
        return _polylines(self.l1, 2 * at[:2], float(at[6]))


@dataclass(frozen=True)
class SliderCrankDriven(MechatronicSystem):
    """A slider crank driven at constant speed: rheonomic, and known in closed form.

    Two coordinates, crank angle and slider position; two constraints, the length of a rod without
    mass and phi = Omega t. No freedom is left, so every acceleration and multiplier is exact:
    lam1 is the force density of the rod (its force divided by l2), lam2 the torque that the drive
    takes. Left out: the masses of crank and rod; they would change multipliers, never the motion.

    Positions follow from the constraints alone, and so do velocities where the derivative of the
    constraints is imposed: they are exact up to Newton's tolerance at every step. Only a and lam
    show an order, and v on index 3.

    With l1 = l2 the augmented matrix is singular at phi = pi/2, where the slider passes the
    bearing: a run with a step near this angle fails, or goes on by luck. ``exact`` is then the
    branch of a slider with mass, x = 2 l1 cos(phi). For l2 slightly above l1 the acceleration has
    a peak there instead.
    """

    interval = (0.005, 0.05)
    nominal_step = 5e-4
    tags = ("constrained", "index 3", "closed form", "rheonomic")
    difficulties = ("with l1 = l2 the constraints lose rank at a crank angle of pi/2",)
    coordinates = ("crank angle [rad]", "slider x [m]")
    multipliers = ("rod [N/m]", "drive [N m]")
    source = "Closed form: x = l1 cos(p) + sqrt(l2^2 - l1^2 sin(p)^2), p = Omega t"

    l1: float = parameter(0.15, "m", "length of the crank", low=1e-9)
    l2: float = parameter(0.3, "m", "length of the rod", low=1e-9)
    omega: float = parameter(150.0, "rad/s", "angular velocity of the drive")
    j1: float = parameter(2.7e-3, "kg m^2", "inertia of the crank", low=0.0)
    m3: float = parameter(0.075, "kg", "mass of the slider", low=1e-12)

    def __post_init__(self) -> None:
        _check_reach(self.l1, self.l2, self.omega * self.interval[0])

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.diag(jnp.stack([self.j1, self.m3]))

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return jnp.zeros(2)

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        phi, x = q
        along, across = x - self.l1 * jnp.cos(phi), self.l1 * jnp.sin(phi)
        return jnp.stack([0.5 * (along**2 + across**2 - self.l2**2), phi - self.omega * t])

    def exact(self, t: np.ndarray) -> dict[str, np.ndarray]:
        """x = l1 cos(p) + R with R = sqrt(l2^2 - l1^2 sin(p)^2); NaN where the rod is too short.

        R is the rod's projection on the guide. The slider's equation m3 x'' + R lam1 = 0 and the
        crank's x l1 sin(p) lam1 + lam2 = 0 give the multipliers.
        """
        p, w, l1 = self.omega * np.asarray(t, dtype=float), self.omega, self.l1
        c, s = np.cos(p), np.sin(p)
        if self.l1 == self.l2:  # R would be l1 |cos(p)|; moving on, the slider takes l1 cos(p)
            r, r1, r2 = l1 * c, -l1 * w * s, -l1 * w**2 * c
            lam1 = np.full_like(p, 2 * self.m3 * w**2)
        else:
            with np.errstate(invalid="ignore"):
                r = np.sqrt((self.l2 - l1) * (self.l2 + l1) + (l1 * c) ** 2)
            r1 = -(l1**2) * w * s * c / r
            r2 = -(l1**2 * w**2 * (c - s) * (c + s) + r1**2) / r
            lam1 = -self.m3 * (r2 - l1 * w**2 * c) / r
        x = l1 * c + r
        return {
            "q": np.column_stack([p, x]),
            "v": np.column_stack([np.full_like(p, w), r1 - l1 * w * s]),
            "a": np.column_stack([np.zeros_like(p), r2 - l1 * w**2 * c]),
            "lam": np.column_stack([lam1, -x * l1 * s * lam1]),
        }

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        tip = self.l1 * np.array([np.cos(q[0]), np.sin(q[0])])
        return _polylines(self.l1, tip, float(q[1]))
