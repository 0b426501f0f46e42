"""A suite from plan to store: lists missing results, measures them, and takes times."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from bench.plugins.fingerprint import fingerprint
from bench.plugins.registry import Registry
from bench.results.environment import environment
from bench.results.records import TIMING_SECONDS, Record, Rows, SceneRecord
from bench.results.store import Store
from bench.running.cluster import ClusterRunner
from bench.running.plan import Cell, Suite
from bench.running.processes import NoAnswer
from bench.running.runner import Runner, Task, measure_task, scene_task
from bench.running.worker import CellResult, Worker
from problems.system import MechatronicSystem


class Progress(Protocol):
    """Messages to the person who waits."""

    def phase(self, name: str, total: int) -> None:
        """Say that a phase begins, with its number of steps."""

    def working(self, text: str) -> None:
        """Say that this is in work."""

    def advance(self) -> None:
        """Say that one step is done."""

    def note(self, text: str) -> None:
        """Say that something went wrong that costs no cell."""


def runner_for(suite: Suite, registry: Registry, jobs: int, cluster: str | None = None) -> Runner:
    """Make the runner of a suite, on this machine or by the address of a cluster."""
    limits = suite.plan.budget_s, suite.memory_gib
    if cluster:
        return ClusterRunner(registry.paths, cluster, *limits)
    return Runner(registry.paths, jobs, *limits)


def missing_cells(suite: Suite, store: Store, registry: Registry) -> list[Cell]:
    """List the cells without a readable record of this source, or with one of a smaller budget."""
    stored, with_rows = store.records(), store.keys_with_rows()

    def is_missing(cell: Cell) -> bool:
        record = stored.get(cell.key)
        return (
            record is None
            or cell.key not in with_rows
            or record.fingerprint != cell.fingerprint(registry)
            or (record.status == "budget_exceeded" and _raised(suite.plan.budget_s, record))
        )

    return list(filter(is_missing, suite.cells.values()))


def missing_scenes(suite: Suite, store: Store, registry: Registry) -> list[tuple[str, float]]:
    """List the scenes, by name and end time in s, that have no record of this source."""
    stored = store.scenes()
    wanted = sorted({(study.problem, study.t_end) for study in suite.plan.studies})
    return [
        (problem, t_end)
        for problem, t_end in wanted
        if (problem, t_end) not in stored
        or stored[problem, t_end].fingerprint != fingerprint(type(registry.problem(problem)))
    ]


def measure_suite(
    suite: Suite, store: Store, registry: Registry, runner: Runner, progress: Progress
) -> int:
    """Measure every cell and describe every scene that the store lacks.

    Each result is stored before the next is asked for; calling again goes on where it stopped.

    Returns
    -------
    int
        How many cells were measured.
    """
    cells, scenes = missing_cells(suite, store, registry), missing_scenes(suite, store, registry)
    store.save_plan(suite.plan)
    store.forget_spoilt_samples()
    number = 0
    if cells or _samples_due(suite, store.records()):
        number = store.save_environment(environment())
    if cells or scenes:
        groups = _groups(cells, scenes, registry)
        runner.expect(len(groups))
        groups = _longest_first(groups, registry)
        progress.phase("measuring", sum(len(group) for group in groups))
        for task, answer in runner.run(groups, lambda task: progress.working(task.label)):
            if task.job is Worker.scene:
                if isinstance(answer, NoAnswer):
                    progress.note(f"No picture of {task.arguments[0]}: {answer.message}")
                else:
                    store.save_scene(answer)
            else:
                record, rows = result_of(task.arguments[0], answer, registry)
                record.environment, record.budget_s = number, suite.plan.budget_s
                store.save(record, rows)
            progress.advance()
    return len(cells)


def time_suite(suite: Suite, store: Store, runner: Runner, progress: Progress) -> None:
    """Take the timing samples that the store lacks, of the cells that reached the end."""
    records = store.records()
    due = _samples_due(suite, records)
    if not due:
        return
    good = {key for key, record in records.items() if record.status == "ok"}
    cells = [cell for key, cell in suite.cells.items() if key in good]
    have = {cell.key: tuple(records[cell.key].run_s) for cell in cells}
    progress.phase("timing, one run at a time", due)
    for cell, sample, seconds in runner.time(cells, suite.plan.samples, have):
        progress.working(cell.key)
        store.add_sample(cell.key, sample, seconds)
        progress.advance()


def solve_cells(
    cells: list[Cell], registry: Registry, samples: int, budget_s: float, memory_gib: float = 4.0
) -> list[CellResult]:
    """Measure a few cells of one integrator without a store, timed ``samples`` times."""
    results = {}
    with Runner(registry.paths, 1, budget_s, memory_gib) as runner:
        for task, answer in runner.run([list(map(measure_task, cells))]):
            cell = task.arguments[0]
            results[cell.key] = result_of(cell, answer, registry)
        good = [cell for cell in cells if results[cell.key].record.status == "ok"]
        for cell, _, seconds in runner.time(good, samples, {}):
            results[cell.key].record.run_s.append(seconds)
    return [results[cell.key] for cell in cells]


def describe_scenes(
    scenes: list[MechatronicSystem],
    registry: Registry,
    budget_s: float,
    progress: Progress,
    memory_gib: float = 4.0,
) -> list[SceneRecord]:
    """Make records of scenes over their own intervals; one that fails is noted and left out."""
    records = {}
    groups = [[scene_task(scene.spec, scene.interval[1])] for scene in scenes]
    progress.phase("references", len(groups))
    with Runner(registry.paths, 2, budget_s, memory_gib) as runner:
        for task, answer in runner.run(groups, lambda task: progress.working(task.label)):
            if isinstance(answer, NoAnswer):
                progress.note(f"No picture of {task.arguments[0]}: {answer.message}")
            else:
                records[task.arguments[0]] = answer
            progress.advance()
    return [records[scene.spec] for scene in scenes if scene.spec in records]


def result_of(cell: Cell, answer: CellResult | NoAnswer, registry: Registry) -> CellResult:
    """Return the result of a cell; one that has no answer has a record with the reason."""
    if isinstance(answer, NoAnswer):
        record = cell.record(registry, answer.status, answer.message)
        return CellResult(record, Rows(t=[], values={}))
    return answer


# ---- parts -----------------------------------------------------------------------------
def _samples_due(suite: Suite, records: Mapping[str, Record]) -> int:
    """Count the timing samples that the measured cells still lack."""
    good = [records[key] for key in suite.cells if key in records and records[key].status == "ok"]
    return sum(
        max(0, suite.plan.samples - len(record.run_s))
        for record in good
        if sum(record.run_s) <= TIMING_SECONDS
    )


def _raised(budget_s: float, record: Record) -> bool:
    return record.budget_s is not None and budget_s > record.budget_s


def _groups(
    cells: list[Cell], scenes: list[tuple[str, float]], registry: Registry
) -> list[list[Task]]:
    """Group cells that share compiled code; the record of a scene comes before its cells."""
    groups: dict[tuple, list[Task]] = {}
    for problem, t_end in scenes:
        groups[problem, t_end] = [scene_task(problem, t_end)]
    for cell in cells:
        key = (cell.problem, registry.integrator(cell.integrator).affinity)
        groups.setdefault(key, []).append(measure_task(cell))
    return list(groups.values())


def _longest_first(groups: list[list[Task]], registry: Registry) -> list[list[Task]]:
    """Sort groups so that no worker is left alone with the longest one in the end."""

    def weight(group: list[Task]) -> float:
        scene = group[0].scene
        return _weight(registry.problem(scene)) if scene else 0.0

    return sorted(groups, key=weight, reverse=True)


def _weight(scene: MechatronicSystem) -> float:
    """Estimate how long runs of a scene take: steps times the square of its states."""
    try:
        states = sum(np.size(part) for part in scene.initial_state())
    except Exception:  # it may be a plugin, and its runs will say what is wrong
        return 0.0
    return (scene.interval[1] - scene.interval[0]) / scene.nominal_step * states**2
