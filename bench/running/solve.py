"""One run of one integrator on one scene: one process loads the plugins, plans it and does it.

This process loads none, nor a compiler; it may have started the other one ahead.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from bench.plugins.registry import Sources, plugin_files
from bench.running.inventory import MethodFacts, SceneFacts
from bench.running.plan import Cell, resolution_of
from bench.running.process import Limits, NoAnswer
from bench.running.progress import Progress
from bench.running.runner import Runner, Task, measure_task, time_task
from bench.running.serve import PREPARING
from bench.running.session import result_of
from bench.running.worker import CellResult, Worker
from integrators.resolutions import Steps, check_end
from problems.base.spec import SpecError

#: Constant steps from which on a well compiled program saves the time that it takes to compile;
#: runs with fewer, or with steps of their own choice, are not timed.
_TIMED = 100_000
#: Timing samples of a run, if it is timed.
_SAMPLES = 7


@dataclass(frozen=True)
class Request:
    """A run that is asked for; None stands for the scene's or the method's own.

    Parameters
    ----------
    problem, integrator
        Names with options.
    parameters
        Of the scene.
    step, pattern, rtol, atol
        Steps in s with their pattern, or tolerances.
    t_end
        End time in s.
    samples
        How often it is timed; None: not, unless it is long.
    """

    problem: str
    integrator: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    step: float | None = None
    pattern: tuple[float, ...] | None = None
    rtol: float | None = None
    atol: float | None = None
    t_end: float | None = None
    samples: int | None = None


class PlannedRun(NamedTuple):
    """A run with the facts of its scene and integrator, and how often it is timed; ``remark`` is a
    sentence on its steps."""

    cell: Cell
    scene: SceneFacts
    method: MethodFacts
    samples: int
    remark: str


def solve(
    request: Request,
    plugins: Sequence[str | Path],
    budget_s: float,
    progress: Progress,
) -> tuple[CellResult, dict[str, list[str]]]:
    """Do a run; return its result, and the names of the components of each group of the scene if
    known.

    Raises
    ------
    SpecError
        If a name, an option or a number is not known or not allowed.
    """
    sources = Sources(plugin_files(plugins))
    with Runner(1, Limits(budget_s, memory_gib=4.0), progress) as runner:
        # Programs of which no times are taken are compiled quickly rather than well: also those
        # that check a model as it is loaded, and JAX reads its settings once.
        runner.draft = not request.samples
        ((_, planned),) = runner.run([[Task(plan_run, (request,), sources=sources)]])
        if isinstance(planned, NoAnswer):
            raise SpecError(planned.message)
        if planned.remark:
            progress.note(planned.remark)
        cell = planned.cell
        if planned.samples and runner.draft:  # a long run: another process compiles well
            runner.draft = False
            runner.end_workers()
        components = Task(Worker.components, (cell.problem,), sources=sources)
        (_, measured), (_, named) = runner.run([[measure_task(cell, sources), components]])
        result = result_of(cell, measured, planned.scene, planned.method)
        if result.record.status == "ok":
            for _, _, seconds in runner.time([time_task(cell, sources)], planned.samples, {}):
                result.record.run_s.append(seconds)
    return result, {} if isinstance(named, NoAnswer) else named


# ---- in the process of the run -----------------------------------------------------------
def plan_run(worker: Worker, request: Request) -> PlannedRun:
    """Plan a run with the plugins that this process has loaded, in a budget beside that of it."""
    worker.notify(PREPARING, "planning")
    registry = worker.inventory
    registry.require_files()
    scene = registry.problem(request.problem, **request.parameters)
    method = registry.integrator_on(registry.integrator(request.integrator), scene)
    start = scene.interval[0]
    end = check_end(start, scene.interval[1] if request.t_end is None else request.t_end)
    sizes = request.step, request.pattern, request.rtol, request.atol
    resolution, count, remark = resolution_of(scene, method, *sizes), 0, ""
    if isinstance(resolution, Steps):
        count = resolution.count(start, end)
        used = (end - start) / count
        if abs(used - resolution.h) > 1e-9 * used:
            remark = (
                f"Step {resolution.h:g} s does not divide the interval; {count} steps of "
                f"{used:.9g} s are taken."
            )
    samples = request.samples
    if samples is None:
        samples = _SAMPLES if count >= _TIMED else 0
    cell = Cell(scene.spec, method.spec, end, resolution)
    return PlannedRun(cell, scene, method, samples, remark)
