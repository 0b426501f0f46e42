"""The check of many runs as one program: members are single runs, whatever stands beside them."""

from __future__ import annotations

import re

import numpy as np

from bench.check.trials import Trial, names_of, trials
from bench.check.verdicts import DoesNotApply, Failed
from bench.plugins.registry import Registry
from bench.sweeps.batch import refuse
from bench.sweeps.ensemble import WORK, Ensemble, ensemble
from integrators.contract import Integrator, Trajectory
from problems.spec import SpecError

#: Members with equal numbers differ by no more, and from their single run, relative to the largest
#: value of the group: they round in their own way, and Newton's method ends within its tolerance.
_MOST = 1e-8
#: Counts may differ by this part: an iteration here and there.
_COUNTS = 5e-3
#: Scenes on which it is tried; each compiles a program.
_SCENES = 2


def check_batch(registry: Registry, method: Integrator) -> str:
    """A batch has the same bits again; its members are their twins and their single runs but for
    rounding, with as many steps."""
    tried, reason = [], ""
    for trial in trials(registry, method):
        try:
            refuse(method, trial.scene)
            tried.append(trial)
        except SpecError as refusal:
            reason = str(refusal)
    if not tried:
        raise DoesNotApply(f"It does not run many members in one program: {reason}")
    twins, single = np.max([_differences(trial) for trial in tried[:_SCENES]], axis=0)
    return (
        f"A batch has the same bits again; a member differs from its twin by {twins:.1e}, from "
        f"its single run by {single:.1e} (relative), on {names_of(tried[:_SCENES])}."
    )


def _differences(trial: Trial) -> tuple[float, float]:
    """Largest differences of a member from its twins, and from its single run."""
    name, run = trial.scene.spec, trial.measured()
    one, again = _members(trial), _members(trial)
    for column, values in one.values.items():
        if not np.array_equal(values, again.values[column]):
            raise Failed(f"{column} of a batch on {name} has other bits when it is run again.")
    ends = [_ends(one, k) for k in (0, 2)]
    last = {group: getattr(run, group)[-1] for group in ends[0]}
    twins, single = (max(_apart(e, other, run) for e in ends) for other in (ends[0], last))
    if not max(twins, single) <= _MOST:
        raise Failed(
            f"A member of a batch on {name} differs from its twin by {twins:.2g}, from its single "
            f"run by {single:.2g} (relative); let a step be a function of its arguments alone."
        )
    step = trial.method.controls == "step"
    for count, alone in vars(run.work).items():
        column = WORK + count
        if alone is None or column not in one.values:
            continue
        allowed = 0.0 if step and count == "steps" else _COUNTS * alone
        if not abs(one.values[column][2] - alone) <= allowed:
            raise Failed(
                f"A member of a batch on {name} counts {one.values[column][2]:g} {count}, its "
                f"single run {alone}; count what happens in the step itself."
            )
    return twins, single


def _ends(found: Ensemble, k: int) -> dict[str, np.ndarray]:
    """Values of a member at the end, by group."""
    groups: dict[str, list[float]] = {}
    for name, column in found.values.items():
        if at := re.fullmatch(r"(q|v|a|lam|x|y)\d+", name):
            groups.setdefault(at[1], []).append(column[k])
    return {group: np.array(own) for group, own in groups.items()}


def _apart(one: dict[str, np.ndarray], two: dict[str, np.ndarray], run: Trajectory) -> float:
    """Largest difference of end values, relative to the largest value of the group in a run."""
    sizes = {group: np.abs(getattr(run, group)).max() or 1.0 for group in one}
    return max(float(np.abs(one[g] - two[g]).max() / size) for g, size in sizes.items())


def _members(trial: Trial) -> Ensemble:
    """Twins in different places, and between them a member with other steps."""
    name = "h" if trial.method.controls == "step" else "rtol"
    values = [getattr(trial.resolution(factor), name) for factor in (1.0, 3.0, 1.0)]
    found = ensemble(trial.scene, trial.method, {name: values}, t_end=trial.t_end)
    for status, message in zip(found.status, found.message, strict=True):
        if status != "ok":
            raise Failed(
                f"A member of a batch on {trial.scene.spec} ends with {status}: {message} Its "
                f"single run does not."
            )
    return found
