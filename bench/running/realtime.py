"""Runs at a fixed rate, as in real time: the host calls one compiled step for each tick."""

from __future__ import annotations

import gc
import time

import numpy as np

from bench.results.realtime import RealTimeRun, times_of
from bench.running import measure
from bench.running.errors import finite, relative_errors
from bench.running.worker import Worker
from integrators import checks
from integrators.advice import advice
from integrators.contract import Integrator
from integrators.native.single_step import SingleStep
from integrators.native.step_method import NativeMethod
from problems.runtime import Array, Float
from problems.spec import SpecError
from problems.system import MechatronicSystem

#: Steps before the clock is read.
_WARM_UP = 200


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
        with as many as the method takes, or for the latter alone if it keeps tangents over steps.

    Raises
    ------
    SpecError
        If the method does not take the scene, or its step cannot be called alone or limited.
    """
    scene = worker.problem(problem)
    method = stepping(worker.registry.integrator(integrator), scene)
    reference = worker.reference(scene, scene.interval[0] + steps / rate)
    own, limits = SingleStep(method, scene, 1 / rate, steps), [limit]
    if not own.iterates:
        limits = [None]
    elif limit is None and not own.keeps_tangents:
        limits = [1, None]
    runs = []
    for most in limits:
        step = SingleStep(method, scene, 1 / rate, steps, most) if most else own
        seconds, states = timed(step, steps)
        run, unconverged = step.run(states)
        if run.status == "ok" and not reference.missing:
            changes = measure.invariant_changes(scene, run, reference, ["energy"])
            measure.end_at_blow_up(run, reference, changes)
        errors, constraint, done = {}, {}, len(run.t) - 1
        if run.status == "ok":
            violations = measure.violations(scene, run)
            constraint = {k: finite(v.max()) for k, v in violations.items() if k != "acceleration"}
            if not reference.missing:
                table = relative_errors(run, reference).errors
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
                **times_of(seconds[: max(done, 1)], 1 / rate),
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
    native = constant.step_method(scene) if isinstance(constant, NativeMethod) else None
    if native is None:
        lacks = "it chooses its own steps" if constant is None else "a library holds its time loop"
        raise SpecError(
            f"{method.spec} has no step of constant size that can be called alone: "
            f"{lacks}{advice(scene, 'linearly_implicit_euler', 'generalized_alpha', 'ali3p')}."
        )
    return native


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
