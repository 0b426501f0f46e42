"""Sweeps as jobs of a guarded process: requests in text and numbers, as the user wrote them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.guard.limits import PREPARING, RUNNING
from bench.running.worker import Worker
from bench.sweeps.batch import refuse
from bench.sweeps.ensemble import Ensemble, ensemble
from bench.sweeps.outcome_map import outcome_map
from bench.sweeps.variation import Range, find_range, read_ranges, unvaried_resolution
from integrators.contract import Integrator, Steps, Tolerances
from problems.spec import SpecError
from problems.system import MechatronicSystem

#: Points of a range; fewer along a parameter each value of which needs a reference of its own.
POINTS, POINTS_INTEGRATED = 100, 25


@dataclass(frozen=True)
class SweepRequest:
    """The runs of a sweep as far as they are all alike.

    Parameters
    ----------
    problem, settings, integrator
        Scene, parameters of it, and integrator, as text.
    given
        The values of --step, --pattern, --rtol and --atol, None where not given.
    t_end
        End time in s; the scene's own if None.
    budget
        Seconds after which no further runs are begun.
    """

    problem: str
    settings: dict[str, str]
    integrator: str
    given: dict[str, Any]
    t_end: float | None
    budget: float

    def ready(self, worker: Worker) -> tuple[MechatronicSystem, Integrator]:
        """Make scene and integrator, and say that compiling begins.

        Raises
        ------
        SpecError
            If they cannot be run side by side.
        """
        scene = worker.registry.problem(self.problem, **self.settings)
        method = worker.registry.integrator(self.integrator)
        refuse(method, scene)
        worker.notify(PREPARING, "tracing and compiling")
        return scene, method

    def resolution(
        self, scene: MechatronicSystem, method: Integrator, ranges: Sequence[Range]
    ) -> Steps | Tolerances:
        """Return the step or tolerances that are the same in all runs."""
        return unvaried_resolution(scene, method, self.given, self.t_end, ranges)


def map_job(
    worker: Worker,
    request: SweepRequest,
    over: tuple[str, str],
    ranges: tuple[str, ...],
    grid: tuple[int, int] | None,
    error: str,
    threshold: float,
) -> dict[str, Any]:
    """Make a map of outcomes as plain values; ``ranges`` and ``over`` are texts of the user."""
    scene, method = request.ready(worker)
    spans = read_ranges(ranges, "--range")
    stray = next((name for name in spans if name not in over), None)
    if stray:
        raise SpecError(f"--range {stray} is of no axis; the axes are {over[0]} and {over[1]}.")
    x, y = (find_range(name, scene, method, spans.get(name)) for name in over)
    points = [
        POINTS_INTEGRATED if r.quantity.owner == "scene" and not scene.has("exact") else POINTS
        for r in (x, y)
    ]
    return outcome_map(
        scene,
        method,
        (x, y),
        grid or (points[0], points[1]),
        request.resolution(scene, method, (x, y)),
        request.t_end,
        error,
        threshold,
        request.budget,
        begun=lambda: worker.notify(RUNNING, "running the points"),
    ).as_dict()


def ensemble_job(
    worker: Worker, request: SweepRequest, count: int, vary: tuple[str, ...], seed: int
) -> Ensemble:
    """Draw the members of an ensemble and run them; ``vary`` are texts of the user."""
    scene, method = request.ready(worker)
    spans = read_ranges(vary, "--vary")
    ranges = {name: find_range(name, scene, method, ends) for name, ends in spans.items()}
    resolution = request.resolution(scene, method, [*ranges.values()])
    generator = np.random.default_rng(seed)
    values = {name: drawn.random(count, generator) for name, drawn in ranges.items()}
    return ensemble(
        scene,
        method,
        values,
        resolution,
        request.t_end,
        request.budget,
        begun=lambda: worker.notify(RUNNING, "running the members"),
    )
