"""The checks that every integrator has to pass."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from bench.conformance.audit import check_counts
from bench.conformance.endings import check_blow_up, check_empty_interval, check_nan
from bench.conformance.orders import check_order, check_tolerance
from bench.conformance.trials import (
    GROUPS,
    TRIAL_RTOL,
    measured,
    moved,
    must_take,
    names_of,
    order_trials,
    prepared,
    solved,
    step_count,
    trajectory,
    trial_end,
    trials,
    words,
)
from bench.conformance.verdicts import DoesNotApply, Failed, round_trip
from bench.plugins.registry import Registry
from bench.results.quantities import PARTS
from bench.running.measure import ignored_pattern
from integrators import answers
from integrators.contract import Integrator, Steps, Trajectory
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
    scene = trials(registry, method)[0]
    answers.orders(method.claims(scene), "claims()")
    return f"It states its formulation, {facts.formulation}, and what it is refined by."


def check_scenes(registry: Registry, method: Integrator) -> str:
    """It takes at least one scene, and refuses others with a reason in one sentence."""
    taken, refused = [], []
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
            refused.append(f"refuses {name}: {reason}")
    if not taken:
        raise Failed("; ".join(["It takes no scene", *refused]))
    return "; ".join([f"It takes {', '.join(taken)}", *refused]).rstrip(".") + "."


def check_options(registry: Registry, method: Integrator) -> str:
    """Options are read as they are printed."""
    return round_trip(registry.integrator, method)


def check_rows(registry: Registry, method: Integrator) -> str:
    """Rows have the right shapes, start and end exactly, and lie on the grid of steps."""
    scenes = trials(registry, method)
    for scene in scenes:
        run, (t0, t_end) = measured(method, scene), (scene.interval[0], trial_end(scene))
        k, t = len(run.t), run.t
        if k < 2 or t[0] != t0 or t[-1] != t_end:
            raise Failed(
                f"Rows on {scene.spec} go from {t[:1]} to {t[-1:]} s; the first has to be at "
                f"{t0!r} and the last at {t_end!r}, to the last digit."
            )
        start = consistent_start(scene).z
        for group in ("q", "v", "x", "a"):
            mine, wanted = getattr(run, group)[0], getattr(start, group)
            if not np.allclose(mine, wanted, rtol=1e-12, atol=1e-12):
                raise Failed(
                    f"The first row of {group} on {scene.spec} is {mine}, the scene starts with "
                    f"{wanted}; keep the start as the first row."
                )
        if method.controls == "step":
            _on_the_grid(scene, t, step_count(scene))
    return f"Rows are complete and exact in time on {names_of(scenes)}."


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
    scenes = trials(registry, method)
    for scene in scenes:
        _same_run(measured(method, scene), measured(method, scene), f"Two runs on {scene.spec}")
    return f"Two runs are equal to the last bit on {names_of(scenes)}."


def _same_run(one: Trajectory, two: Trajectory, what: str) -> None:
    for name in ("t", *GROUPS):
        if not np.array_equal(getattr(one, name), getattr(two, name)):
            raise Failed(f"{what} differ in {name}; seed random numbers and keep no state.")
    if one.work != two.work:
        raise Failed(f"{what} differ in the work counted, {one.work} and {two.work}.")


def check_execute(registry: Registry, method: Integrator) -> str:
    """A timed run gives the same results as a measured one, every time."""
    scenes, silent = trials(registry, method), []
    for scene in scenes:
        run = prepared(method, scene)
        before = trajectory(run, scene, trial_end(scene))
        results = [run.execute(), run.execute()]
        after = trajectory(run, scene, trial_end(scene))
        _same_run(before, after, f"measure() before and after execute() on {scene.spec}")
        for result in results:
            numbers = np.concatenate([np.zeros(0), *_numbers(result)])
            if not numbers.size:
                silent = [scene]
                continue
            for value in np.concatenate([before.q[-1], before.v[-1]]):
                if np.abs(numbers - value).min() > 1e-6 * max(1.0, abs(value)):
                    raise Failed(
                        f"measure() on {scene.spec} ends with {value:.9g}, but execute() does not "
                        f"return this value; both have to do the same solve."
                    )
    seen = "execute() returns no numbers to compare" if silent else "execute() ends alike"
    return f"measure() is unchanged by execute(), and {seen}, on {names_of(scenes)}."


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
    scenes = trials(registry, method)
    pair = (1.0, 2.0) if method.controls == "step" else (0.01, 1.0)
    for scene in scenes:
        coarse, fine = (measured(method, scene, factor).work for factor in pair)
        run = prepared(method, scene)
        answers.bill(run.bill(trajectory(run, scene, trial_end(scene))), PARTS)
        # A library may tell of Newton's iterations alone.
        told = "residuals" if coarse.residuals is not None or coarse.newton is None else "newton"
        for name in ("steps", told):
            few, many = getattr(coarse, name), getattr(fine, name)
            if few is None or many is None or not 0 < few < many:
                raise Failed(
                    f"{name} on {scene.spec}: {few} at {words(method, scene, pair[0])}, "
                    f"{many} at {words(method, scene, pair[1])}; count {name} where they happen."
                )
        if method.controls == "step" and coarse.steps != step_count(scene):
            raise Failed(
                f"{coarse.steps} steps are counted on {scene.spec}, {step_count(scene)} were "
                f"asked for; count each step once."
            )
    audited = [scene for scene in scenes if check_counts(method, scene)]
    true = f"; its counts are true on {names_of(audited)}" if audited else ""
    return f"Work is counted and grows with the steps on {names_of(scenes)}{true}."


def check_pattern(registry: Registry, method: Integrator) -> str:
    """A step pattern is followed or refused."""
    if method.controls != "step":
        raise DoesNotApply("It chooses its steps.")
    scene, words = trials(registry, method)[0], ",".join(f"{part:g}" for part in _PATTERN)
    steps = Steps(scene.nominal_step, _PATTERN)

    def run(steps: Steps) -> Trajectory:
        return solved(method, scene, trial_end(scene), steps)

    try:
        varying = run(steps)
    except SpecError as refusal:
        return f"Step patterns are refused: {refusal}"
    if fault := ignored_pattern(varying, steps, scene.interval[0], trial_end(scene)):
        raise Failed(f"On {scene.spec}: {fault}")
    for parts in (1, len(_PATTERN)):
        constant = run(Steps(scene.nominal_step / parts))
        if np.array_equal(varying.q[-1], constant.q[-1]):
            raise Failed(
                f"The pattern {words} on {scene.spec} ends as steps of "
                f"{scene.nominal_step / parts:g} s do, to the last bit; follow resolution.pattern."
            )
    return f"The step pattern {words} is followed on {scene.spec}."


def check_start_time(registry: Registry, method: Integrator) -> str:
    """A later start of the scene gives the same motion, later."""
    scenes = trials(registry, method)
    allowed = 1e-8 if method.controls == "step" else 100 * TRIAL_RTOL
    for scene in scenes:
        must_take(method, moved(scene, _SHIFT), "with another start")
        here, there = measured(method, scene), measured(method, moved(scene, _SHIFT))
        for group in ("q", "v"):
            one, two = getattr(here, group)[-1], getattr(there, group)[-1]
            difference = np.abs(one - two).max() / max(1.0, np.abs(one).max())
            if not difference <= allowed:
                raise Failed(
                    f"On {scene.spec} moved by {_SHIFT:g} s {group} ends {difference:.2g} away; "
                    f"begin at scene.interval[0] and give the scene its own time."
                )
    return f"The start may lie at any time on {names_of(scenes)}."


def _with_ends(scenes: list[MechatronicSystem]) -> list[tuple[MechatronicSystem, float]]:
    return [(scene, trial_end(scene)) for scene in scenes]


CHECKS = {
    "facts": check_facts,
    "scenes": check_scenes,
    "options": check_options,
    "rows": check_rows,
    "repeats": check_repeats,
    "execute": check_execute,
    "work": check_work,
    "pattern": check_pattern,
    "start time": check_start_time,
    "empty interval": check_empty_interval,
    "nan": check_nan,
    "blow-up": check_blow_up,
    "order": lambda *of: check_order(of[1], _with_ends(order_trials(*of))),
    "tolerance": lambda *of: check_tolerance(of[1], _with_ends(trials(*of))),
}
