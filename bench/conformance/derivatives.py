"""The checks of derivatives of a run, and of steps that are called alone with a fixed budget."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.conformance.trials import Trial, trials
from bench.conformance.verdicts import DoesNotApply, Failed
from bench.plugins.registry import Registry
from bench.running.realtime import stepping
from integrators.contract import Integrator, Wanted
from integrators.native.lone_steps import LoneStep
from integrators.resolutions import Steps
from problems.runtime import Float
from problems.spec import SpecError

#: Change of a parameter, relative to its size, in quotients of differences; they have an error of
#: order four in it.
_CHANGE = 1e-3
#: Largest difference of derivatives, relative to the largest one: Newton's method ends within its
#: tolerance, which the quotients divide by the change.
_SAME = 1e-5
#: Derivatives below that are rounding: the parameter does not decide the motion.
_LEAST = 1e-6
#: Largest difference between steps in a loop and steps that are called alone, relative.
_ALONE = 1e-9


def check_gradient(registry: Registry, method: Integrator) -> str:
    """Derivatives by a parameter are quotients of differences of runs, in each way."""
    constant = method if method.gradient_ways else method.at_constant_steps()
    if constant is None or not constant.gradient_ways:
        raise DoesNotApply("Its runs cannot be differentiated.")
    for trial in trials(registry, constant):
        for name in () if trial.scene.is_hybrid else trial.scene.parameters():
            expected = _quotients(trial, name)
            if (size := float(np.abs(expected).max())) > _LEAST:
                return _compared(trial, name, expected, size)
    raise DoesNotApply("No trial scene that it takes has a parameter that decides the motion.")


def _quotients(trial: Trial, name: str) -> Float[np.ndarray, " nq"]:
    """Derivatives of q at the end by a parameter, from runs with four other values."""
    scene = trial.scene
    value = float(getattr(scene, name))
    change = _CHANGE * (abs(value) or 1.0)

    def end(by: float) -> np.ndarray:
        # The classes of scenes are dataclasses, those that have parameters at least.
        other = replace(scene, **{name: value + by * change})  # pyright: ignore[reportArgumentType]
        return replace(trial, scene=other).measured().q[-1]

    try:
        near, far = ((end(k) - end(-k)) / (2 * k * change) for k in (1, 2))
    except SpecError:  # a value that the scene does not allow
        return np.zeros(scene.sizes.nq)
    return np.asarray(4 * near - far) / 3


def _compared(trial: Trial, name: str, expected: np.ndarray, size: float) -> str:
    """Compare derivatives of q with those that are expected, which are as large as ``size``."""
    method, scene = trial.method, trial.scene
    of = tuple(("q", k) for k in range(len(expected)))
    largest = 0.0
    for way in method.gradient_ways:
        wanted = Wanted(of, (name,), way)
        found = method.gradient(scene, trial.t_end, trial.resolution(), wanted)()
        if not found.solved:
            raise Failed(f"The {way} derivatives of a run on {scene.spec} are not solved.")
        off = float(np.abs(found.derivatives[:, 0] - expected).max() / size)
        if not off <= _SAME:
            raise Failed(
                f"The {way} derivatives of q by {name} on {scene.spec} are "
                f"{found.derivatives[:, 0]}, quotients of differences {expected}; let a step be a "
                f"smooth function of its arguments."
            )
        largest = max(largest, off)
    ways = " and ".join(method.gradient_ways)
    return (
        f"Derivatives of q by {name} on {scene.spec}, {ways}, are quotients of differences but for "
        f"{largest:.1e}."
    )


def check_budget(registry: Registry, method: Integrator) -> str:
    """Steps that are called alone make the run of the loop; with few iterations of Newton's method
    they go on, and the more, the nearer to it."""
    reason = ""
    for trial in reversed(trials(registry, method)):
        try:
            own = LoneStep(stepping(method, trial.scene), trial.scene, *_grid(trial))
        except SpecError as refusal:
            reason = str(refusal)
            continue
        return _budgets(trial, own)
    raise DoesNotApply(reason)


def _grid(trial: Trial) -> tuple[float, int]:
    """Size of a step in s, and number of steps, of a trial at constant steps."""
    t0, t_end = trial.scene.interval[0], trial.t_end
    steps = Steps(trial.scene.nominal_step).count(t0, t_end)
    return (t_end - t0) / steps, steps


def _budgets(trial: Trial, own: LoneStep) -> str:
    scene, (h, steps) = trial.scene, _grid(trial)
    ends = _ends(own, steps, scene.spec)
    if trial.method.controls == "step":
        apart = _apart(ends, trial.measured().q[-1])
        if not apart <= _ALONE:
            raise Failed(
                f"Steps on {scene.spec} that are called alone end at {ends}, {apart:.1e} away from "
                f"the run of the loop; keep all that a step needs in the state that it returns."
            )
    if not own.iterates:
        return f"Steps that are called alone make the run of the loop on {scene.spec}."
    native = stepping(trial.method, scene)
    away = [
        _apart(_ends(LoneStep(native, scene, h, steps, k), steps, scene.spec), ends) for k in (1, 3)
    ]
    if not away[1] <= max(away[0], _ALONE):
        raise Failed(
            f"On {scene.spec} three iterations of Newton's method in each step end {away[1]:.1e} "
            f"away from a run with as many as it takes, one iteration {away[0]:.1e}."
        )
    return (
        f"Steps that are called alone make the run of the loop on {scene.spec}; with one iteration "
        f"of Newton's method in each it ends {away[0]:.1e} away, with three {away[1]:.1e}."
    )


def _ends(step: LoneStep, steps: int, scene: str) -> Float[np.ndarray, " nq"]:
    """q after all steps."""
    state, states = step.first, []
    for _ in range(steps):
        state = step(state)
        states.append(state)
    run, _ = step.run(states)
    if run.status != "ok":
        raise Failed(f"Steps on {scene} that are called alone end with {run.status}: {run.message}")
    return run.q[-1]


def _apart(one: np.ndarray, two: np.ndarray) -> float:
    return float(np.abs(one - two).max() / (np.abs(two).max() or 1.0))
