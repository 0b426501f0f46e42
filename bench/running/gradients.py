"""Gradients through runs: their errors against exact ones, and their cost beside plain runs."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from bench.results.gradients import ExactGradient, GradientRun, Gradients
from bench.running.entries import check_parameters, components
from bench.running.errors import finite
from bench.running.measure import least_seconds
from bench.running.worker import Worker
from integrators.contract import Gradient, Integrator, Wanted
from integrators.resolutions import Steps
from problems.reference import ReferenceFailed
from problems.sensitivities import size_of
from problems.spec import SpecError, options_of
from problems.usage import undisturbed
from problems.variables import VARIABLES

#: Samples of a plain run and of its gradient, in turns; one is enough if they take this time in s.
_SAMPLES, _LONG = 5, 5.0


def exact_job(
    worker: Worker, problem: str, of: str, by: Sequence[str], t_end: float
) -> ExactGradient:
    """Compute exact derivatives of numbers at t_end in s.

    Parameters
    ----------
    problem
        Name of the scene with parameters.
    of
        Numbers at the end, "q:end" or "q[1]:end".
    by
        Names of float parameters.

    Raises
    ------
    SpecError
        If a number or a parameter is not known, or there is no exact derivative.
    """
    scene = worker.problem(problem)
    numbers = components(scene.spec, {group: scene.sizes.of(group) for group in VARIABLES}, of)
    check_parameters(scene.spec, scene.parameters(), options_of(type(scene)), by)
    try:
        found = worker.sensitivities(scene, t_end, by)
    except ReferenceFailed as error:
        raise SpecError(str(error)) from None

    def rows(groups: dict[str, np.ndarray]) -> list[Any]:
        return [groups[group][k].tolist() for group, k in numbers]

    return ExactGradient(
        problem=scene.spec,
        t_end=t_end,
        of=numbers,
        by=list(by),
        sizes=[size_of(scene, name) for name in by],
        values=rows(found.values),
        derivatives=rows(found.derivatives),
        errors=rows(found.errors),
    )


def gradients_job(
    worker: Worker,
    problem: str,
    integrator: str,
    of: str,
    by: Sequence[str],
    t_end: float,
    ways: Sequence[str],
    steps: Sequence[float],
) -> Gradients:
    """Do `exact_job`, and `gradient_job` for one method."""
    exact = exact_job(worker, problem, of, by, t_end)
    return Gradients(exact=exact, runs=gradient_job(worker, integrator, exact, ways, steps))


def gradient_job(
    worker: Worker,
    integrator: str,
    exact: ExactGradient,
    ways: Sequence[str],
    steps: Sequence[float],
) -> list[GradientRun]:
    """Differentiate the runs of an integrator in each way, at each resolution.

    Parameters
    ----------
    ways
        Ways to take; all that the method has if empty.
    steps
        Steps in s.

    Raises
    ------
    SpecError
        If the method does not take the scene, or cannot be differentiated in a way.
    """
    scene, method = worker.problem(exact.problem), worker.registry.integrator(integrator)
    ways = ways_of(method, ways, scene.is_hybrid)
    runs = []
    for way in ways:
        wanted = Wanted(tuple(exact.of), tuple(exact.by), way)
        for h in steps:
            resolution = Steps(h)
            plain = method.prepare(scene, exact.t_end, resolution)
            derive = method.gradient(scene, exact.t_end, resolution, wanted)
            found = GradientRun(integrator=method.spec, way=way, resolution=f"h={h:g}")
            _judge(found, exact, derive())
            if not found.message:
                found.run_s, found.cost = side_by_side(plain.execute, derive)
            runs.append(found)
    return runs


def ways_of(method: Integrator, asked: Sequence[str], jumps: bool = False) -> Sequence[str]:
    """Return the ways that are asked for, or all; raise SpecError if the method lacks one.

    Parameters
    ----------
    jumps
        Whether values of the scene jump: derivatives through jumps go forward.
    """
    offered = method.gradient_ways
    if offered and jumps:
        return asked or ("forward",)
    lacking = [way for way in asked if way not in offered]
    if offered and not lacking:
        return asked or offered
    if offered:
        raise SpecError(f"{method.spec} has no {lacking[0]} mode; it has {' and '.join(offered)}.")
    constant = method.at_constant_steps()
    if constant is not None and constant.gradient_ways:
        raise SpecError(
            f"{method.spec} chooses its own steps, through which no derivative is taken; name "
            f"{constant.spec}."
        )
    raise SpecError(
        f"{method.spec} cannot be differentiated: it chooses its steps by estimated errors, or a "
        f"library outside of JAX takes them; name a method of ours at constant steps, such as "
        f"generalized_alpha, or dopri8[steps=constant]."
    )


def _judge(run: GradientRun, exact: ExactGradient, found: Gradient) -> None:
    """Compare a gradient with the exact one."""
    finite_numbers = np.isfinite(found.values).all() and np.isfinite(found.derivatives).all()
    if not (found.solved and finite_numbers):
        run.message = "The run failed, or its derivatives are not finite; take a finer resolution."
        return
    largest = np.abs(exact.values).max()
    run.value_error = finite(np.abs(found.values - exact.values).max() / (largest or 1.0))
    scale = np.abs(exact.derivatives).max(axis=0)
    natural = (largest or 1.0) / np.array(exact.sizes)
    scale = np.where(scale > 1e-9 * natural, scale, natural)
    run.derivatives = found.derivatives.tolist()
    off = np.abs(found.derivatives - exact.derivatives).max(axis=0)
    run.errors = [finite(error) for error in off / scale]


def side_by_side(plain: Callable[[], Any], other: Callable[[], Any]) -> tuple[float, float]:
    """Return processor seconds of a call of ``plain``, and those of ``other`` in units of them.

    Both are sampled in turns, and the median counts.
    """

    def pair() -> list[float]:
        return [least_seconds(plain), least_seconds(other)]

    with undisturbed():
        samples = [pair() for _ in range(2)][1:]  # the second calls are warm
        if sum(samples[0]) < _LONG:
            samples = [pair() for _ in range(_SAMPLES)]
    seconds = statistics.median(one for one, _ in samples)
    return seconds, statistics.median(two / one for one, two in samples)
