"""The check of many runs as one program: members are single runs, whatever stands beside them."""

from __future__ import annotations

import numpy as np

from bench.check.trials import Trial, names_of, trials
from bench.check.verdicts import DoesNotApply, Failed
from bench.plugins.registry import Registry
from bench.sweeps.batch import refuse
from bench.sweeps.ensemble import ensemble
from integrators.contract import Integrator
from problems.spec import SpecError

#: Members differ from their single run by no more, relative to the largest value of the group:
#: they round in their own way, and Newton's method ends within its tolerance.
_MOST = 1e-8
#: Scenes on which it is tried; each compiles a program.
_SCENES = 2


def check_batch(registry: Registry, method: Integrator) -> str:
    """A batch has the same bits again; its members are their single runs but for rounding."""
    tried, reason = [], ""
    for trial in trials(registry, method):
        try:
            refuse(method, trial.scene)
            tried.append(trial)
        except SpecError as refusal:
            reason = str(refusal)
    if not tried:
        raise DoesNotApply(f"It does not run many members in one program: {reason}")
    apart = max(_difference(trial) for trial in tried[:_SCENES])
    return (
        f"A batch has the same bits again; a member differs from its single run by {apart:.1e} "
        f"(relative), on {names_of(tried[:_SCENES])}."
    )


def _difference(trial: Trial) -> float:
    """Largest difference of two equal members, and of one with other steps between, from a run."""
    name, run = trial.scene.spec, trial.measured()
    option = "h" if trial.method.controls == "step" else "rtol"
    values = [getattr(trial.resolution(factor), option) for factor in (1.0, 3.0, 1.0)]
    one, again = (
        ensemble(trial.scene, trial.method, {option: values}, t_end=trial.t_end) for _ in range(2)
    )
    for status, message in zip(one.status, one.message, strict=True):
        if status != "ok":
            raise Failed(
                f"A member of a batch on {name} ends with {status}: {message} Its single run does "
                f"not."
            )
    for column, found in one.values.items():
        if not np.array_equal(found, again.values[column]):
            raise Failed(f"{column} of a batch on {name} has other bits when it is run again.")
    apart = 0.0
    for group in ("q", "v", "a", "lam", "x", "y"):
        single, size = getattr(run, group), np.abs(getattr(run, group)).max(initial=0.0) or 1.0
        for n, value in enumerate(single[-1], start=1):
            ends = one.values[f"{group}{n}"][[0, 2]]
            apart = max(apart, float(np.abs(ends - value).max() / size))
    if not apart <= _MOST:
        raise Failed(
            f"A member of a batch on {name} differs from its single run by {apart:.2g} (relative); "
            f"let a step be a function of its arguments alone."
        )
    return apart
