"""Integrators and scenes with one fault each; test_check.py checks them as a plugin file."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench.check.trials import FiniteTimeBlowUp
from integrators import Integrator, PreparedRun, Steps, Work, option
from integrators.methods.generalized_alpha import Newmark
from problems import MechatronicSystem, State, jax, jnp, parameter
from problems.mechanics.rotations import quaternion_rate, rotated, turned
from problems.scenes.contacts import BouncingBall
from problems.scenes.oscillators import SampledPd
from problems.scenes.pendulums import Chain, Pendulum

RANDOM = np.random.default_rng(0)


class Run(PreparedRun):
    """A run of Newmark's method that goes wrong as it is told."""

    def __init__(self, how, scene, t_end, steps):
        self.how, self.t0 = how, scene.interval[0]
        self.sampled = bool(scene.held_values())
        self.explosive = isinstance(scene, FiniteTimeBlowUp)
        method = Newmark(beta=0.3025, gamma=0.6) if how == "order" else Newmark()
        if how == "unchanging":
            steps = Steps(steps.h)
        self.inner = method.prepare(scene, t_end, steps)

    def measure(self):
        run, how = self.inner.measure(), self.how
        if how == "random":
            run.q[1] += RANDOM.normal()
        if how == "off_grid":
            run.t[3] += 0.3 * (run.t[3] - run.t[2])
        if how == "late" or (how == "late_sample" and self.sampled):
            run.t[-1] += 1e-12
        if how == "without_start":
            run.q[0] = run.q[1]
        if how == "uncounted":
            run.work = Work()
        if how == "always_seven":
            run.work.residuals = 7
        if how == "twice":
            run.work.steps *= 2
        if how == "from_zero":
            run.q[1:] += 0.01 * self.t0
        if how == "heavy":  # as if gravity were larger
            run.q[:, 0] -= 0.05 * (run.t - self.t0) ** 2
            run.v[:, 0] -= 0.1 * (run.t - self.t0)
        if run.status != "ok" and (how == "raises" or (how == "explodes" and self.explosive)):
            raise FloatingPointError("not finite")
        if how == "says_ok":
            run.status = "ok"
        if how == "speechless":
            run.message = "It went wrong."
        if how == "hangs":
            time.sleep(3600)
        if how == "exits":
            os._exit(3)
        return run

    def execute(self):
        return np.zeros(3) if self.how == "idle" else self.inner.execute()


@dataclass(frozen=True)
class Wrong(Integrator):
    """Newmark's method with a fault."""

    formulation: ClassVar[str] = "index3"
    orders: ClassVar = {"q": 2, "v": 2}
    how: str = option("not at all", "what is wrong", always=True)

    def supports(self, scene):
        return "it likes none." if self.how == "picky" else None

    def prepare(self, scene, t_end, resolution):
        return Run(self.how, scene, t_end, resolution)


@dataclass(frozen=True)
class Deaf(Wrong):
    """It takes a tolerance and does not listen to it."""

    controls: ClassVar[str] = "tolerance"
    how: str = option("not at all", "what is wrong")

    def prepare(self, scene, t_end, resolution):
        return Run("", scene, t_end, Steps(scene.nominal_step))


@dataclass(frozen=True)
class Forgetful(Wrong):
    """It keeps another value than it is given."""

    how: str = option("not at all", "what is wrong")
    damping: float = option(0.5, "damping", low=0.0, high=1.0)

    def __post_init__(self):
        object.__setattr__(self, "damping", min(self.damping, 0.9))


@dataclass(frozen=True)
class Nameless(Wrong):
    """Its printed name leaves its option out."""

    how: str = option("not at all", "what is wrong")
    cheap: bool = option(False, "less work")

    @property
    def spec(self):
        return "nameless"


# ---- scenes with one fault each ------------------------------------------------------------
def wrong_start(self):
    q, v, x = Pendulum.initial_state(self)
    return State(1.25 * q, v, x)


def straight(self, q, w):
    """A movement that goes straight on while the body turns."""
    there = q[:3] + rotated(q[3:], w[:3])
    return jnp.concatenate([there, turned(q[3:], w[3:])])


def gravity(self):
    return np.array([0.0, -self.m * self.g])


def lighter(self, t):
    """The acceleration of a lighter world."""
    known = Pendulum.exact(self, t)
    return known | {"a": known["a"] * [1.0, 1.01]}


def straight_fall(self, t):
    """A motion that begins at the start and has the right a, on another path."""
    fallen = np.asarray(t)[:, None]
    return {"q": -(fallen**2), "v": -fallen, "a": -np.ones_like(fallen)}


#: By name of the class: its base, and the blocks that are wrong.
SCENES = {
    "NanSample": (SampledPd, {"sample": lambda self, z: {"demand": jnp.nan}}),
    "LongSample": (SampledPd, {"sample": lambda self, z: {"demand": z.q}}),
    "ScalarEvents": (BouncingBall, {"events": lambda self, z: z.q[0]}),
    "NanEvents": (BouncingBall, {"events": lambda self, z: z.q * jnp.nan}),
    "MisspeltJump": (BouncingBall, {"jump": lambda self, z, event: {"velocity": -z.v}}),
    "WrongEnergy": (Pendulum, {"energy": lambda self, q, v: self.m * (v @ v / 2 - self.g * q[1])}),
    # Gravity changes it.
    "WrongMomentum": (Pendulum, {
        "momentum": lambda self, q, v: self.m * (q[:1] * v[1:] - q[1:] * v[:1])}),
    "LopsidedMass": (Pendulum, {"mass": lambda self, q: self.m * jnp.array([[1, 0.1], [0, 1]])}),
    "WrongProduct": (Chain, {"mass_product": lambda self, q, a: 1.01 * self.m * a}),
    "TwiceHeld": (Pendulum, {"constraint": lambda *at: jnp.repeat(Pendulum.constraint(*at), 2)}),
    "WrongExact": (Pendulum, {"exact": lighter}),
    "OffTheRod": (Pendulum, {"initial_state": wrong_start}),
    "NumpyForce": (Pendulum, {"force": lambda self, q, v, t: gravity(self) + 0 * np.sin(q)}),
    "MoodyForce": (Pendulum, {"force": lambda *at: Pendulum.force(*at) + RANDOM.normal()}),
    "HiddenSlope": (Pendulum, {"force": lambda self, q, v, t: (
        Pendulum.force(self, q, v, t) - jax.lax.stop_gradient(v))}),
    "Skidding": (MechatronicSystem, {
        "mass": lambda self, q: jnp.eye(6), "force": lambda self, q, v, t: jnp.zeros(6),
        "initial_state": lambda self: State(np.eye(7)[3], np.ones(6)), "move": straight,
        "kinematics": lambda self, q, v: jnp.concatenate(
            [rotated(q[3:], v[:3]), quaternion_rate(q[3:], v[3:])])}),
    "WrongSlope": (MechatronicSystem, {
        "mass": lambda self, q: jnp.eye(1), "force": lambda self, q, v, t: -jnp.ones(1) + 0 * q,
        "initial_state": lambda self: State(np.zeros(1), np.zeros(1)), "exact": straight_fall}),
}  # fmt: skip
for _name, (_base, _blocks) in SCENES.items():
    _stated = {"__doc__": "A wrong scene.", "__module__": __name__, **_blocks}
    globals()[_name] = dataclass(frozen=True)(type(_name, (_base,), _stated))


@dataclass(frozen=True)
class Stubborn(MechatronicSystem):
    """A mass on a spring that has one stiffness wherever it is traced."""

    m: float = parameter(1.0, "kg", "mass", low=1e-9)
    k: float = parameter(4.0, "N/m", "stiffness", low=0.0)

    def mass(self, q):
        return jnp.eye(1) * self.m

    def force(self, q, v, t):
        return -(self.k if isinstance(self.k, float) else 4.0) * q

    def initial_state(self):
        return State(q=np.ones(1), v=np.zeros(1))


@dataclass(frozen=True)
class Idle(Pendulum):
    """A parameter without a unit."""

    c: float = parameter(1.0, "", "nothing")
