"""The checks that every integrator has to pass."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from bench.conformance.audit import check_counts
from bench.conformance.batches import check_batch
from bench.conformance.budgets import check_budget
from bench.conformance.jumps import check_events, check_samples
from bench.conformance.orders import check_order, check_tolerance
from bench.conformance.trials import (
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
from bench.conformance.verdicts import DoesNotApply, Failed, round_trip, shortly
from bench.plugins.registry import Registry
from bench.results.quantities import PARTS
from bench.running.measure import ignored_pattern
from integrators import answers
from integrators.contract import STATUSES, Integrator, Trajectory
from integrators.resolutions import Steps
from problems.answers import FalseAnswer
from problems.initial_values import consistent_start
from problems.spec import SpecError
from problems.system import MechatronicSystem

#: A power of two: adding it to a time loses as few digits as possible.
_SHIFT = 64.0
#: Two steps in turns, by which it is seen whether patterns are followed.
_PATTERN = (0.3, 0.7)
#: Depth to which numbers are looked for in nested results of execute().
_DEEPEST = 4


def check_facts(registry: Registry, method: Integrator) -> str:
    """Its statements on itself are text and whole numbers, and so are its claims on a scene."""
    facts = answers.facts(method)
    scene = trials(registry, method)[0].scene
    answers.checked_orders(method.claims(scene), "claims()")
    return f"It states its formulation, {facts.formulation}, and what it is refined by."


def check_scenes(registry: Registry, method: Integrator) -> str:
    """It takes at least one scene, and refuses others with a reason in one sentence."""
    taken: list[str] = []
    refused: dict[str, list[str]] = {}  # names by reason: many scenes have the same one
    for name, plugin in registry.problems.items():
        if plugin.cls is None:
            continue
        try:
            reason = answers.refusal(method, registry.problem(name))
        except FalseAnswer as fault:
            raise Failed(f"On {name}: {fault}") from fault
        if reason is None:
            taken.append(name)
        else:
            refused.setdefault(reason.rstrip("."), []).append(name)
    told = [f"refuses {', '.join(names)}: {reason}" for reason, names in refused.items()]
    if not taken:
        raise Failed("; ".join(["It takes no scene", *told]))
    return "; ".join([f"It takes {', '.join(taken)}", *told]) + "."


def check_options(registry: Registry, method: Integrator) -> str:
    """Options are read as they are printed."""
    return round_trip(registry.integrator, method)


def check_rows(registry: Registry, method: Integrator) -> str:
    """Rows have the right shapes, start and end exactly, and lie on the grid of steps."""
    tried = trials(registry, method)
    for trial in tried:
        run, scene = trial.measured(), trial.scene
        k, t, (t0, t_end) = len(run.t), run.t, (scene.interval[0], trial.t_end)
        if k < 2 or t[0] != t0 or t[-1] != t_end:
            raise Failed(
                f"Rows on {scene.spec} go from {t[:1]} to {t[-1:]} s; the first has to be at "
                f"{t0!r} and the last at {t_end!r}, to the last digit."
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
        if method.controls == "step" and not len(run.phase):
            _on_the_grid(scene, t, trial.steps)
    return f"Rows are complete and exact in time on {names_of(tried)}."


def _on_the_grid(scene: MechatronicSystem, t: np.ndarray, count: int) -> None:
    length = t[-1] - t[0]
    steps = (t - t[0]) / length * count
    off = np.abs(steps - np.round(steps))
    if off.max() > 1e-6:
        raise Failed(
            f"The row at t={t[off.argmax()]:.9g} s on {scene.spec} is no multiple of the step "
            f"{length / count:.9g} s; report rows at the ends of steps only."
        )


def check_repeats(registry: Registry, method: Integrator) -> str:
    """Two prepared runs give the same bits and the same work."""
    tried = trials(registry, method)
    for trial in tried:
        _same_run(trial.measured(), trial.measured(), f"Two runs on {trial.scene.spec}")
    return f"Two runs are equal to the last bit on {names_of(tried)}."


def _same_run(one: Trajectory, two: Trajectory, what: str) -> None:
    for name in ("t", *TRAJECTORY_GROUPS):
        if not np.array_equal(getattr(one, name), getattr(two, name)):
            raise Failed(f"{what} differ in {name}; seed random numbers and keep no state.")
    if one.work != two.work:
        raise Failed(f"{what} differ in the work counted, {one.work} and {two.work}.")


def check_execute(registry: Registry, method: Integrator) -> str:
    """A timed run gives the same results as a measured one, every time."""
    tried, seen = trials(registry, method), "execute() ends alike"
    for trial in tried:
        run, name = trial.prepared(), trial.scene.spec
        before = trial.trajectory(run)
        results = [run.execute(), run.execute()]
        after = trial.trajectory(run)
        _same_run(before, after, f"measure() before and after execute() on {name}")
        for result in results:
            numbers = np.concatenate([np.zeros(0), *_numbers(result)])
            if not numbers.size:
                seen = "execute() returns no numbers to compare"
                continue
            for value in np.concatenate([before.q[-1], before.v[-1]]):
                if np.abs(numbers - value).min() > 1e-6 * max(1.0, abs(value)):
                    raise Failed(
                        f"measure() on {name} ends with {value:.9g}, but execute() does not "
                        f"return this value; both have to do the same solve."
                    )
    return f"measure() is unchanged by execute(), and {seen}, on {names_of(tried)}."


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


def check_work(registry: Registry, method: Integrator) -> str:
    """Work is counted, grows with the number of steps, and is that of the compiled steps."""
    tried = trials(registry, method)
    pair = (1.0, 2.0) if method.controls == "step" else (0.01, 1.0)
    for trial in tried:
        coarse, fine = (trial.measured(factor).work for factor in pair)
        run, name = trial.prepared(), trial.scene.spec
        answers.checked_bill(run.bill(trial.trajectory(run)), PARTS)
        # A library may tell of Newton's iterations alone.
        told = "residuals" if coarse.residuals is not None or coarse.newton is None else "newton"
        for count in ("steps", told):
            few, many = getattr(coarse, count), getattr(fine, count)
            # Between jumps, few steps may be enough for both.
            same = trial.scene.is_hybrid and few == many
            if few is None or many is None or not (0 < few < many or same):
                raise Failed(
                    f"{count} on {name}: {few} at {trial.words(pair[0])}, {many} at "
                    f"{trial.words(pair[1])}; count {count} where they happen."
                )
        at_events = trial.scene.has("events")  # which cut steps in two
        if method.controls == "step" and coarse.steps != trial.steps and not at_events:
            raise Failed(
                f"{coarse.steps} steps are counted on {name}, {trial.steps} were asked for; count "
                f"each step once."
            )
    audited = [trial for trial in tried if check_counts(method, trial.scene)]
    true = f"; its counts are true on {names_of(audited)}" if audited else ""
    return f"Work is counted and grows with the steps on {names_of(tried)}{true}."


def check_pattern(registry: Registry, method: Integrator) -> str:
    """A step pattern is followed or refused."""
    if method.controls != "step":
        raise DoesNotApply("It chooses its steps.")
    trial, words = trials(registry, method)[0], ",".join(f"{part:g}" for part in _PATTERN)
    name, h = trial.scene.spec, trial.scene.nominal_step
    try:
        varying = trial.solved(Steps(h, _PATTERN))
    except SpecError as refusal:
        return f"Step patterns are refused: {refusal}"
    t0 = trial.scene.interval[0]
    if fault := ignored_pattern(varying, Steps(h, _PATTERN), t0, trial.t_end):
        raise Failed(f"On {name}: {fault}")
    for parts in (1, len(_PATTERN)):
        if np.array_equal(varying.q[-1], trial.solved(Steps(h / parts)).q[-1]):
            raise Failed(
                f"The pattern {words} on {name} ends as steps of {h / parts:g} s do, to the last "
                f"bit; follow resolution.pattern."
            )
    return f"The step pattern {words} is followed on {name}."


def check_start_time(registry: Registry, method: Integrator) -> str:
    """A later start of the scene gives the same motion, later."""
    tried = trials(registry, method)
    allowed = 1e-8 if method.controls == "step" else 100 * TRIAL_RTOL
    for trial in tried:
        later = trial.on(moved(trial.scene, _SHIFT), "with another start")
        here, there = trial.measured(), later.measured()
        for group in ("q", "v"):
            one, two = getattr(here, group)[-1], getattr(there, group)[-1]
            difference = np.abs(one - two).max() / max(1.0, np.abs(one).max())
            if not difference <= allowed:
                raise Failed(
                    f"On {trial.scene.spec} moved by {_SHIFT:g} s {group} ends {difference:.2g} "
                    f"away; begin at scene.interval[0] and give the scene its own time."
                )
    return f"The start may lie at any time on {names_of(tried)}."


# ---- runs that cannot go well ------------------------------------------------------------
def check_empty_interval(registry: Registry, method: Integrator) -> str:
    """An interval of length zero gives one row or a clear refusal."""
    trial = trials(registry, method)[0]
    t0 = trial.scene.interval[0]
    try:
        run = trial.solved(trial.resolution(), t0)
    except Failed:
        raise
    except SpecError as refused:
        return f"An interval of length zero is refused: {refused}"
    except Exception as error:
        raise Failed(
            f"An interval of length zero raises {shortly(error)} Return the start as the only "
            f"row, or raise SpecError with a sentence."
        ) from error
    if run.status != "ok" or len(run.t) != 1 or run.t[0] != t0:
        raise Failed(
            f"An interval of length zero gives the status {run.status} and {len(run.t)} rows; "
            f"return the start as the only row."
        )
    return "An interval of length zero gives the start alone."


def check_nan(registry: Registry, method: Integrator) -> str:
    """A force that is no longer a number ends the run with a status."""
    trial = trials(registry, method)[0]
    at = 0.5 * (trial.scene.interval[0] + trial.t_end)
    wrong = trial.on(spoilt(trial.scene, at), "with another force")
    return _ends_badly(wrong, f"A force that is NaN after t={at:g} s")


def check_blow_up(registry: Registry, method: Integrator) -> str:
    """A solution that ends in finite time ends the run with a status."""
    scene = FiniteTimeBlowUp()
    wrong = Trial(method, scene).on(scene, "whose solution blows up")
    return _ends_badly(wrong, "A solution that is infinite at t=1 s")


def _ends_badly(trial: Trial, what: str) -> str:
    try:
        # Behind the blow-up, however many steps that takes.
        run = trial.solved(trial.resolution(), trial.scene.interval[1])
    except Failed:
        raise
    except Exception as error:
        raise Failed(
            f"{what} raises {shortly(error)} Return the rows so far with a status such as "
            f"diverged, and a message that names the time."
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
    return f"{what} ends with {run.status} at t={time[1]} s."


INTEGRATOR_CHECKS = {
    "facts": check_facts,
    "scenes": check_scenes,
    "options": check_options,
    "rows": check_rows,
    "repeats": check_repeats,
    "execute": check_execute,
    "work": check_work,
    "pattern": check_pattern,
    "start time": check_start_time,
    "batch": check_batch,
    "samples": check_samples,
    "events": check_events,
    "budget": check_budget,
    "empty interval": check_empty_interval,
    "nan": check_nan,
    "blow-up": check_blow_up,
    "order": lambda *of: check_order(order_trials(*of)),
    "tolerance": lambda *of: check_tolerance(trials(*of)),
}
