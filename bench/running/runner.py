"""The runner: shares tasks out to worker processes, and takes times in one of them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.results.records import TIMING_SECONDS
from bench.running.plan import Cell
from bench.running.processes import GuardedProcess, NoAnswer, wait_for_any
from bench.running.worker import Worker, start_worker


@dataclass(frozen=True)
class Task:
    """A job for a worker process.

    Parameters
    ----------
    job
        A function of a module, called with the `Worker` of the process and ``arguments``.
    arguments
        Values that can be sent to another process.
    label
        Names the task to the person who waits.
    scene
        The scene whose reference it needs, if any.
    """

    job: Callable[..., Any]
    arguments: tuple
    label: str = ""
    scene: str | None = None


def measure_task(cell: Cell, errors: bool = True) -> Task:
    """Make the task that measures a cell; its answer is a `CellResult`."""
    return Task(Worker.measure, (cell, errors), label=cell.key, scene=cell.problem)


def scene_task(problem: str, t_end: float) -> Task:
    """Make the task that describes a scene up to ``t_end`` in s; it answers a `SceneRecord`."""
    return Task(Worker.scene, (problem, t_end), label=f"reference of {problem}", scene=problem)


class _WorkerProcess(GuardedProcess):
    """A worker process with the task in work, the rest of its group, and the scenes it has had."""

    def __init__(self, plugin_paths: list[str], budget_s: float, memory_gib: float) -> None:
        super().__init__(start_worker, (plugin_paths,), budget_s, memory_gib)
        self.group: deque[Task] = deque()
        self.task: Task | None = None
        self.scenes: set[str | None] = set()

    def begin(self, task: Task) -> None:
        self.task = task
        self.start(task.job, *task.arguments)


class Runner:
    """Runs tasks in worker processes; use as a context manager.

    Parameters
    ----------
    plugin_paths
        Plugin files and folders, loaded in every worker process.
    jobs
        Most processes at a time. Timing is always done by one alone.
    budget_s, memory_gib
        The most that one task may take; more ends it with status "budget_exceeded".
    """

    def __init__(
        self, plugin_paths: list[str], jobs: int, budget_s: float, memory_gib: float
    ) -> None:
        self._jobs, self._guards = jobs, (plugin_paths, budget_s, memory_gib)
        self.workers: list[_WorkerProcess] = []
        self._owner: dict[str, _WorkerProcess] = {}

    def __enter__(self) -> Runner:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self.workers:
            worker.end()
        self.workers.clear()

    def expect(self, groups: int) -> None:
        """Start the workers that so many groups will need: they load what they need meanwhile."""
        while len(self.workers) < min(self._jobs, groups):
            self._spawn()

    def run(
        self, groups: Iterable[list[Task]], on_start: Callable[[Task], None] = lambda _: None
    ) -> Iterator[tuple[Task, Any]]:
        """Yield every task with its answer, or NoAnswer, as they finish; a group stays together."""
        queue = deque(deque(group) for group in groups if group)
        while queue or self._busy():
            self._feed(queue, on_start)
            wait_for_any(worker for worker in self.workers if worker.task)
            for worker in list(self.workers):
                task = worker.task
                if task and (answer := self._take(worker)) is not None:
                    yield task, answer

    def time(
        self, cells: list[Cell], samples: int, have: Mapping[str, Sequence[float]]
    ) -> Iterator[tuple[Cell, int, float]]:
        """Yield (cell, round, seconds): a sample of each cell in every round, one at a time.

        The cells of a scene follow one another, so that samples of one round are neighbours in
        time and can be compared by their quotient.

        ``have`` are the samples, in s, that were taken before.
        """
        spent = {cell.key: sum(have.get(cell.key, ())) for cell in cells}
        scenes = list(dict.fromkeys(cell.problem for cell in cells))
        cells = sorted(cells, key=lambda cell: scenes.index(cell.problem))
        for number in range(samples):
            for cell in cells:
                if number < len(have.get(cell.key, ())) or spent[cell.key] > TIMING_SECONDS:
                    continue
                worker = self._timekeeper(cell)
                answer = worker.ask(Worker.time, cell)
                if isinstance(answer, NoAnswer):
                    spent[cell.key] = float("inf")
                    self._replace_dead(worker)
                    continue
                self._owner[cell.key] = worker
                spent[cell.key] += answer
                yield cell, number, answer

    # ---- parts -------------------------------------------------------------------------
    def _spawn(self) -> _WorkerProcess:
        worker = _WorkerProcess(*self._guards)
        self.workers.append(worker)
        return worker

    def _timekeeper(self, cell: Cell) -> _WorkerProcess:
        """The worker that has prepared a cell, if it lives, or any."""
        worker = self._owner.get(cell.key)
        if worker and worker.alive:
            return worker
        return self.workers[0] if self.workers else self._spawn()

    def _feed(self, queue: deque[deque[Task]], on_start: Callable[[Task], None]) -> None:
        while queue and len(self.workers) < min(self._jobs, len(queue) + self._busy()):
            self._spawn()
        for worker in self.workers:
            if worker.task:
                continue
            if not worker.group and queue:
                worker.group = self._next(queue, worker)
            if worker.group:
                task = worker.group.popleft()
                on_start(task)
                worker.begin(task)

    def _next(self, queue: deque[deque[Task]], worker: _WorkerProcess) -> deque[Task]:
        """The first group of a scene that the worker has had, else of one that no other has: each
        worker makes its own references, which can take longer than the runs."""
        others = set().union(*(w.scenes for w in self.workers if w is not worker))
        scenes = [group[0].scene for group in queue]
        ranks = [(scene not in worker.scenes, scene in others) for scene in scenes]
        best = ranks.index(min(ranks))
        group = queue[best]
        del queue[best]
        worker.scenes.add(scenes[best])
        return group

    def _busy(self) -> int:
        return sum(1 for w in self.workers if w.task or w.group)

    def _take(self, worker: _WorkerProcess) -> Any:
        """The answer of a worker's task, NoAnswer, or None while it is in work."""
        answer = worker.take()
        if answer is None:
            return None
        task, worker.task = worker.task, None
        if not isinstance(answer, NoAnswer) and task and task.job is Worker.measure:
            self._owner[task.arguments[0].key] = worker
        self._replace_dead(worker)
        return answer

    def _replace_dead(self, worker: _WorkerProcess) -> None:
        """Give the rest of a dead worker's group to another worker."""
        if not worker.alive:
            self.workers.remove(worker)
            if worker.group:
                self._spawn().group = worker.group
