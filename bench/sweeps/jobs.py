"""Sweeps as jobs of a guarded process: requests in text and numbers, as the user wrote them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from bench.guard.serve import PREPARING, RUNNING
from bench.running.worker import Worker
from bench.sweeps.batch import refuse
from bench.sweeps.ensemble import Ensemble, ensemble
from bench.sweeps.outcome_map import outcome_map
from bench.sweeps.variation import Range, find_range, read_ranges, unvaried_resolution
from integrators.contract import Integrator
from integrators.resolutions import Steps, Tolerances
from problems.runtime import check_runtime, jax, jnp
from problems.spec import SpecError
from problems.system import MechatronicSystem

#: Points of a range; fewer along a parameter each value of which needs a reference of its own.
POINTS, POINTS_INTEGRATED = 100, 25


@dataclass(frozen=True, eq=False)  # tasks have a hash, and so must what is in them
class SweepRequest:
    """The runs of a sweep as far as they are all alike.

    Names are printed names; ``given`` are the values of --step, --pattern, --rtol and --atol, None
    where not given; ``t_end`` is in s, the scene's own if None; no further runs are begun after
    ``budget`` seconds.
    """

    problem: str
    integrator: str
    given: dict[str, Any]
    t_end: float | None
    budget: float

    def prepared(
        self, worker: Worker, spans: Mapping[str, tuple[float, float] | None]
    ) -> tuple[MechatronicSystem, Integrator, dict[str, Range], Steps | Tolerances]:
        """Make scene, integrator, ranges and the step or tolerances of all runs; compiling begins.

        ``spans`` are the ends of each range by name; None for those of `find_range`.

        Raises
        ------
        SpecError
            If they cannot be run side by side, or JAX does not compute with 64 bits.
        """
        try:
            jax.default_backend()
        except Exception:  # of whatever kind: JAX has none for a platform that is missing
            raise SpecError(check_runtime() or "JAX does not start.") from None
        scene = worker.registry.problem(self.problem)
        method = worker.registry.integrator(self.integrator)
        if jnp.zeros(1).dtype.itemsize != 8:  # a plugin may have changed it
            raise SpecError("JAX computes with 32-bit floats; unset JAX_ENABLE_X64.")
        refuse(method, scene)
        worker.notify(PREPARING, "tracing and compiling")
        ranges = {name: find_range(name, scene, method, ends) for name, ends in spans.items()}
        fixed = unvaried_resolution(scene, method, self.given, self.t_end, ranges.values())
        return scene, method, ranges, fixed


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
    spans = read_ranges(ranges, "--range")
    stray = next((name for name in spans if name not in over), None)
    if stray:
        raise SpecError(f"--range {stray} is of no axis; the axes are {over[0]} and {over[1]}.")
    of_axes = {name: spans.get(name) for name in over}
    scene, method, found, fixed = request.prepared(worker, of_axes)
    x, y = found.values()
    points = [
        POINTS_INTEGRATED if r.quantity.owner == "scene" and not scene.has_closed_form else POINTS
        for r in (x, y)
    ]
    return outcome_map(
        scene,
        method,
        (x, y),
        grid or (points[0], points[1]),
        fixed,
        request.t_end,
        error,
        threshold,
        request.budget,
        begun=lambda: worker.notify(RUNNING, "running the points"),
    )


@dataclass(frozen=True, eq=False)
class EnsembleRequest(SweepRequest):
    """An ensemble of ``count`` members as the user asked for it; ``vary`` are texts."""

    count: int
    vary: tuple[str, ...]
    seed: int


def members_job(worker: Worker, request: EnsembleRequest, first: int, count: int) -> Ensemble:
    """Run ``count`` members of an ensemble from the ``first`` on."""
    scene, method, ranges, fixed = request.prepared(worker, read_ranges(request.vary, "--vary"))
    draw = partial(Range.draw, seed=request.seed, first=first, count=count)
    return ensemble(
        scene,
        method,
        {name: draw(of, place=place) for place, (name, of) in enumerate(ranges.items())},
        fixed,
        request.t_end,
        request.budget,
        begun=lambda: worker.notify(RUNNING, "running the members"),
        first=first,
    )
