"""Long runs at constant steps: what drifts off, how far and how fast.

Memory does not grow with the number of steps: a trajectory has some thousands of rows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bench.running import measure
from bench.running.errors import finite
from bench.running.plan import Cell, check_end
from bench.running.worker import Worker
from integrators.contract import Steps, Trajectory
from integrators.kept_rows import spread_rows
from problems.spec import SpecError
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    from jaxtyping import Float

#: Rows of a run that are handed on for a chart.
_DRAWN = 400
#: Iterations that find the phase at a row from that at the row before.
_PHASE_ITERATIONS = 2


def drift_job(
    worker: Worker, problem: str, integrator: str, h: float | None, steps: int
) -> dict[str, Any]:
    """Run an integrator over many steps and measure what drifts.

    Parameters
    ----------
    problem, integrator
        Names with options.
    h
        Step in s; the scene's nominal one if None.
    steps
        Number of steps.

    Returns
    -------
    dict
        Names and numbers of the run; "drifts" by name, each with its largest absolute value and
        its trend, the slope of a straight line in 1/s; "rows", times and drifts of some rows.

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
    run, _ = worker.run(Cell(scene.spec, constant.spec, t_end, resolution))
    drifts = drifts_of(scene, run) if len(run.t) > 2 else {}
    drawn = spread_rows(len(run.t) - 1, _DRAWN) if drifts else []
    return {
        "problem": scene.spec,
        "integrator": constant.spec,
        "status": run.status,
        "message": run.message,
        "steps": run.work.steps,
        "h": resolution.h,
        "t_end": float(run.t[-1]) if len(run.t) else None,
        "drifts": {
            name: {
                "largest": finite(np.abs(values).max()),
                "per_s": finite(np.polyfit(run.t - run.t[0], values, 1)[0]),
            }
            for name, values in drifts.items()
        },
        "rows": {
            name: [finite(value) for value in values[drawn]]
            for name, values in ({"t": run.t} | drifts).items()
        },
    }


def drifts_of(scene: MechatronicSystem, run: Trajectory) -> dict[str, Float[np.ndarray, " k"]]:
    """Measure in each of the k rows of a run what a scene can tell of.

    Returns
    -------
    dict
        "energy", its change relative to the largest kinetic one; "position" and "velocity", the
        largest residuals of the constraints and of their rates; "phase", the time in s by which
        the run is ahead of the closed form of a motion that conserves energy.
    """
    violations = measure.violations(scene, run)
    violations.pop("acceleration", None)
    drifts = measure.energy_change(scene, run) | violations
    if scene.has("energy") and scene.has("exact"):
        drifts["phase"] = phase(scene, run)
    return drifts


def phase(scene: MechatronicSystem, run: Trajectory) -> Float[np.ndarray, " k"]:
    """Measure the time in s by which each of the k rows is ahead of the closed form.

    It is the shift s of time at which the closed form at t + s is nearest to q and v, each
    relative to its size, followed from row to row.
    """
    exact = scene.exact(run.t)
    sizes = {name: np.abs(exact[name]).max() or 1.0 for name in ("q", "v")}
    shift, change, shifts = 0.0, 0.0, []
    for t, q, v in zip(run.t, run.q, run.v, strict=True):
        before, shift = shift, shift + change
        for _ in range(_PHASE_ITERATIONS):
            there = {name: rows[0] for name, rows in scene.exact(np.array([t + shift])).items()}
            off = np.concatenate([(q - there["q"]) / sizes["q"], (v - there["v"]) / sizes["v"]])
            rate = np.concatenate([there["v"] / sizes["q"], there["a"] / sizes["v"]])
            shift += off @ rate / (rate @ rate or 1.0)
        change = shift - before
        shifts.append(shift)
    return np.array(shifts)
