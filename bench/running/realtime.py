"""Runs at a fixed rate, as in real time: the host calls one compiled step for each tick."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable

import numpy as np

from bench.results.realtime import RealTimeRun, StepTimes
from bench.running import measure
from bench.running.errors import finite, relative_errors
from bench.running.worker import Worker
from integrators import checks
from integrators.advice import advice
from integrators.contract import Integrator, Trajectory
from integrators.native.lone_steps import LoneStep
from integrators.native.step_method import NativeMethod
from problems.reference import Reference
from problems.runtime import Array, Float, jax
from problems.spec import SpecError
from problems.system import MechatronicSystem

#: Steps before the clock is read.
_WARM_UP = 200
#: Calls that do nothing, by which the cost of a call is measured.
_IDLE = 500


def realtime_job(
    worker: Worker, problem: str, integrator: str, rate: float, steps: int, limit: int | None
) -> list[RealTimeRun]:
    """Run a method for a number of steps of 1/rate, and measure each step.

    Parameters
    ----------
    problem, integrator
        Names with options.
    rate
        Steps per s.
    limit
        Most iterations in each call of Newton's method; None for two runs, with one iteration and
        with as many as the method takes.

    Raises
    ------
    SpecError
        If the method does not take the scene, or its step cannot be called alone.
    """
    scene = worker.problem(problem)
    method = stepping(worker.registry.integrator(integrator), scene)
    own = LoneStep(method, scene, 1 / rate, steps)
    runs = {"unlimited" if own.iterates else "none": own}
    if own.iterates:
        few = {str(limit or 1): LoneStep(method, scene, 1 / rate, steps, limit or 1)}
        runs = few if limit else few | runs
    idle, _ = timed(jax.jit(lambda state: state + 0.0), own.first, _IDLE)
    reference = worker.reference(scene, scene.interval[0] + steps / rate)
    found = []
    for iterations, step in runs.items():
        seconds, states = timed(step, step.first, steps)
        run, unconverged = step.run(states)
        errors = errors_of(scene, run, reference)
        done = len(run.t) - 1
        found.append(
            RealTimeRun(
                problem=scene.spec,
                integrator=method.spec,
                iterations=iterations,
                rate=rate,
                asked=steps,
                steps=done,
                status=run.status,
                message=run.message or reference.missing,
                unconverged=min(unconverged, done),
                times=StepTimes.of(seconds[: max(done, 1)], 1 / rate),
                idle_us=float(np.median(idle)) * 1e6,
                errors=errors,
                constraint=residuals(scene, run) if run.status == "ok" else {},
            )
        )
    return found


def errors_of(
    scene: MechatronicSystem, run: Trajectory, reference: Reference, norm: str = "max"
) -> dict[str, float | None]:
    """Return the errors of a run by group, none if it failed or blew up, which ends it."""
    if reference.missing or run.status != "ok":
        return {}
    changes = measure.invariant_changes(scene, run, reference, ["energy"])
    measure.end_at_blow_up(run, reference, changes)
    if run.status != "ok":
        return {}
    table = relative_errors(run, reference).errors
    return {name: norms[norm] for name, norms in table.items() if name[0] != "|"}


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
    native = constant.step_method(scene) if isinstance(constant, NativeMethod) else None
    if native is None:
        lacks = "it chooses its own steps" if constant is None else "a library holds its time loop"
        raise SpecError(
            f"{method.spec} has no step of constant size that can be called alone: "
            f"{lacks}{advice(scene, 'linearly_implicit_euler', 'generalized_alpha', 'ali3p')}."
        )
    return native


def timed(
    step: Callable[[Array], Array], first: Array, steps: int
) -> tuple[Float[np.ndarray, " k"], list[Array]]:
    """Take k steps from a first state; return the time of each in s, and the state after it.

    A step is timed from its call to its result, without garbage collection.
    """
    state = first
    for _ in range(min(_WARM_UP, steps)):
        state = step(state).block_until_ready()
    state, begun, ends, states = first, [0] * steps, [0] * steps, []
    clock, collects = time.perf_counter_ns, gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        for n in range(steps):
            begun[n] = clock()
            state = step(state).block_until_ready()
            ends[n] = clock()
            states.append(state)
    finally:
        if collects:
            gc.enable()
    return np.subtract(ends, begun) * 1e-9, states


def residuals(scene: MechatronicSystem, run: Trajectory) -> dict[str, float | None]:
    """Return the largest residuals of Phi and of dPhi/dt over all rows of a run, in their units."""
    found = measure.violations(scene, run)
    return {level: finite(found[level].max()) for level in ("position", "velocity") if found}
