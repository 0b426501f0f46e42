"""The checks that every integrator has to pass."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np

from bench.check.trials import (
    ORDERS_TAG,
    TRIAL_RTOL,
    FiniteTimeBlowUp,
    Trial,
    check_order,
    check_tolerance,
    names_of,
    reference,
    spoilt,
    trials,
)
from bench.check.verdicts import DoesNotApply, Failed, round_trip, shortly
from bench.plugins.registry import Registry
from bench.results.quantities import PARTS
from bench.results.records import counted
from integrators import checks
from integrators.contract import STATUSES, Integrator, PreparedRun, Trajectory
from integrators.resolutions import Steps
from problems.base.checks import FalseAnswer
from problems.base.runtime import jax
from problems.base.spec import SpecError
from problems.equations.initial_values import consistent_start
from problems.hybrid.phases import Samples
from problems.scenes.contacts import BouncingBall
from problems.variables import ROW_GROUPS

#: Times of impact of a method that is exact on parabolas are off by no more, in s; those of others
#: fall by this factor at least where steps are four times as short, or are at most so many times
#: the tolerance.
_ROUNDING = 1e-9
_FALL, _MOST_RTOL = 2.0, 1e3


def check_description(registry: Registry, method: Integrator) -> str:
    """Facts are of the right kind, options are read as printed, scenes are taken or refused."""
    checks.facts(method)
    options = round_trip(registry.integrator, method)
    scenes = check_scenes(registry, method)
    checks.checked_orders(method.claims(trials(registry, method)[0].scene), "claims()")
    return f"{options}; it {scenes}"


def check_scenes(registry: Registry, method: Integrator) -> str:
    """It takes at least one scene, and refuses others with a reason in one sentence."""
    taken: list[str] = []
    refused: dict[str, list[str]] = {}  # names by reason: many scenes have the same one
    for name, plugin in registry.problems.items():
        if plugin.cls is None:
            continue
        try:
            reason = checks.refusal(method, registry.problem(name))
        except FalseAnswer as fault:
            raise Failed(f"On {name}: {fault}") from fault
        (taken if reason is None else refused.setdefault(reason.rstrip("."), [])).append(name)
    told = [f"refuses {', '.join(names)}: {reason}" for reason, names in refused.items()]
    if not taken:
        raise Failed("; ".join(["It takes no scene", *told]))
    return "; ".join([f"takes {counted(len(taken), 'scene')}", *told]) + "."


# ---- runs that go well -------------------------------------------------------------------
def check_runs(registry: Registry, method: Integrator) -> str:
    """Rows, samples, work and bits of runs are right."""
    tried = trials(registry, method)
    for trial in tried:
        one, run = trial.measured(), trial.prepared(trial.resolution())
        _check_rows(trial, one)
        _check_execute(trial, run, one)
        two = trial.trajectory(run)
        for name in ("t", *ROW_GROUPS, "work"):
            if not np.array_equal(getattr(one, name), getattr(two, name)):
                raise Failed(
                    f"Two runs on {trial.scene.spec}, the second after execute(), differ in "
                    f"{name}; seed random numbers and keep no state."
                )
        checks.checked_bill(run.bill(two), PARTS)
        _check_work(trial, one)
    return f"Rows and counts are right, run after run, on {names_of(tried)}."


def _check_rows(trial: Trial, run: Trajectory) -> None:
    """Rows start and end exactly, from the scene's start, and lie on the grid of steps, or at each
    sample of a controller, to the last bit."""
    scene, t, (t0, t_end) = trial.scene, run.t, (trial.scene.interval[0], trial.t_end)
    samples, at = Samples.of(scene), t0
    while samples and (at := samples.following(at)) < t_end:
        if at not in t:
            near = float(t[np.abs(t - at).argmin()])
            raise Failed(
                f"No row on {scene.spec} is at the sample t={at!r} s (the nearest: {near!r}); end "
                f"a run exactly at t_end."
            )
    if len(t) < 2 or t[0] != t0 or t[-1] != t_end:
        raise Failed(
            f"Rows on {scene.spec} go from {t[:1]} to {t[-1:]} s; the first has to be at {t0!r} "
            f"and the last at {t_end!r}, to the last digit."
        )
    start = consistent_start(scene).z
    # A first sample at the start changes forces there.
    for group in ("q", "v", "x", *(() if scene.has("sample") else "a")):
        mine, wanted = getattr(run, group)[0], getattr(start, group)
        if not np.allclose(mine, wanted, rtol=1e-12, atol=1e-12):
            raise Failed(
                f"The first row of {group} on {scene.spec} is {mine}, the scene starts with "
                f"{wanted}; keep the start as the first row."
            )
    if trial.method.controls == "step" and not len(run.phase):
        h = (t_end - t0) / Steps(scene.nominal_step).count(t0, t_end)
        off = np.abs((t - t0) / h - np.round((t - t0) / h))
        if off.max() > 1e-6:
            raise Failed(
                f"The row at t={t[off.argmax()]:.9g} s on {scene.spec} is no multiple of the step "
                f"{h:.9g} s; report rows at the ends of steps only."
            )


def _check_execute(trial: Trial, run: PreparedRun, measured: Trajectory) -> None:
    """A timed run does the same solve as a measured one, where it returns numbers."""
    found: Any = run.execute()
    if isinstance(found, dict) or (hasattr(found, "__dict__") and not hasattr(found, "__array__")):
        found = dict(found if isinstance(found, dict) else vars(found))
    leaves = map(np.asarray, jax.tree.leaves(found))
    numbers = [leaf.ravel() for leaf in leaves if leaf.dtype.kind in "fiu"]
    for value in np.concatenate([measured.q[-1], measured.v[-1]]) if numbers else ():
        if np.abs(np.concatenate(numbers) - value).min() > 1e-6 * max(1.0, abs(value)):
            raise Failed(
                f"measure() on {trial.scene.spec} ends with {value:.9g}, but execute() does not "
                f"return this value; both have to do the same solve."
            )


def _check_work(trial: Trial, run: Trajectory) -> None:
    """Work is counted, and grows with the number of steps."""
    name, step = trial.scene.spec, trial.method.controls == "step"
    low, high = (1.0, 2.0) if step else (0.01, 1.0)
    other = trial.measured(high if step else low).work
    few, many = (run.work, other) if step else (other, run.work)
    # A library may tell of Newton's iterations alone.
    told = "residuals" if few.residuals is not None or few.newton is None else "newton"
    for count in ("steps", told):
        less, more = getattr(few, count), getattr(many, count)
        # Between jumps, few steps may be enough for both.
        same = trial.scene.is_hybrid and less == more
        if less is None or more is None or not (0 < less < more or same):
            raise Failed(
                f"{count} on {name}: {less} at {trial.words(low)}, {more} at {trial.words(high)}; "
                f"count {count} where they happen."
            )
    asked = Steps(trial.scene.nominal_step).count(trial.scene.interval[0], trial.t_end)
    if step and few.steps != asked and not trial.scene.has("events"):  # which cut steps in two
        raise Failed(
            f"{few.steps} steps are counted on {name}, {asked} were asked for; count each once."
        )


class TwiceBouncing(BouncingBall):
    """A ball whose steps are so small, and whose interval so short, that every method ends it."""

    interval = (0.0, 1.3)
    nominal_step = 0.026


def check_events(registry: Registry, method: Integrator) -> str:
    """Events are found, at times that are as accurate as the method."""
    ball = TwiceBouncing()
    if reason := checks.refusal(method, ball) or method.passes_impacts * "its steps pass impacts.":
        raise DoesNotApply(f"It does not find the impacts of a bouncing ball: {reason}")
    trial, off = Trial(method, ball), []
    impacts = reference(ball, trial.t_end).events[:, 0]
    for finer in (1.0, 4.0):
        run = trial.measured(finer)
        if len(run.events) != len(impacts):
            raise Failed(
                f"{len(run.events)} impacts of a ball are found at {trial.words(finer)}, expected "
                f"{len(impacts)}."
            )
        off.append(float(np.abs(run.events[:, 0] - impacts).max()))
    most = off[0] / _FALL if method.controls == "step" else _MOST_RTOL * TRIAL_RTOL / 4
    allowed = max(_ROUNDING, most)
    if not off[1] <= allowed:
        raise Failed(
            f"Times of impact of a ball are off by {off[0]:.2g} s at {trial.words(1.0)}, by "
            f"{off[1]:.2g} s at {trial.words(4.0)}; expected at most {allowed:.2g} s."
        )
    return f"All impacts of a ball are found, off by {off[1]:.1e} s at {trial.words(4.0)}."


# ---- runs that cannot go well ------------------------------------------------------------
def check_endings(registry: Registry, method: Integrator) -> str:
    """A force that turns NaN and a blow-up end with a status and a time."""
    first, told = trials(registry, method)[0], []
    at = 0.5 * (first.scene.interval[0] + first.t_end)
    nan = first.scene.with_parameters({}, spoilt(type(first.scene), at))
    for scene, what in (
        (nan, f"A force that is NaN after t={at:g} s"),
        (FiniteTimeBlowUp(), "A solution that is infinite at t=1 s"),
    ):
        if checks.refusal(method, scene):
            continue
        trial = Trial(method, scene, scene.interval[1])
        try:  # behind the blow-up, however many steps that takes
            run = trial.trajectory(trial.prepared(trial.resolution()))
        except (Failed, SpecError):
            raise
        except Exception as error:
            raise Failed(
                f"{what} raises {shortly(error)} Return the rows so far with a status such as "
                f"diverged, and a message with the time."
            ) from error
        if run.status == "ok":
            raise Failed(
                f"{what} ends with the status {run.status!r}; look at the values of every step and "
                f"end with one of {', '.join(STATUSES[1:5])}."
            )
        time = re.search(r"\bt ?= ?([-+.\deE]*\d)", run.message)
        if not time or not math.isfinite(float(time[1])):
            raise Failed(
                f"{what} ends with {run.status} and the message {run.message!r}; name the time, as "
                f"in 'diverged at t=0.5 s'."
            )
        told.append(f"{what} ends with {run.status} at t={time[1]} s")
    return f"{'; '.join(told)}."


INTEGRATOR_CHECKS = {
    "description": check_description,
    "runs": check_runs,
    "events": check_events,
    "endings": check_endings,
    "order": lambda *of: check_order(trials(*of, ORDERS_TAG)),
    "tolerance": lambda *of: check_tolerance(trials(*of)),
}
