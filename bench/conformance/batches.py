"""The check of many runs as one program: members are single runs, whatever stands beside them."""

from __future__ import annotations

import re

import numpy as np

from bench.conformance.trials import Trial, names_of, trials
from bench.conformance.verdicts import DoesNotApply, Failed
from bench.plugins.registry import Registry
from bench.sweeps.batch import refuse
from bench.sweeps.ensemble import WORK, Ensemble, ensemble
from integrators.contract import Integrator, Trajectory
from problems.spec import SpecError

#: Members with equal numbers differ by no more, and from their single run, relative to the largest
#: value of the group: places of a block, and a single run, are other instructions, which round in
#: their own way, and Newton's method ends within its tolerance.
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
    tried = tried[:_SCENES]
    if not tried:
        raise DoesNotApply(f"It does not run many members in one program: {reason}")
    twins, single, counts = 0.0, 0.0, set()
    for trial in tried:
        name, run = trial.scene.spec, trial.measured()
        one, again = (_members(trial, 1.0, 3.0, 1.0) for _ in range(2))
        for column, values in one.values.items():
            if not np.array_equal(values, again.values[column]):
                raise Failed(f"{column} of a batch on {name} has other bits when it is run again.")
        # The second twin has another place in the block, the third other neighbours.
        places = (one, 0), (one, 2), (_members(trial, 0.5, 1.0, 2.0), 1)
        for found, k in places:
            counts |= _other_counts(trial, found, k, run)
            ends = _ends(found, k)
            twins = max(twins, _apart(ends, _ends(one, 0), run))
            single = max(single, _apart(ends, {g: getattr(run, g)[-1] for g in ends}, run))
        if not max(twins, single) <= _MOST:
            raise Failed(
                f"A member of a batch on {name} differs from its twin by {twins:.2g}, from its "
                f"single run by {single:.2g} (relative); let a step be a function of its arguments "
                f"alone."
            )
    told = [
        f"equals {whom} {'to the bit' if not by else f'but for {by:.1e}, by rounding'}"
        for whom, by in (("its twins beside others", twins), ("its single run", single))
    ]
    same = "" if "steps" in counts else ", in as many steps"
    more = f"; {', '.join(sorted(counts))} differ a little" if counts else ""
    return (
        f"A batch has the same bits again; a member {' and '.join(told)}{same}{more}, on "
        f"{names_of(tried)}."
    )


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


def _members(trial: Trial, *finer: float) -> Ensemble:
    """Members whose steps or tolerances are so many times finer."""
    step = trial.method.controls == "step"
    refined = [trial.resolution(factor) for factor in finer]
    name = "h" if step else "rtol"
    found = ensemble(
        trial.scene, trial.method, {name: [getattr(r, name) for r in refined]}, t_end=trial.t_end
    )
    for status, message in zip(found.status, found.message, strict=True):
        if status != "ok":
            raise Failed(
                f"A member of a batch on {trial.scene.spec} ends with {status}: {message} Its "
                f"single run does not."
            )
    return found


def _other_counts(trial: Trial, found: Ensemble, k: int, run: Trajectory) -> set[str]:
    """Counts of a member that are not those of its single run; those of equal steps must be."""
    other = set()
    for name, column in found.values.items():
        count = name.removeprefix(WORK)
        wanted = getattr(run.work, count) if name != count else None
        if wanted in (None, column[k]):
            continue
        far = abs(column[k] - wanted) > _COUNTS * wanted
        if far or (count in ("steps", "rejected") and trial.method.controls == "step"):
            raise Failed(
                f"A member of a batch on {trial.scene.spec} counts {column[k]} {count}, its single "
                f"run {wanted}."
            )
        other.add(count)
    return other
