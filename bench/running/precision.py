"""Runs of native methods in several precisions: their errors over the step."""

from __future__ import annotations

from collections.abc import Sequence

from bench.results.precision import PrecisionRun
from bench.results.realtime import MOST_STEPS
from bench.running.realtime import errors_of, stepping
from bench.running.worker import Worker
from integrators.contract import Trajectory
from integrators.native.lone_steps import LoneStep
from integrators.native.precision import PRECISIONS
from integrators.native.step_method import NativeMethod
from integrators.resolutions import Steps
from problems.spec import SpecError
from problems.system import MechatronicSystem


def precision_job(
    worker: Worker,
    problem: str,
    integrator: str,
    steps: Sequence[float],
    t_end: float,
    norm: str = "max",
    precisions: Sequence[str] = PRECISIONS,
) -> list[PrecisionRun]:
    """Run a method in each precision at each step.

    Parameters
    ----------
    problem, integrator
        Names with options.
    steps
        Sizes in s; one that does not divide the interval is shortened to one that does.
    t_end
        End of the runs in s.
    norm
        Norm of the errors over time, a key of `bench.results.quantities.NORMS`.

    Raises
    ------
    SpecError
        If the method does not take the scene, or has no step that can be called alone; if a step is
        no step of the interval.
    """
    scene = worker.problem(problem)
    method = stepping(worker.registry.integrator(integrator), scene)
    t0 = scene.interval[0]
    counts = [Steps(h).count(t0, t_end) for h in steps]
    if max(counts) > MOST_STEPS:
        raise SpecError(
            f"{t_end - t0:g} s in steps of {min(steps):g} s take {max(counts)} steps; give steps "
            f"that make at most {MOST_STEPS}."
        )
    reference, found = worker.reference(scene, t_end), []
    for precision in precisions:
        for count in counts:
            h = (t_end - t0) / count
            run = run_in(precision, method, scene, h, count)
            errors = errors_of(scene, run, reference, norm)
            found.append(
                PrecisionRun(
                    problem=scene.spec,
                    integrator=method.spec,
                    precision=precision,
                    h=h,
                    steps=count,
                    status=run.status,
                    message=run.message or reference.missing,
                    errors=errors,
                )
            )
    return found


def run_in(
    precision: str, method: NativeMethod, scene: MechatronicSystem, h: float, steps: int
) -> Trajectory:
    """Run a method at constant steps of h (s) in one of `PRECISIONS`."""
    step = LoneStep(method, scene, h, steps, precision=precision)
    state, states = step.first, []
    for _ in range(steps):
        state = step(state)
        states.append(state)
    return step.run(states)[0]


def precision_errors(
    worker: Worker,
    problem: str,
    integrator: str,
    precision: str,
    steps: tuple[float, ...],
    t_end: float,
    group: str,
    norm: str,
) -> list[float | None]:
    """Do a job of a worker: the errors of a group in one precision, for each step in s."""
    runs = precision_job(worker, problem, integrator, steps, t_end, norm, [precision])
    return [run.errors.get(group) for run in runs]
