"""Trial scenes and trial runs, on which integrators are checked."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from bench.check.verdicts import DoesNotApply, Failed
from bench.plugins.registry import Registry
from integrators import checks
from integrators.contract import Integrator, PreparedRun, Trajectory
from integrators.resolutions import Steps, Tolerances
from problems import MechatronicSystem, State, jnp
from problems.base.checks import FalseAnswer, texts
from problems.truth.reference import Reference

#: The tag by which a scene says that integrators are checked on it, beside the scene below.
TAG = "conformance"
#: The tag of further scenes on which orders are measured.
ORDERS_TAG = "orders"
#: A trial run takes this many nominal steps of its scene.
TRIAL_STEPS = 50
TRIAL_RTOL = 1e-6
#: Speed that an impact of the trial ball leaves, in parts.
_REBOUND = 0.8
#: The groups of a trajectory.
TRAJECTORY_GROUPS = ("q", "v", "a", "lam", "x", "xdot", "y")


@dataclass(frozen=True)
class ForcedOscillator(MechatronicSystem):
    """A mass on a hard spring under a harmonic force: smooth, nonlinear, driven by time.

    A method that evaluates forces at the wrong time, or begins at 0 s, loses its order here.
    """

    interval = (2.0, 7.0)
    nominal_step = 0.1

    def mass(self, q: Any) -> Any:
        return jnp.eye(1)

    def force(self, q: Any, v: Any, t: Any) -> Any:
        return jnp.cos(1.5 * (t - 2.0)) - q - 0.3 * q**3

    def initial_state(self) -> State:
        return State(q=np.array([1.0]), v=np.array([0.5]))


@dataclass(frozen=True)
class FiniteTimeBlowUp(MechatronicSystem):
    """A force that grows exponentially with the position: q = log(2) - 2 log(1 - t), up to 1 s.

    Near the end the equations of an implicit step have no solution, so that no method can step
    over it. (A power of q would leave them one, on the far side.)
    """

    interval = (0.0, 1.5)
    nominal_step = 0.01

    def mass(self, q: Any) -> Any:
        return jnp.eye(1)

    def force(self, q: Any, v: Any, t: Any) -> Any:
        return jnp.exp(q)

    def initial_state(self) -> State:
        return State(q=np.array([np.log(2.0)]), v=np.array([2.0]))


@dataclass(frozen=True)
class TrialBall(MechatronicSystem):
    """A ball that falls from 1 m and bounces twice: times of impact in closed form."""

    interval = (0.0, 1.3)
    nominal_step = 0.026

    def mass(self, q: Any) -> Any:
        return jnp.eye(1)

    def force(self, q: Any, v: Any, t: Any) -> Any:
        return jnp.full(1, -9.81)

    def events(self, z: Any) -> Any:
        return z.q

    def jump(self, z: Any, event: int) -> dict[str, Any]:
        return {"v": -_REBOUND * z.v}

    def initial_state(self) -> State:
        return State(q=np.ones(1), v=np.zeros(1))

    @property
    def impacts(self) -> np.ndarray:
        """Times of impact in s."""
        fall = np.sqrt(2 / 9.81)
        return fall * np.array([1.0, 1.0 + 2 * _REBOUND])


@cache
def spoilt(cls: type[MechatronicSystem], at: float) -> type[MechatronicSystem]:
    """Return the class with a force that is NaN after the time ``at``, in s."""

    def force(self: Any, q: Any, v: Any, t: Any) -> Any:
        return cls.force(self, q, v, t) + jnp.where(t > at, jnp.nan, 0.0)

    return type(f"Spoilt{cls.__name__}", (cls,), {"force": force})


@cache
def reference(scene: MechatronicSystem, t_end: float) -> Reference:
    """Return the reference of a scene up to t_end in s, made once for all checks."""
    return Reference(scene, t_end)


@dataclass(frozen=True)
class Trial:
    """Runs of a method on a scene over `TRIAL_STEPS` nominal steps, or as long as the scene lasts.

    Its step or tolerance is made finer by a factor ``finer``.
    """

    method: Integrator
    scene: MechatronicSystem

    @property
    def t_end(self) -> float:
        """End time in s."""
        t0, t_end = self.scene.interval
        return min(t_end, t0 + TRIAL_STEPS * self.scene.nominal_step)

    def resolution(self, finer: float = 1.0) -> Steps | Tolerances:
        """Return the step or tolerances of a run."""
        if self.method.controls == "step":
            return Steps(self.scene.nominal_step / finer)
        return Tolerances(TRIAL_RTOL / finer)

    def words(self, finer: float = 1.0) -> str:
        """Return the resolution of a run in words."""
        refined = self.resolution(finer)
        return f"h={refined.h:g} s" if isinstance(refined, Steps) else f"rtol={refined.rtol:g}"

    def prepared(self, refined: Steps | Tolerances, t_end: float | None = None) -> PreparedRun:
        """Prepare a run up to t_end in s."""
        end = self.t_end if t_end is None else t_end
        return checks.checked_run(self.method.prepare(self.scene, end, refined))

    def trajectory(self, run: PreparedRun, t_end: float | None = None) -> Trajectory:
        """Measure a run up to t_end in s; raise ``Failed`` if that gives no trajectory."""
        end, t0 = self.t_end if t_end is None else t_end, self.scene.interval[0]
        try:
            return checks.checked_trajectory(run.measure(), self.scene.sizes, t0, end)
        except FalseAnswer as fault:
            raise Failed(f"On {self.scene.spec}: {fault}") from fault

    def solved(self, refined: Steps | Tolerances, t_end: float | None = None) -> Trajectory:
        """Prepare and measure a run up to t_end in s."""
        return self.trajectory(self.prepared(refined, t_end), t_end)

    def measured(self, finer: float = 1.0) -> Trajectory:
        """Measure a run; raise ``Failed`` if it does not reach the end."""
        run = self.solved(self.resolution(finer))
        if run.status != "ok":
            raise Failed(
                f"On {self.scene.spec} at {self.words(finer)} it ends with {run.status}: "
                f"{run.message}; a smooth scene at this resolution has to go well."
            )
        return run


def trials(registry: Registry, method: Integrator, *more: str) -> list[Trial]:
    """Return trials on the trial scenes that a method takes, or on the first other scene.

    Trial scenes are `ForcedOscillator` and all scenes with the tag "conformance", or one of
    ``more``. A method that takes no scene at all raises ``DoesNotApply``.
    """
    classes = {name: plugin.cls for name, plugin in registry.problems.items() if plugin.cls}
    # Tags of the class itself: a scene that is made from a tagged one may be wrong, and is checked.
    tagged = [registry.problem(n) for n, c in classes.items() if {TAG, *more} & {*_tags(c)}]
    tried = _taken(method, [ForcedOscillator(), *tagged])
    tried = tried or _taken(method, map(registry.problem, classes))[:1]
    if not tried:
        raise DoesNotApply("It takes no scene.")
    return tried


def _taken(method: Integrator, scenes: Iterable[MechatronicSystem]) -> list[Trial]:
    return [Trial(method, scene) for scene in scenes if checks.refusal(method, scene) is None]


def _tags(cls: type) -> tuple[str, ...]:
    try:
        return texts(vars(cls).get("tags", ()), "tags")
    except FalseAnswer:  # the check of the scene tells it
        return ()


def names_of(tried: list[Trial]) -> str:
    """Return the names of the scenes of trials for a sentence."""
    return ", ".join(trial.scene.spec for trial in tried)
