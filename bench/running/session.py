"""Runs from plan to result: of a suite into its store, with times; of one that is asked for.

A process plans and does the run that is asked for. The one that asks loads no plugin, nor a
compiler; it may have started the other one ahead.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from bench.plugins.fingerprint import environment
from bench.plugins.registry import Sources, plugin_files
from bench.results.records import INTERRUPTED, TIMING_SECONDS, Record, Rows, SceneRecord
from bench.results.store import Store
from bench.results.timings import FEWEST, contenders
from bench.running.inventory import SceneFacts
from bench.running.plan import Cell, Suite
from bench.running.process import PREPARING, Limits, NoAnswer
from bench.running.runner import Progress, Runner, Task, cell_task, scene_task
from bench.running.worker import CellResult, Worker
from integrators.resolutions import Steps, Tolerances, check_end
from problems.base.spec import SpecError

#: Constant steps from which on a well compiled program saves the time that it takes to compile;
#: runs with fewer, or with steps of their own choice, are not timed.
_TIMED = 100_000
#: Timing samples of a run, if it is timed.
_SAMPLES = 7


def missing(suite: Suite, store: Store) -> tuple[list[Cell], dict[tuple[str, float], SceneFacts]]:
    """Return the cells to be run, and the scenes to be described, by name and end time in s
    (`is_due`)."""
    runs, known, scenes = store.records(), store.scenes(), sorted(suite.scenes.items())
    cells = [c for k, c in suite.cells.items() if is_due(suite, runs.get(k), c.fingerprint)]
    return cells, {at: s for at, s in scenes if is_due(suite, known.get(at), s.fingerprint)}


def is_due(suite: Suite, record: Record | SceneRecord | None, fingerprint: str) -> bool:
    """Whether there is no record of this source, or it was interrupted, or ran out of a smaller
    budget."""
    if record is None or record.fingerprint != fingerprint:
        return True
    budgets = (suite.plan.budget_s, record.budget_s), (suite.memory_gib, record.memory_gib)
    more = any(before is not None and now > before for now, before in budgets)
    cut = isinstance(record, Record) and record.status == INTERRUPTED
    return cut or (record.stopped != "" and more)


def measure_suite(
    suite: Suite, store: Store, runner: Runner, further: Callable[[], list[Cell]] | None = None
) -> int:
    """Measure every cell and describe every scene that the store lacks; return how many cells.

    Each result is stored before the next is asked for; calling again goes on where it stopped.
    ``further`` is called whenever a process is free, and gives all cells that are worth a run now,
    the best first.
    """
    (cells, scenes), records, before = missing(suite, store), store.records(), store.plan()
    # Runs of an earlier plan are still shown, and so are the facts of their methods.
    kept = {record.integrator for record in records.values()}
    known = before.integrators if before else {}
    facts = {name: own for name, own in known.items() if name in kept} | suite.plan.integrators
    store.keep(replace(suite.plan, integrators=facts))
    machine, searches = environment(), further is not None
    if cells or searches or any(_samples_due(suite, records, last) for last in (False, True)):
        store.keep(machine)
    if not (cells or scenes or searches):
        return 0

    def offers() -> list[list[Task]]:
        begun = runner.begun
        cells = further() if further else []
        return grouped(cell_task(Worker.measure, c) for c in cells if c.key not in begun)

    # Scenes are counted if there is nothing else to do: people ask for cells.
    counted = Worker.measure if cells or searches else Worker.scene
    name = "searching" if searches else "measuring" if cells else "describing scenes"
    runner.progress.phase(name, None if searches else len(cells) or len(scenes))
    groups = [[scene_task(scene, t_end)] for (_, t_end), scene in scenes.items()]
    groups += grouped(cell_task(Worker.measure, cell) for cell in cells)  # after their scenes
    for task, answer in runner.run(groups, offers):
        found = _finished(task, answer, runner.progress)
        record, *rows = found if isinstance(found, CellResult) else (found,)
        if record:
            record.budget_s, record.memory_gib = suite.plan.budget_s, suite.memory_gib
        if rows:
            record.environment = machine.number
            store.save(record, *rows)
        elif record:
            store.keep(record)
        if task.job is counted:
            runner.progress.advance()
    return len(cells)


def time_suite(suite: Suite, store: Store, runner: Runner) -> None:
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
        tasks = [cell_task(Worker.time, suite.cells[key]) for key in due]
        runner.progress.phase("timing, one run at a time", sum(due.values()))
        samples = FEWEST if last else suite.plan.samples
        for task, sample, seconds in runner.time(tasks, samples, have, most):
            runner.progress.working(task.label)
            store.add_sample(task.label, sample, seconds, invocation)
            runner.progress.advance()


def solve_cells(
    cells: list[Cell], budget_s: float, progress: Progress | None = None
) -> list[CellResult]:
    """Measure a few cells without a store and times: programs are compiled quickly, not well."""
    tasks = [cell_task(Worker.measure, cell) for cell in cells]
    with Runner(1, Limits(budget_s, memory_gib=4.0), progress) as runner:
        runner.draft = True
        return [_finished(task, answer, runner.progress) for task, answer in runner.run([tasks])]


def describe_scenes(
    scenes: list[SceneFacts], budget_s: float, progress: Progress
) -> list[SceneRecord]:
    """Make records of scenes over their own intervals; one that fails is noted and left out."""
    records = {}
    groups = [[scene_task(scene, scene.interval[1])] for scene in scenes]
    progress.phase("references", len(groups))
    with Runner(2, Limits(budget_s, memory_gib=4.0), progress) as runner:
        for task, answer in runner.run(groups):
            if record := _finished(task, answer, progress):
                records[record.problem] = record
            progress.advance()
    return [records[scene.spec] for scene in scenes if scene.spec in records]


def result_of(cell: Cell, answer: CellResult | NoAnswer) -> CellResult:
    """Return the result of a cell; one that has no answer has a record with the reason."""
    if isinstance(answer, NoAnswer):
        record = cell.record(answer.status, answer.message)
        record.stopped = answer.phase if answer.status == "budget_exceeded" else ""
        return CellResult(record, Rows(t=[]))
    return answer


def grouped(tasks: Iterable[Task]) -> list[list[Task]]:
    """Return groups of tasks that share compiled code."""
    shared: defaultdict[tuple, list[Task]] = defaultdict(list)
    for task in tasks:
        shared[task.scene, task.programs, task.sources].append(task)
    return [*shared.values()]


# ---- parts -----------------------------------------------------------------------------
def _finished(task: Task, answer: Any, progress: Progress) -> Any:
    """The result of a cell, or the record of a scene; None, with a message, if there is none."""
    if task.job is Worker.measure:
        return result_of(task.arguments[0], answer)
    if isinstance(answer, NoAnswer):
        progress.note(f"No picture of {task.arguments[0]}: {answer.message}")
        return None
    return answer


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

    Names may have options; ``parameters`` are of the scene, ``sizes`` those of `plan_run`,
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
        cell, names = planned
        count = 0
        if isinstance(cell.resolution, Steps):
            t0, given = cell.scene.interval[0], cell.resolution.h
            count = cell.resolution.count(t0, cell.t_end)
            h = (cell.t_end - t0) / count
            if abs(h - given) > 1e-9 * h:
                progress.note(
                    f"Step {given:g} s does not divide the interval; {count} steps of {h:.9g} s "
                    "are taken."
                )
        if samples is None and count >= _TIMED:  # another process compiles well
            samples, runner.draft = _SAMPLES, False
            runner.end_workers()
        ((_, measured),) = runner.run([[cell_task(Worker.measure, cell, True, "", False)]])
        result = result_of(cell, measured)
        if result.record.status == "ok":
            for _, _, seconds in runner.time([cell_task(Worker.time, cell)], samples or 0, {}):
                result.record.run_s.append(seconds)
    return result, names


def plan_run(
    worker: Worker,
    problem: str,
    integrator: str,
    parameters: Mapping[str, Any],
    t_end: float | None,
    sizes: Mapping[str, Any],
) -> tuple[Cell, dict[str, list[str]]]:
    """Do a job of a worker: plan a run with the plugins that its process has loaded, in a budget
    beside that of the run; return its cell and the names of components.

    SpecError is raised if ``sizes`` (step, pattern, rtol, atol; None: not given) are of the other
    kind: steps of a method that chooses its own, or tolerances of one with fixed steps.
    """
    worker.notify(PREPARING, "planning")
    registry = worker.inventory
    registry.require_files()
    scene = registry.problem(problem, **parameters)
    method = registry.integrator_on(registry.integrator(integrator), scene)
    end = check_end(scene.interval[0], scene.interval[1] if t_end is None else t_end)
    given = {name: size for name, size in sizes.items() if size is not None}
    fixed = method.controls == "step"
    takes = "fixed steps; give --step" if fixed else "steps of its own; give --rtol"
    for option in given:
        if option in (("rtol", "atol") if fixed else ("step", "pattern")):
            raise SpecError(f"{method.spec} takes {takes} instead of --{option}.")
    if fixed:
        resolution = Steps(given.get("step", scene.nominal_step), given.get("pattern", (1.0,)))
        resolution.count(scene.interval[0], end)  # refuses a step that does not fit the interval
    else:
        resolution = Tolerances(**given)
    return Cell(scene, method, end, resolution), registry.components(scene.spec)
