"""Trial scenes and trial runs, on which integrators are checked."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import islice
from typing import Any

import numpy as np

from bench.conformance.verdicts import DoesNotApply, Failed
from bench.plugins.registry import Registry
from integrators import answers
from integrators.answers import refusal
from integrators.contract import Integrator, PreparedRun, Steps, Tolerances, Trajectory
from problems import MechatronicSystem, State, jnp
from problems.answers import FalseAnswer, texts
from problems.reference import Reference

#: The tag by which a scene says that integrators are checked on it, beside the scene below.
TAG = "conformance"
#: The tag of further scenes on which orders are measured.
ORDERS_TAG = "orders"
#: A trial run takes this many nominal steps of its scene.
TRIAL_STEPS = 50
TRIAL_RTOL = 1e-6
#: The groups of a trajectory.
GROUPS = ("q", "v", "a", "lam", "x", "xdot", "y")


# ---- trial scenes ----------------------------------------------------------------------
@dataclass(frozen=True)
class ForcedOscillator(MechatronicSystem):
    """A mass on a hard spring under a harmonic force: smooth, nonlinear, driven by time.

    A method that evaluates forces at the wrong time loses its order here.
    """

    interval = (0.0, 5.0)
    nominal_step = 0.1

    def mass(self, q: Any) -> Any:
        return jnp.eye(1)

    def force(self, q: Any, v: Any, t: Any) -> Any:
        return jnp.cos(1.5 * t) - q - 0.3 * q**3

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


def moved(scene: MechatronicSystem, by: float) -> MechatronicSystem:
    """Return the scene with the same motion ``by`` seconds later."""
    return scene.with_parameters({}, _moved_class(type(scene), by))


def spoilt(scene: MechatronicSystem, at: float) -> MechatronicSystem:
    """Return the scene with a force that is NaN after the time ``at``, in s."""
    return scene.with_parameters({}, _spoilt_class(type(scene), at))


@cache
def _moved_class(cls: type, by: float) -> type:
    blocks = {
        "force": lambda self, q, v, t: cls.force(self, q, v, t - by),
        "constraint": lambda self, q, t: cls.constraint(self, q, t - by),
        "state_rate": lambda self, z: cls.state_rate(self, z._replace(t=z.t - by)),
        "output": lambda self, z: cls.output(self, z._replace(t=z.t - by)),
        # It may ask for the interval, which has moved.
        "initial_state": lambda self: self.with_parameters({}, cls).initial_state(),
        "exact": lambda self, t: self.with_parameters({}, cls).exact(np.asarray(t) - by),
    }
    own = {name: block for name, block in blocks.items() if cls.has(name)}
    return type(f"Moved{cls.__name__}", (cls,), own | {"interval": np.add(cls.interval, by)})


@cache
def _spoilt_class(cls: type, at: float) -> type:
    def force(self: Any, q: Any, v: Any, t: Any) -> Any:
        return cls.force(self, q, v, t) + jnp.where(t > at, jnp.nan, 0.0)

    return type(f"Spoilt{cls.__name__}", (cls,), {"force": force})


@cache
def reference(scene: MechatronicSystem, t_end: float) -> Reference:
    """Return the reference of a scene up to t_end in s, made once for all checks."""
    return Reference(scene, t_end)


# ---- trial runs -----------------------------------------------------------------------
def trials(registry: Registry, method: Integrator) -> list[MechatronicSystem]:
    """Return the trial scenes that a method takes, or the first other scene that it takes.

    Trial scenes are `ForcedOscillator` and all scenes with the tag "conformance".

    Raises
    ------
    DoesNotApply
        If it takes no scene at all.
    """
    tried = [ForcedOscillator(), *_tagged(registry, TAG)]
    taken = [scene for scene in tried if refusal(method, scene) is None]
    every = map(registry.problem, _classes(registry))
    others = (scene for scene in every if refusal(method, scene) is None)
    taken = taken or list(islice(others, 1))
    if not taken:
        raise DoesNotApply("It takes no scene.")
    return taken


def _classes(registry: Registry) -> dict[str, type]:
    return {name: plugin.cls for name, plugin in registry.problems.items() if plugin.cls}


def _tagged(registry: Registry, tag: str) -> list[MechatronicSystem]:
    # Tags of the class itself: a scene that is made from a tagged one may be wrong, and is checked.
    return [registry.problem(name) for name, cls in _classes(registry).items() if tag in _tags(cls)]


def _tags(cls: type) -> tuple[str, ...]:
    try:
        return texts(vars(cls).get("tags", ()), "tags")
    except FalseAnswer:  # the check of the scene tells it
        return ()


def order_trials(registry: Registry, method: Integrator) -> list[MechatronicSystem]:
    """Return the trial scenes that a method takes, and those with the tag "orders".

    Raises
    ------
    DoesNotApply
        If it takes no scene at all.
    """
    more = _tagged(registry, ORDERS_TAG)
    return trials(registry, method) + [scene for scene in more if refusal(method, scene) is None]


def must_take(method: Integrator, scene: MechatronicSystem, what: str) -> None:
    """Go on with a changed scene only if the method takes it.

    Raises
    ------
    DoesNotApply
        If it does not take this scene ``what``, a clause.
    """
    if reason := refusal(method, scene):
        raise DoesNotApply(f"It does not take a scene {what}: {reason}")


def trial_end(scene: MechatronicSystem) -> float:
    """Return the end time of a trial run, in s."""
    t0, t_end = scene.interval
    return min(t_end, t0 + TRIAL_STEPS * scene.nominal_step)


def resolution(
    method: Integrator, scene: MechatronicSystem, finer: float = 1.0
) -> Steps | Tolerances:
    """Return the step or tolerances of a trial run, ``finer`` by a factor."""
    if method.controls == "step":
        return Steps(scene.nominal_step / finer)
    return Tolerances(TRIAL_RTOL / finer)


def prepared(method: Integrator, scene: MechatronicSystem, finer: float = 1.0) -> PreparedRun:
    """Prepare a trial run."""
    refined = resolution(method, scene, finer)
    return answers.prepared(method.prepare(scene, trial_end(scene), refined))


def trajectory(run: PreparedRun, scene: MechatronicSystem, t_end: float) -> Trajectory:
    """Measure a run up to t_end in s.

    Raises
    ------
    Failed
        If it does not give a trajectory.
    """
    try:
        return answers.trajectory(run.measure(), scene.sizes, scene.interval[0], t_end)
    except FalseAnswer as fault:
        raise Failed(f"On {scene.spec}: {fault}") from fault


def solved(
    method: Integrator, scene: MechatronicSystem, t_end: float, refined: Steps | Tolerances
) -> Trajectory:
    """Prepare and measure a run up to t_end in s; see `trajectory`."""
    return trajectory(answers.prepared(method.prepare(scene, t_end, refined)), scene, t_end)


def measured(method: Integrator, scene: MechatronicSystem, finer: float = 1.0) -> Trajectory:
    """Measure a trial run that has to succeed.

    Raises
    ------
    Failed
        If it does not.
    """
    run = solved(method, scene, trial_end(scene), resolution(method, scene, finer))
    if run.status != "ok":
        raise Failed(
            f"On {scene.spec} at {words(method, scene, finer)} it ends with {run.status}: "
            f"{run.message}; a smooth scene at this resolution has to go well."
        )
    return run


def words(method: Integrator, scene: MechatronicSystem, finer: float = 1.0) -> str:
    """Return the resolution of a trial run in words."""
    refined = resolution(method, scene, finer)
    if isinstance(refined, Steps):
        return f"h={refined.h:g} s"
    return f"rtol={refined.rtol:g}"


def names_of(scenes: list[MechatronicSystem]) -> str:
    """Return the names of scenes for a sentence."""
    return ", ".join(scene.spec for scene in scenes)


def step_count(scene: MechatronicSystem) -> int:
    """Return the number of fixed steps in a trial run."""
    return Steps(scene.nominal_step).count(scene.interval[0], trial_end(scene))
