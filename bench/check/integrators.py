"""The checks that every integrator has to pass."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from bench.check.batch import check_batch
from bench.check.counts import check_counts
from bench.check.jumps import check_events, check_samples
from bench.check.orders import check_order, check_tolerance
from bench.check.trials import (
    TRAJECTORY_GROUPS,
    TRIAL_RTOL,
    FiniteTimeBlowUp,
    Trial,
    moved,
    names_of,
    order_trials,
    spoilt,
    trials,
)
from bench.check.verdicts import Failed, round_trip, shortly
from bench.plugins.registry import Registry
from bench.results.quantities import PARTS
from bench.running.measure import ignored_pattern
from integrators import checks
from integrators.contract import STATUSES, Integrator, PreparedRun, Trajectory
from integrators.resolutions import Steps
from problems.checks import FalseAnswer
from problems.initial_values import consistent_start
from problems.spec import SpecError

#: A power of two: adding it to a time loses as few digits as possible.
_SHIFT = 64.0
#: Two steps in turns, by which it is seen whether patterns are followed.
_PATTERN = (0.3, 0.7)
#: Depth to which numbers are looked for in nested results of execute().
_DEEPEST = 4


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
    return "; ".join([f"takes {', '.join(taken)}", *told]) + "."


# ---- runs that go well -------------------------------------------------------------------
def check_runs(registry: Registry, method: Integrator) -> str:
    """Rows, samples, work and bits of runs are right, whatever is run in between."""
    tried, audited, compared = trials(registry, method), [], True
    for trial in tried:
        one, run, name = trial.measured(), trial.prepared(), trial.scene.spec
        check_samples(trial, one)
        _check_rows(trial, one)
        two = trial.trajectory(run)
        same_run(one, two, f"Two runs on {name}")
        compared &= _check_execute(name, run, two)
        three = trial.trajectory(run)
        same_run(two, three, f"measure() before and after execute() on {name}")
        checks.checked_bill(run.bill(three), PARTS)
        _check_work(trial, one)
        audited += [trial] * check_counts(method, trial.scene)
    true = f", true on {names_of(audited)}" if audited else ""
    numbers = "" if compared else "; execute() returns no numbers to compare"
    return f"Rows, bits and counts are right{true}, on {names_of(tried)}{numbers}."


def _check_rows(trial: Trial, run: Trajectory) -> None:
    """Rows start and end exactly, from the scene's start, and lie on the grid of steps."""
    scene, t, (t0, t_end) = trial.scene, run.t, (trial.scene.interval[0], trial.t_end)
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


def same_run(one: Trajectory, two: Trajectory, what: str) -> None:
    """Raise ``Failed`` if two runs do not have the same bits and the same work."""
    for name in ("t", *TRAJECTORY_GROUPS):
        if not np.array_equal(getattr(one, name), getattr(two, name)):
            raise Failed(f"{what} differ in {name}; seed random numbers and keep no state.")
    if one.work != two.work:
        raise Failed(f"{what} differ in the work counted, {one.work} and {two.work}.")


def _check_execute(name: str, run: PreparedRun, measured: Trajectory) -> bool:
    """A timed run does the same solve as a measured one; whether it returns numbers."""
    results = [np.concatenate([np.zeros(0), *_numbers(run.execute())]) for _ in range(2)]
    for numbers in filter(np.size, results):
        for value in np.concatenate([measured.q[-1], measured.v[-1]]):
            if np.abs(numbers - value).min() > 1e-6 * max(1.0, abs(value)):
                raise Failed(
                    f"measure() on {name} ends with {value:.9g}, but execute() does not return "
                    f"this value; both have to do the same solve."
                )
    return all(map(np.size, results))


def _numbers(value: Any, depth: int = 0) -> Iterator[np.ndarray]:
    """Yield all numbers in a result of execute(), which may be anything."""
    if hasattr(value, "__array__") or isinstance(value, int | float):
        array = np.asarray(value)
        if array.dtype.kind in "fiu":
            yield array.ravel().astype(float)
        return
    if isinstance(value, dict) or hasattr(value, "__dict__"):
        value = list((value if isinstance(value, dict) else vars(value)).values())
    if isinstance(value, list | tuple) and depth < _DEEPEST:
        for part in value:
            yield from _numbers(part, depth + 1)


def _check_work(trial: Trial, run: Trajectory) -> None:
    """Work is counted, and grows with the number of steps."""
    name, step = trial.scene.spec, trial.method.controls == "step"
    (low, few), (high, many) = (1.0, run.work), (2.0, None)
    if not step:
        (low, few), (high, many) = (0.01, None), (1.0, run.work)
    few, many = few or trial.measured(low).work, many or trial.measured(high).work
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


def check_steps(registry: Registry, method: Integrator) -> str:
    """A step pattern is followed or refused, and a scene may start at any time."""
    tried = trials(registry, method)
    pattern = _follows(tried[0]) if method.controls == "step" else "It chooses its steps"
    allowed, later = 1e-8 if method.controls == "step" else 100 * TRIAL_RTOL, []
    for trial in tried:
        shifted = moved(trial.scene, _SHIFT)
        if checks.refusal(method, shifted):
            continue
        here, there = trial.measured(), Trial(method, shifted).measured()
        for group in ("q", "v"):
            one, two = getattr(here, group)[-1], getattr(there, group)[-1]
            difference = np.abs(one - two).max() / max(1.0, np.abs(one).max())
            if not difference <= allowed:
                raise Failed(
                    f"On {trial.scene.spec} moved by {_SHIFT:g} s {group} ends {difference:.2g} "
                    f"away; begin at scene.interval[0] and give the scene its own time."
                )
        later.append(trial)
    return f"{pattern}; the start may lie at any time on {names_of(later) or 'no trial scene'}."


def _follows(trial: Trial) -> str:
    """Check that a step pattern is followed, or refused by SpecError."""
    name, h, t0 = trial.scene.spec, trial.scene.nominal_step, trial.scene.interval[0]
    try:
        varying = trial.solved(Steps(h, _PATTERN))
    except SpecError as refusal:
        return f"Step patterns are refused: {str(refusal).rstrip('.')}"
    if fault := ignored_pattern(varying, Steps(h, _PATTERN), t0, trial.t_end):
        raise Failed(f"On {name}: {fault}")
    for parts in (1, len(_PATTERN)):
        if np.array_equal(varying.q[-1], trial.solved(Steps(h / parts)).q[-1]):
            raise Failed(
                f"A step pattern on {name} ends as steps of {h / parts:g} s do, to the last bit; "
                f"follow resolution.pattern."
            )
    return f"A step pattern is followed on {name}"


# ---- runs that cannot go well ------------------------------------------------------------
def check_endings(registry: Registry, method: Integrator) -> str:
    """An empty interval, a force that turns NaN and a blow-up end with a status and a time."""
    trial = trials(registry, method)[0]
    told = [_empty(trial)]
    at = 0.5 * (trial.scene.interval[0] + trial.t_end)
    for scene, what in (
        (spoilt(trial.scene, at), f"a force that is NaN after t={at:g} s"),
        (FiniteTimeBlowUp(), "a solution that is infinite at t=1 s"),
    ):
        if checks.refusal(method, scene) is None:
            told.append(_ends_badly(Trial(method, scene), what))
    return f"{'; '.join(told)}."


def _empty(trial: Trial) -> str:
    what, t0 = "An interval of length zero", trial.scene.interval[0]
    try:
        run = _run(trial, t0, what, "Return the start as the only row, or raise SpecError.")
    except SpecError as refused:
        return f"{what} is refused: {str(refused).rstrip('.')}"
    if run.status != "ok" or len(run.t) != 1 or run.t[0] != t0:
        raise Failed(
            f"{what} gives the status {run.status} and {len(run.t)} rows; return the start as the "
            f"only row."
        )
    return f"{what} gives the start alone"


def _ends_badly(trial: Trial, what: str) -> str:
    # Behind the blow-up, however many steps that takes.
    advice = "Return the rows so far with a status such as diverged, and a message with the time."
    run = _run(trial, trial.scene.interval[1], f"{what[0].upper()}{what[1:]}", advice)
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
    return f"{what} ends with {run.status} at t={time[1]} s"


def _run(trial: Trial, t_end: float, what: str, advice: str) -> Trajectory:
    """A run that may end badly or be refused, but not raise another exception."""
    try:
        return trial.solved(trial.resolution(), t_end)
    except (Failed, SpecError):
        raise
    except Exception as error:
        raise Failed(f"{what} raises {shortly(error)} {advice}") from error


INTEGRATOR_CHECKS = {
    "description": check_description,
    "runs": check_runs,
    "steps": check_steps,
    "batch": check_batch,
    "events": check_events,
    "endings": check_endings,
    "order": lambda *of: check_order(order_trials(*of)),
    "tolerance": lambda *of: check_tolerance(trials(*of)),
}
