"""A run from plan to store: measure what is missing, then time what succeeded."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from bench.plugins.registry import Registry, fingerprint
from bench.results.environment import environment
from bench.results.records import TIMING_SECONDS, Record, Rows, SceneRecord
from bench.results.store import Store
from bench.running import damping
from bench.running.cluster import ClusterRunner
from bench.running.plan import Cell, Suite
from bench.running.runner import Lost, Runner, Task
from bench.running.worker import Measured
from problems.system import MechatronicSystem


class Progress(Protocol):
    """What a run tells the person who waits."""

    def phase(self, name: str, total: int) -> None:
        """A phase begins that has this many steps."""

    def working(self, text: str) -> None:
        """This is in work."""

    def advance(self) -> None:
        """One step is done."""

    def note(self, text: str) -> None:
        """Something went wrong that costs no cell."""


@dataclass
class Outcome:
    """What an invocation did: cells measured now, cells found in the store, all records."""

    measured: int
    kept: int
    records: dict[str, Record]


def run_suite(
    suite: Suite,
    store: Store,
    registry: Registry,
    jobs: int,
    progress: Progress,
    cluster: str | None = None,
) -> Outcome:
    """Measure and time every cell of a suite that the store does not have yet.

    Each result is stored before the next is asked for; calling again goes on where it stopped.
    With the address of a ``cluster`` its workers measure; timing is always done here.
    """
    plan = suite.plan
    stored = store.records()
    missing = [
        cell
        for key, cell in suite.cells.items()
        if key not in stored
        or stored[key].fingerprint != cell.fingerprint(registry)
        or (stored[key].status == "budget_exceeded" and _raised(plan.budget_s, stored[key]))
    ]
    store.save_plan(damping.kept(plan, store.plan(), registry))
    wanted = {(s.problem, s.t_end) for s in plan.studies}
    current = {
        key
        for key, scene in store.scenes().items()
        if key in wanted and scene.fingerprint == fingerprint(type(registry.problem(key[0])))
    }
    scenes = wanted - current
    number = store.save_environment(environment()) if missing or _due(suite, stored) else 0
    limits = plan.budget_s, suite.memory_gib
    who = ClusterRunner(registry.paths, cluster, *limits) if cluster else None
    with who or Runner(registry.paths, jobs, *limits) as runner:
        if missing or scenes:
            groups = _groups(missing, sorted(scenes), registry)
            runner.expect(len(groups))
            groups = _longest_first(groups, registry)
            progress.phase("measuring", sum(len(group) for group in groups))
            for task, answer in runner.run(groups, lambda t: progress.working(_words(t))):
                if task.kind == "scene":
                    if isinstance(answer, Lost):
                        progress.note(f"No picture of {task.arguments[0]}: {answer.message}")
                    else:
                        store.save_scene(answer)
                else:
                    record, rows = row_of(task.arguments[0], answer, registry)
                    record.environment, record.budget_s = number, plan.budget_s
                    store.save(record, rows)
                progress.advance()
        _analyse(suite, store, runner, registry, progress)
        _time(suite, store, runner, progress)
    return Outcome(len(missing), len(suite.cells) - len(missing), store.records())


def solve_cells(
    cells: list[Cell], registry: Registry, samples: int, budget_s: float, memory_gib: float = 4.0
) -> list[tuple[Record, Rows]]:
    """Measure a few cells of one integrator without a store, timed ``samples`` times."""
    with Runner(registry.paths, 1, budget_s, memory_gib) as runner:
        answers = {}
        for task, answer in runner.run([[Task("measure", (cell,)) for cell in cells]]):
            cell = task.arguments[0]
            answers[cell.key] = row_of(cell, answer, registry)
        good = [cell for cell in cells if answers[cell.key][0].status == "ok"]
        for cell, _, seconds in runner.time(good, samples, {}):
            answers[cell.key][0].run_s.append(seconds)
    return [answers[cell.key] for cell in cells]


def describe_scenes(
    scenes: list[MechatronicSystem],
    registry: Registry,
    budget_s: float,
    progress: Progress,
    memory_gib: float = 4.0,
) -> list[SceneRecord]:
    """Records of scenes over their own intervals; one that fails is noted and left out."""
    records = {}
    groups = [[Task("scene", (scene.spec, scene.interval[1]))] for scene in scenes]
    progress.phase("references", len(groups))
    with Runner(registry.paths, 2, budget_s, memory_gib) as runner:
        for task, answer in runner.run(groups, lambda t: progress.working(_words(t))):
            if isinstance(answer, Lost):
                progress.note(f"No picture of {task.arguments[0]}: {answer.message}")
            else:
                records[task.arguments[0]] = answer
            progress.advance()
    return [records[scene.spec] for scene in scenes if scene.spec in records]


def _analyse(
    suite: Suite,
    store: Store,
    runner: Runner | ClusterRunner,
    registry: Registry,
    progress: Progress,
) -> None:
    due = damping.tasks(suite, store.scenes(), store.records(), registry)
    if not due:
        return
    progress.phase("damping of methods at constant steps", len(due))
    for task, answer in runner.run([due], lambda t: progress.working(_words(t))):
        damping.note(suite.plan, task, answer, registry)
        progress.advance()
    store.save_plan(suite.plan)


def _time(suite: Suite, store: Store, runner: Runner | ClusterRunner, progress: Progress) -> None:
    records = store.records()
    cells = [cell for key, cell in suite.cells.items() if records[key].status == "ok"]
    have = {cell.key: tuple(records[cell.key].run_s) for cell in cells}
    due = _due(suite, records)
    if not due:
        return
    progress.phase("timing, one run at a time", due)
    for cell, sample, seconds in runner.time(cells, suite.plan.samples, have):
        progress.working(cell.key)
        store.add_sample(cell.key, sample, seconds)
        progress.advance()


def _due(suite: Suite, records: dict[str, Record]) -> int:
    """Timing samples that the measured cells still lack."""
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
    """Cells that share compiled code stay together; of each scene its record comes first."""
    groups: dict[tuple, list[Task]] = {}
    for problem, t_end in scenes:
        groups[problem, t_end] = [Task("scene", (problem, t_end))]
    for cell in cells:
        key = (cell.problem, registry.integrator(cell.integrator).affinity)
        groups.setdefault(key, []).append(Task("measure", (cell,)))
    return list(groups.values())


def _longest_first(groups: list[list[Task]], registry: Registry) -> list[list[Task]]:
    """So that no worker is left alone with what takes longest in the end."""
    weights = {task.scene: _weight(registry.problem(task.scene)) for task, *_ in groups}
    return sorted(groups, key=lambda group: -weights[group[0].scene])


def _weight(scene: MechatronicSystem) -> float:
    """How long runs of a scene take, roughly: steps times the square of its states."""
    try:
        states = sum(np.size(part) for part in scene.initial_state())
    except Exception:  # it may be a plugin, and its runs will say what is wrong
        return 0.0
    return (scene.interval[1] - scene.interval[0]) / scene.nominal_step * states**2


def _words(task: Task) -> str:
    if task.kind == "scene":
        return f"reference of {task.arguments[0]}"
    if task.kind == "damping":
        return f"damping of {task.arguments[0]}"
    return task.arguments[0].key


def row_of(cell: Cell, answer: Measured | Lost, registry: Registry) -> tuple[Record, Rows]:
    """The record and rows of a cell from what the runner answered."""
    if isinstance(answer, Measured):
        return answer.record, answer.rows
    return cell.record(registry, answer.status, answer.message), Rows(t=[], values={})
