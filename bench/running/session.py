"""Runs from plan to result: of a suite into its store, with times; of one that is asked for.

A process plans and does the run that is asked for. The one that asks loads no plugin, nor a
compiler; it may have started the other one ahead.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from bench.plugins.fingerprint import environment
from bench.plugins.registry import Sources, plugin_files
from bench.results.records import (
    INTERRUPTED,
    TIMING_SECONDS,
    MethodFacts,
    Record,
    Rows,
    SceneRecord,
)
from bench.results.store import Store
from bench.results.timings import FEWEST, contenders
from bench.running.cluster import ClusterRunner
from bench.running.inventory import Inventory, SceneFacts
from bench.running.plan import Cell, Suite, resolution_of
from bench.running.process import PREPARING, Limits, NoAnswer
from bench.running.progress import Progress
from bench.running.runner import Runner, Task, measure_task, scene_task, time_task
from bench.running.worker import CellResult, Worker
from integrators.resolutions import Steps, check_end
from problems.base.spec import SpecError

#: Constant steps from which on a well compiled program saves the time that it takes to compile;
#: runs with fewer, or with steps of their own choice, are not timed.
_TIMED = 100_000
#: Timing samples of a run, if it is timed.
_SAMPLES = 7


def runner_for(suite: Suite, jobs: int, progress: Progress, cluster: str | None = None) -> Runner:
    """Make the runner of a suite, on this machine or by the address of a cluster."""
    limits = Limits(suite.plan.budget_s, suite.memory_gib)
    return ClusterRunner(cluster, limits, progress) if cluster else Runner(jobs, limits, progress)


def missing_cells(suite: Suite, store: Store, registry: Inventory) -> list[Cell]:
    """List the cells to be run: those without a readable record of this source, and those that
    were interrupted or ran out of a smaller budget."""
    cells, stored = suite.cells.values(), store.records()
    cut = {key for key, record in stored.items() if record.status == INTERRUPTED}
    return [
        cell
        for cell in cells
        if cell.key in cut or _is_due(suite, stored.get(cell.key), cell.fingerprint(registry))
    ]


def missing_scenes(suite: Suite, store: Store, registry: Inventory) -> list[tuple[str, float]]:
    """List the scenes, by name and end time in s, that have no record of this source, or whose
    reference ran out of a smaller budget."""
    stored, asked = store.scenes(), {(s.problem, s.t_end) for s in suite.plan.studies}
    made = {scene: registry.problem(scene[0]).fingerprint for scene in asked}
    return sorted(s for s in asked if _is_due(suite, stored.get(s), made[s]))


def measure_suite(
    suite: Suite,
    store: Store,
    registry: Inventory,
    runner: Runner,
    further: Callable[[], list[Cell]] | None = None,
) -> int:
    """Measure every cell and describe every scene that the store lacks; return how many cells.

    Each result is stored before the next is asked for; calling again goes on where it stopped.
    ``further`` is called whenever a process is free, and gives all cells that are worth a run now,
    the best first.
    """
    cells, scenes = missing_cells(suite, store, registry), missing_scenes(suite, store, registry)
    records, before = store.records(), store.plan()
    # Runs of an earlier plan are still shown, and so are the facts of their methods.
    kept = {record.integrator for record in records.values()}
    known = before.integrators if before else {}
    facts = {name: own for name, own in known.items() if name in kept} | suite.plan.integrators
    store.keep(replace(suite.plan, integrators=facts))
    number = 0
    due = any(_samples_due(suite, records, last) for last in (False, True))
    if cells or further or due:
        machine = environment()
        number = machine.number
        store.keep(machine)

    def keep(cell: Cell, answer: CellResult | NoAnswer) -> None:
        record, rows = result_of(cell, answer, *cell.facts(registry))
        record.environment = number
        record.budget_s, record.memory_gib = suite.plan.budget_s, suite.memory_gib
        store.save(record, rows)

    def offers() -> list[list[Task]]:
        begun = runner.begun
        cells = [cell for cell in further() if cell.key not in begun] if further else []
        return _groups(cells, [], registry)

    if cells or scenes or further:
        groups = _groups(cells, scenes, registry)
        # Scenes are counted if there is nothing else to do: people ask for cells.
        counted = Worker.measure if cells or further else Worker.scene
        progress = runner.progress
        name = "searching" if further else "measuring" if cells else "describing scenes"
        progress.phase(name, None if further else len(cells) or len(scenes))
        answers = runner.run(groups, offers if further else list)
        for task, answer in answers:
            if task.job is Worker.scene:
                if record := _described(task, answer, progress):
                    record.budget_s, record.memory_gib = suite.plan.budget_s, suite.memory_gib
                    store.keep(record)
            else:
                keep(task.arguments[0], answer)
            if task.job is counted:
                progress.advance()
    return len(cells)


def time_suite(suite: Suite, store: Store, registry: Inventory, runner: Runner) -> None:
    """Take the timing samples that the store lacks, of the cells that reached the end.

    Runs that last long have few of them; in the end those that may win get more.
    """
    for last, most in ((False, TIMING_SECONDS), (True, math.inf)):
        records = store.records()
        due = _samples_due(suite, records, last)
        if not due:
            continue
        have = {key: _samples_of(records[key]) for key in due}
        invocation = [*store.environments()][-1]  # kept as there are samples to be taken
        tasks = [
            time_task(cell, cell.sources(registry)) for cell in (suite.cells[key] for key in due)
        ]
        runner.progress.phase("timing, one run at a time", sum(due.values()))
        samples = FEWEST if last else suite.plan.samples
        for task, sample, seconds in runner.time(tasks, samples, have, most):
            runner.progress.working(task.label)
            store.add_sample(task.label, sample, seconds, invocation)
            runner.progress.advance()


def solve_cells(
    cells: list[Cell],
    registry: Inventory,
    budget_s: float,
    memory_gib: float = 4.0,
    progress: Progress | None = None,
) -> list[CellResult]:
    """Measure a few cells without a store and times: programs are compiled quickly, not well."""
    groups = [[measure_task(cell, cell.sources(registry)) for cell in cells]]
    with Runner(1, Limits(budget_s, memory_gib), progress) as runner:
        runner.draft = True
        found = {task.label: answer for task, answer in runner.run(groups)}
    return [result_of(cell, found[cell.key], *cell.facts(registry)) for cell in cells]


def describe_scenes(
    scenes: list[SceneFacts], budget_s: float, progress: Progress
) -> list[SceneRecord]:
    """Make records of scenes over their own intervals; one that fails is noted and left out."""
    records = {}
    groups = [[scene_task(scene.spec, scene.interval[1], scene.sources)] for scene in scenes]
    progress.phase("references", len(groups))
    with Runner(2, Limits(budget_s, memory_gib=4.0), progress) as runner:
        for task, answer in runner.run(groups):
            if record := _described(task, answer, progress):
                records[record.problem] = record
            progress.advance()
    return [records[scene.spec] for scene in scenes if scene.spec in records]


def result_of(
    cell: Cell, answer: CellResult | NoAnswer, scene: SceneFacts, method: MethodFacts
) -> CellResult:
    """Return the result of a cell; one that has no answer has a record with the reason."""
    if isinstance(answer, NoAnswer):
        record = cell.record(scene, method, answer.status, answer.message)
        record.stopped = answer.phase if answer.status == "budget_exceeded" else ""
        return CellResult(record, Rows(t=[]))
    return answer


# ---- parts -----------------------------------------------------------------------------
def _is_due(suite: Suite, record: Record | SceneRecord | None, fingerprint: str) -> bool:
    """Whether there is no record of this source, or it ran out of a smaller budget."""
    if record is None or record.fingerprint != fingerprint:
        return True
    budgets = (suite.plan.budget_s, record.budget_s), (suite.memory_gib, record.memory_gib)
    more = any(before is not None and now > before for now, before in budgets)
    return record.stopped != "" and more


def _described(
    task: Task, answer: SceneRecord | NoAnswer, progress: Progress
) -> SceneRecord | None:
    """Return the record of a scene; if there is none, note the reason."""
    if isinstance(answer, SceneRecord):
        return answer
    progress.note(f"No picture of {task.arguments[0]}: {answer.message}")
    return None


def _samples_due(suite: Suite, records: Mapping[str, Record], last: bool) -> dict[str, int]:
    """Count the timing samples that measured cells lack, by key; the ``last`` are of contenders."""
    good = [records[key] for key in suite.cells if key in records and records[key].status == "ok"]
    samples, due = suite.plan.samples, [r for r in good if sum(r.run_s) <= TIMING_SECONDS]
    if last:
        samples, due = FEWEST, contenders(good) if samples >= FEWEST else []
    lacking = {r.key: len(set(range(samples)) - _samples_of(r).keys()) for r in due}
    return {key: count for key, count in lacking.items() if count}


def _samples_of(record: Record) -> dict[int, float]:
    """Timing samples in s by their rounds."""
    return {number: s for (_, number), s in zip(record.rounds, record.run_s, strict=True)}


def _groups(
    cells: list[Cell], scenes: list[tuple[str, float]], registry: Inventory
) -> list[list[Task]]:
    """Group cells that share compiled code; the record of a scene comes before its cells."""
    groups: dict[tuple, list[Task]] = {}
    for problem, t_end in scenes:
        groups[problem, t_end] = [scene_task(problem, t_end, registry.problem(problem).sources)]
    for cell in cells:
        sources = cell.sources(registry)
        programs = registry.integrator(cell.integrator).affinity
        task = measure_task(cell, sources, programs=programs)
        groups.setdefault((cell.problem, programs, sources), []).append(task)
    return list(groups.values())


# ---- one run -----------------------------------------------------------------------------
def solve(
    problem: str,
    integrator: str,
    plugins: Sequence[str | Path],
    budget_s: float,
    progress: Progress,
    *,
    parameters: Mapping[str, Any] | None = None,
    t_end: float | None = None,
    samples: int | None = None,
    **sizes: Any,
) -> tuple[CellResult, dict[str, list[str]]]:
    """Do a run; return its result, and the names of the components of each group of the scene.

    Names may have options; ``parameters`` are of the scene, ``sizes`` those of `resolution_of`,
    ``t_end`` is in s; None stands for the scene's or the method's own. The run is timed so many
    times as there are ``samples``; None: not, unless it is long.

    Raises
    ------
    SpecError
        If a name, an option or a number is not known or not allowed.
    """
    sources = Sources(plugin_files(plugins))
    asked = problem, integrator, parameters or {}, t_end, sizes
    with Runner(1, Limits(budget_s, memory_gib=4.0), progress) as runner:
        # Programs of which no times are taken are compiled quickly rather than well: also those
        # that check a model as it is loaded, and JAX reads its settings once.
        runner.draft = not samples
        ((_, planned),) = runner.run([[Task(plan_run, asked, sources=sources)]])
        if isinstance(planned, NoAnswer):
            raise SpecError(planned.message)
        cell, scene, method, names = planned
        count = 0
        if isinstance(cell.resolution, Steps):
            length = cell.t_end - scene.interval[0]
            count = cell.resolution.count(scene.interval[0], cell.t_end)
            if abs(length / count - cell.resolution.h) > 1e-9 * length / count:
                progress.note(
                    f"Step {cell.resolution.h:g} s does not divide the interval; {count} steps of "
                    f"{length / count:.9g} s are taken."
                )
        if samples is None and count >= _TIMED:  # another process compiles well
            samples, runner.draft = _SAMPLES, False
            runner.end_workers()
        ((_, measured),) = runner.run([[measure_task(cell, sources)]])
        result = result_of(cell, measured, scene, method)
        if result.record.status == "ok":
            for _, _, seconds in runner.time([time_task(cell, sources)], samples or 0, {}):
                result.record.run_s.append(seconds)
    return result, names


def plan_run(
    worker: Worker,
    problem: str,
    integrator: str,
    parameters: Mapping[str, Any],
    t_end: float | None,
    sizes: Mapping[str, Any],
) -> tuple[Cell, SceneFacts, MethodFacts, dict[str, list[str]]]:
    """Do a job of a worker: plan a run with the plugins that its process has loaded, in a budget
    beside that of the run; return its cell, facts, and names of components."""
    worker.notify(PREPARING, "planning")
    registry = worker.inventory
    registry.require_files()
    scene = registry.problem(problem, **parameters)
    method = registry.integrator_on(registry.integrator(integrator), scene)
    end = check_end(scene.interval[0], scene.interval[1] if t_end is None else t_end)
    resolution = resolution_of(scene, method, **sizes)
    if isinstance(resolution, Steps):
        resolution.count(scene.interval[0], end)  # refuses a step that does not fit the interval
    cell = Cell(scene.spec, method.spec, end, resolution)
    return cell, scene, method, registry.components(scene.spec)
