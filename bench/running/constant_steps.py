"""Studies at constant steps: what drifts off in long runs, and runs at a fixed rate, as in real
time, in which the host calls one compiled step for each tick."""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import InitVar, dataclass

import numpy as np

from bench.results.studies import Drift, LongRun
from bench.results.table import NO_VALUE, Table, number
from bench.running import measure
from bench.running.errors import finite, relative_errors
from bench.running.inventory import SceneFacts
from bench.running.plan import Cell
from bench.running.worker import Worker
from integrators import checks
from integrators.advice import advice
from integrators.contract import Integrator
from integrators.native.loops.constant_steps import SingleStep
from integrators.native.step_method import NativeMethod
from integrators.resolutions import Steps, check_end
from problems.base.runtime import Array, Float
from problems.base.spec import SpecError
from problems.system import MechatronicSystem

#: Parts of a run of which a chart shows least and largest values.
_PARTS = 200


def drift_job(
    worker: Worker, problem: str, integrator: str, h: float | None, steps: int
) -> LongRun:
    """Run an integrator over many steps h (s; the scene's nominal one if None), and measure what
    drifts: `measure.invariant_changes`, and the largest residuals of the constraints and of their
    rates, as "position" and "velocity". The rows of a run are some thousands, however many steps.

    Raises
    ------
    SpecError
        If the integrator chooses its own steps, or the step is not allowed.
    """
    scene = worker.problem(problem)
    method = worker.registry.integrator(integrator)
    constant = method.at_constant_steps()
    if constant is None:
        raise SpecError(
            f"{method.spec} chooses its own steps, and drift is measured at constant ones; name "
            f"a method with constant steps."
        )
    resolution = Steps(scene.nominal_step if h is None else h)
    t_end = check_end(scene.interval[0], scene.interval[0] + steps * resolution.h)
    facts = worker.inventory.problem(problem), worker.inventory.integrator(constant.spec)
    run, _ = worker.run(Cell(*facts, t_end, resolution))
    reference = None
    with suppress(Exception):  # its integration failed, or the closed form is false
        if (found := worker.reference(scene, scene.interval[1])) and not found.missing:
            reference = found
    if reference and run.status == "ok":
        changes = measure.invariant_changes(scene, run, reference)
        measure.end_at_blow_up(run, reference, changes)
    drifts = {}
    if len(run.t) > 2:
        violations = measure.violations(scene, run)
        violations.pop("acceleration", None)
        drifts = measure.invariant_changes(scene, run, reference) | violations
    return LongRun(
        problem=scene.spec,
        integrator=constant.spec,
        status=run.status,
        message=run.message,
        asked=steps,
        steps=run.work.steps,
        h=resolution.h,
        t_end=float(run.t[-1]) if len(run.t) else None,
        rows=len(run.t),
        t=[float(part[-1]) for part in _parts(run.t)] if drifts else [],
        drifts={name: course(run.t, values) for name, values in drifts.items()},
    )


def course(t: Float[np.ndarray, " k"], values: Float[np.ndarray, " k"]) -> Drift:
    """Describe the course of a quantity, measured at k times in s: its trend and its bands."""
    slope, start = np.polyfit(t - t[0], values, 1)
    left, whole = np.var(values - start - slope * (t - t[0])), np.var(values)
    halves = [_band(half) for half in np.array_split(values, 2)]
    low, high = _band(values)
    distance = np.abs(np.subtract(*halves)).max()
    parts = _parts(values)
    return Drift(
        largest=finite(float(values[np.abs(values).argmax()])),
        per_s=finite(slope),
        straight=finite(float(1 - left / whole)) if whole > 0 else None,
        apart=finite(float(distance / (high - low))) if high > low else 0.0,
        least=[finite(part.min()) for part in parts],
        most=[finite(part.max()) for part in parts],
    )


def _band(values: Float[np.ndarray, " k"]) -> Float[np.ndarray, " 2"]:
    """Ends of the band that holds 90 % of the values."""
    return np.percentile(values, (5, 95))


def _parts(rows: Float[np.ndarray, " k"]) -> list[Float[np.ndarray, " part"]]:
    return np.array_split(rows, min(_PARTS, len(rows)))


# ---- a fixed rate ------------------------------------------------------------------------
#: Steps before the clock is read.
_WARM_UP = 200
#: Most steps of a run: its states are kept.
MOST_STEPS = 1_000_000
#: Part of the steps that may be late where a method is said to hold a rate.
LATE = 1e-3
#: Errors that are apart by less than this factor are equal; the faster method is named then.
_EQUAL = 1.1
#: Groups whose errors decide, and are columns.
_GROUPS = ("q", "v", "a", "lam")
_LEVELS = {"position": "|Phi|", "velocity": "|dPhi/dt|"}
_TIMES = (
    "This machine is no real-time system: its scheduler, its load and its clock frequency are in "
    "the 99.9 % and the worst, so that no number here is a bound; repeat the command on the target."
)
_ERRORS = (
    "Errors: the largest over all steps, relative to the size of the component. |Phi| and "
    "|dPhi/dt|: the largest residual of any constraint, in its unit. Unconverged: part of the "
    "steps that went on when Newton's method had not converged."
)


@dataclass
class RealTimeRun:
    """A run at ``rate`` (Hz) over ``asked`` steps, of which ``steps`` have a result.

    ``iterations`` is the limit in each call of Newton's method: "none" for a method without any,
    "unlimited" for its own limit, beyond which a step has failed. ``unconverged`` counts the steps
    that went on without convergence, ``missed`` those that took longer than 1/rate; times of steps
    are in µs. ``errors`` are the largest ones by group, relative; ``constraint`` has the largest
    residuals at "position" and "velocity" level. A run that failed has neither.
    """

    problem: str
    integrator: str
    iterations: str
    rate: float
    asked: int
    steps: int
    status: str
    message: str
    unconverged: int
    errors: dict[str, float | None]
    constraint: dict[str, float | None]
    seconds: InitVar[Float[np.ndarray, " k"]]
    median_us: float = 0.0
    p999_us: float = 0.0
    worst_us: float = 0.0
    missed: int = 0

    def __post_init__(self, seconds: Float[np.ndarray, " k"]) -> None:
        quantiles = (np.quantile(seconds, [0.5, 0.999, 1.0]) * 1e6).tolist()
        self.median_us, self.p999_us, self.worst_us = quantiles
        self.missed = int((seconds > 1 / self.rate).sum())

    @property
    def error(self) -> float:
        """Return the largest of the errors of q, v, a and lam; infinite if one is not known."""
        known = [self.errors[group] for group in _GROUPS if group in self.errors]
        return max((math.inf if e is None else e for e in known), default=math.inf)

    @property
    def name(self) -> str:
        """Return the method with its limit, for a sentence."""
        limit = "" if self.iterations == "none" else f" (iterations: {self.iterations})"
        return self.integrator + limit


def steps_of(scene: SceneFacts, rate: float, duration: float | None) -> int:
    """Return the number of steps at ``rate`` (Hz) over ``duration`` (s), or the scene's interval.

    Raises
    ------
    SpecError
        If there is no reference over so long a time, or the number of steps is not allowed.
    """
    length = scene.interval[1] - scene.interval[0]
    duration = length if duration is None else duration
    steps = duration * rate * (1 + 1e-9)
    if not (0 < duration <= length * (1 + 1e-9) and 2 <= steps < MOST_STEPS + 1):
        raise SpecError(
            f"{rate:g} Hz over {duration:g} s is not allowed; give a rate and a duration that make "
            f"from 2 to {MOST_STEPS} steps, in at most {length:g} s, the interval of {scene.spec}, "
            f"where the reference is known."
        )
    return math.floor(steps)


def realtime_tables(runs: Sequence[RealTimeRun]) -> list[Table]:
    """Return tables of times, and of errors and residuals, with a row for each run."""
    groups = [g for g in _GROUPS if any(g in run.errors for run in runs)]
    levels = [level for level in _LEVELS if any(level in run.constraint for run in runs)]
    times, errors = [], []
    for run in runs:
        named, steps = [run.integrator, run.iterations], run.steps or 1
        late = f"{run.missed} ({100 * run.missed / steps:.3g} %)"
        times.append([*named, *map(number, (run.median_us, run.p999_us, run.worst_us)), late])
        values = [*map(run.errors.get, groups), *map(run.constraint.get, levels)]
        part = NO_VALUE if run.iterations == "none" else f"{run.unconverged / steps:.0%}"
        ended = run.status if run.status == "ok" else f"{run.status}, step {run.steps + 1}"
        errors.append([*named, *map(number, values), part, ended])
    head, first = ["method", "iterations"], runs[0]
    title = f"{first.problem} at {first.rate:g} Hz, {first.asked} steps: time per step in µs"
    columns = [*head, *groups, *(_LEVELS[level] for level in levels), "unconverged", "ended"]
    return [
        Table(title, [*head, "median", "99.9 %", "worst", "missed"], times, note=_TIMES),
        Table("Errors and residuals", columns, errors, note=_ERRORS),
    ]


def realtime_sentence(runs: Sequence[RealTimeRun]) -> str:
    """Say which run holds the rate with the least error; of equal errors it is the fastest."""
    rate = f"{runs[0].rate:g} Hz on {runs[0].problem}"
    able = [r for r in runs if r.status == "ok" and r.missed <= LATE * r.steps]
    if not able:
        return f"None holds {rate} to the end with at most {LATE:.1%} late steps."
    near = [run for run in able if run.error <= _EQUAL * min(run.error for run in able)]
    best = min(near, key=lambda run: run.median_us)
    others = f"; {len(near) - 1} more have the same" if len(near) > 1 else ""
    least = f"the least error in q, v, a and lam ({number(best.error)}{others})"
    least = "the shortest steps (no errors are known)" if math.isinf(best.error) else least
    return (
        f"{len(able)} of {len(runs)} hold {rate}, with at most {LATE:.1%} late steps; of these "
        f"{best.name} has {least}, at {number(best.median_us)} µs a step."
    )


# ---- in the process that runs ------------------------------------------------------------
def realtime_job(
    worker: Worker, problem: str, integrator: str, rate: float, steps: int, limit: int | None
) -> list[RealTimeRun]:
    """Run a method for a number of steps of 1/rate (Hz), and measure each step.

    ``limit`` is that of the iterations in each call of Newton's method; None for two runs, with one
    iteration and with as many as the method takes, or the latter alone if it keeps tangents.

    Raises
    ------
    SpecError
        If the method does not take the scene, or its step cannot be called alone or limited.
    """
    scene = worker.problem(problem)
    method = stepping(worker.registry.integrator(integrator), scene)
    reference = worker.reference(scene, scene.interval[0] + steps / rate)
    program = method.program(scene)
    own, limits = SingleStep(*program, scene, 1 / rate, steps), [limit]
    if not own.iterates:
        limits = [None]
    elif limit and own.keeps_tangents:
        raise SpecError(
            f"{method.spec} keeps tangents over steps, by which few iterations are too few; give "
            f"newton=full, or no limit of iterations."
        )
    elif limit is None and not own.keeps_tangents:
        limits = [1, None]
    runs = []
    for most in limits:
        step = SingleStep(*program, scene, 1 / rate, steps, most) if most else own
        seconds, states = timed(step, steps)
        (run, unconverged), errors, constraint = step.run(states), {}, {}
        if run.status == "ok" and not reference.missing:
            changes = measure.invariant_changes(scene, run, reference, ["energy"])
            measure.end_at_blow_up(run, reference, changes)
        done = len(run.t) - 1
        if run.status == "ok":
            violations = measure.violations(scene, run)
            constraint = {k: finite(v.max()) for k, v in violations.items() if k != "acceleration"}
            table = {} if reference.missing else relative_errors(run, reference).errors
            errors = {name: e["max"] for name, e in table.items() if name[0] != "|"}
        runs.append(
            RealTimeRun(
                problem=scene.spec,
                integrator=method.spec,
                iterations=str(most or "unlimited") if own.iterates else "none",
                rate=rate,
                asked=steps,
                steps=done,
                status=run.status,
                message=run.message or reference.missing,
                unconverged=min(unconverged, done),
                errors=errors,
                constraint=constraint,
                seconds=seconds[: max(done, 1)],
            )
        )
    return runs


def stepping(method: Integrator, scene: MechatronicSystem) -> NativeMethod:
    """Return a method at constant steps whose step is a function of a state.

    Raises
    ------
    SpecError
        If there is none, or it does not take the scene.
    """
    if reason := checks.refusal(method, scene):
        raise SpecError(f"{method.spec} does not take {scene.spec}: {reason}")
    if scene.is_hybrid:
        raise SpecError(
            f"Values of {scene.spec} jump at samples or events, which no step that is called alone "
            f"can follow; take a scene without, such as quarter_car."
        )
    constant = method.at_constant_steps()
    if not isinstance(constant, NativeMethod):
        lacks = "it chooses its own steps" if constant is None else "a library holds its time loop"
        raise SpecError(
            f"{method.spec} has no step of constant size that can be called alone: "
            f"{lacks}{advice(scene, 'linearly_implicit_euler', 'generalized_alpha', 'ali3p')}."
        )
    return constant


def timed(step: SingleStep, steps: int) -> tuple[Float[np.ndarray, " k"], list[Array]]:
    """Take k steps from the start; return the time of each in s, and the state after it.

    A step is timed from its call to its result, without garbage collection.
    """
    seconds, states = np.zeros(steps), []
    collects = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        for count in (min(_WARM_UP, steps), steps):
            state, states = step.first, []
            for n in range(count):
                begun = time.perf_counter_ns()
                state = step(state).block_until_ready()
                seconds[n] = (time.perf_counter_ns() - begun) * 1e-9
                states.append(state)
    finally:
        if collects:
            gc.enable()
    return seconds, states
