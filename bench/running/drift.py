"""Long runs at constant steps: what drifts off, how far and how fast.

Memory does not grow with the number of steps: a trajectory has some thousands of rows.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from bench.results.studies import Drift, LongRun
from bench.running import measure
from bench.running.measure import finite
from bench.running.plan import Cell
from bench.running.worker import Worker
from integrators.contract import Trajectory
from integrators.resolutions import Steps, check_end
from problems.base.runtime import Float
from problems.base.spec import SpecError
from problems.system import MechatronicSystem
from problems.truth.reference import Reference

#: Parts of a run of which a chart shows least and largest values.
_PARTS = 200


def drift_job(
    worker: Worker, problem: str, integrator: str, h: float | None, steps: int
) -> LongRun:
    """Run an integrator over many steps h (s; the scene's nominal one if None), and measure what
    drifts.

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
    drifts = drifts_of(scene, run, reference) if len(run.t) > 2 else {}
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


def drifts_of(
    scene: MechatronicSystem, run: Trajectory, reference: Reference | None = None
) -> dict[str, Float[np.ndarray, " k"]]:
    """Measure in each of the k rows of a run what a scene can tell of: `measure.invariant_changes`;
    "position" and "velocity", the largest residuals of the constraints and of their rates."""
    violations = measure.violations(scene, run)
    violations.pop("acceleration", None)
    return measure.invariant_changes(scene, run, reference) | violations
