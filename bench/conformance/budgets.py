"""The check of steps that are called alone with a fixed budget."""

from __future__ import annotations

import numpy as np

from bench.conformance.trials import Trial, trials
from bench.conformance.verdicts import DoesNotApply, Failed
from bench.plugins.registry import Registry
from bench.running.realtime import stepping
from integrators.contract import Integrator
from integrators.native.lone_steps import LoneStep
from integrators.resolutions import Steps
from problems.runtime import Float
from problems.spec import SpecError

#: Largest difference between steps in a loop and steps that are called alone, relative.
_ALONE = 1e-9


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
