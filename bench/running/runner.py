"""The runner: shares tasks out to worker processes, and takes times in one of them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Self

from bench.plugins.registry import Sources
from bench.results.records import TIMING_SECONDS
from bench.running.plan import Cell
from bench.running.process import GuardedProcess, Limits, NoAnswer, wait_for_any
from bench.running.progress import Progress
from bench.running.serve import REFERENCE, WAITING
from bench.running.worker import Worker, start_worker

#: Help for whoever has a run that was stopped.
_ADVICE = "take larger steps or tolerances, a shorter interval, or a larger --budget"
#: Workers without a task that are kept, as they have prepared runs, beside those in work.
_MOST_IDLE = 8


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
        The scene whose reference it needs, if any. Then the job takes a keyword ``lacking``, the
        reason why there is no reference.
    sources
        Plugins from outside that it needs. Workers load nothing else, so that no plugin can
        change the numbers of others.
    programs
        Names the compiled programs that it needs; tasks of the same programs share them.
    """

    job: Callable[..., Any]
    arguments: tuple
    label: str = ""
    scene: str | None = None
    sources: Sources = frozenset()
    programs: str = ""


def measure_task(cell: Cell, sources: Sources, errors: bool = True, programs: str = "") -> Task:
    """Make the task that measures a cell; its answer is a `CellResult`."""
    return Task(Worker.measure, (cell, errors), cell.key, cell.problem, sources, programs)


def time_task(cell: Cell, sources: Sources) -> Task:
    """Make the task that times a cell once; its answer is in s."""
    return Task(Worker.time, (cell,), cell.key, cell.problem, sources)


def scene_task(problem: str, t_end: float, sources: Sources) -> Task:
    """Make the task that describes a scene up to ``t_end`` in s; it answers a `SceneRecord`."""
    return Task(Worker.scene, (problem, t_end), f"reference of {problem}", problem, sources)


class _WorkerProcess(GuardedProcess):
    """A worker process with the task in work, the rest of its group, and the scenes and programs
    that it has had."""

    def __init__(self, sources: Sources, limits: Limits, draft: bool) -> None:
        super().__init__(start_worker, (sources, limits.processors, draft), limits)
        self.sources = sources
        self.group: deque[Task] = deque()
        self.task: Task | None = None
        self.had: set[tuple] = set()

    @property
    def busy(self) -> bool:
        return bool(self.task or self.group)


class Runner:
    """Runs tasks in worker processes; use as a context manager.

    Parameters
    ----------
    jobs
        Most processes in work at a time. Timing is always done by one alone.
    limits
        The most that one task may take.
    progress
        Told which task is in work, and what tasks print.
    wanted
        Whether anybody waits for the answers still; else ``run`` ends.

    Attributes
    ----------
    draft
        Whether new processes compile without optimisation: sooner, for runs that are not timed.
    """

    draft = False

    def __init__(
        self,
        jobs: int,
        limits: Limits,
        progress: Progress | None = None,
        wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        self._jobs, self._limits = jobs, replace(limits, advice=_ADVICE)
        self.progress, self._wanted = progress or Progress(), wanted
        self.workers: list[_WorkerProcess] = []
        self._owner: dict[str, _WorkerProcess] = {}
        self._lacking: dict[str, str] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end_workers()

    def end_workers(self) -> None:
        """End all worker processes; others are started when they are needed."""
        for worker in self.workers:
            worker.end()
        self.workers.clear()

    def run(self, groups: Iterable[list[Task]]) -> Iterator[tuple[Task, Any]]:
        """Yield every task with its answer, or NoAnswer, as they finish; a group stays together."""
        return self.run_offered(groups, list)

    def run_offered(
        self, groups: Iterable[list[Task]], offers: Callable[[], list[list[Task]]]
    ) -> Iterator[tuple[Task, Any]]:
        """Yield the tasks of some groups with their answers, and then of those that are offered.

        ``offers`` is called whenever a process is free, and gives all groups that are worth their
        work now, the best first. Those that are not begun are forgotten.
        """
        queue = deque(deque(group) for group in groups if group)
        while self._wanted():
            self._feed(queue)
            if not queue and self._busy() < self._jobs:
                self._feed(deque(map(deque, offers())))
            if not self._busy():
                return
            wait_for_any(worker for worker in self.workers if worker.task)
            for worker in list(self.workers):
                task = worker.task
                if task and (answer := self._take(worker)) is not None:
                    yield task, answer

    @property
    def begun(self) -> set[str]:
        """Labels of the tasks that processes have begun, or will do next."""
        return {task.label for w in self.workers for task in (w.task, *w.group) if task}

    def time(
        self,
        tasks: list[Task],
        samples: int,
        have: Mapping[str, Mapping[int, float]],
        most: float = TIMING_SECONDS,
    ) -> Iterator[tuple[Task, int, float]]:
        """Yield (task, round, seconds): a sample of each task in every round, one at a time.

        The tasks of a scene follow one another, so that samples of one round are neighbours in
        time and can be compared by their quotient.

        ``have`` are the samples, in s by their rounds, that were taken before, by the labels of the
        tasks. A task has no more rounds once its samples have lasted for ``most`` s.
        """
        spent = {task.label: sum(have.get(task.label, {}).values()) for task in tasks}
        scenes = list(dict.fromkeys(task.scene for task in tasks))
        tasks = sorted(tasks, key=lambda task: scenes.index(task.scene))
        for number in range(samples):
            for task in tasks:
                key = task.label
                if number in have.get(key, ()) or spent[key] > most:
                    continue
                if not self._wanted():
                    return
                worker = self._timekeeper(task)
                answer = worker.ask(task.job, *task.arguments)
                if isinstance(answer, NoAnswer):
                    if answer.status != "interrupted":
                        spent[key] = math.inf
                    self._replace_dead(worker)
                    continue
                self._owner[key] = worker
                spent[key] += answer
                yield task, number, answer

    # ---- parts -------------------------------------------------------------------------
    def _spawn(self, sources: Sources) -> _WorkerProcess:
        idle = [worker for worker in self.workers if not worker.busy]
        for worker in idle[: max(0, len(idle) - _MOST_IDLE + 1)]:
            worker.end()
            self.workers.remove(worker)
        worker = _WorkerProcess(sources, self._limits, self.draft)
        self.workers.append(worker)
        return worker

    def _timekeeper(self, task: Task) -> _WorkerProcess:
        """The worker that has prepared a task's run, if it lives, or any that may."""
        worker = self._owner.get(task.label)
        if worker and worker.alive:
            return worker
        fit = (w for w in self.workers if w.sources == task.sources)
        return next(fit, None) or self._spawn(task.sources)

    def _feed(self, queue: deque[deque[Task]]) -> None:
        for worker in self.workers:
            if not worker.busy and self._busy() < self._jobs:
                worker.group = self._next(queue, worker)
        while queue and self._busy() < self._jobs:
            worker = self._spawn(queue[0][0].sources)
            worker.group = self._next(queue, worker)
        for worker in self.workers:
            if worker.group and not worker.task:
                worker.task = task = worker.group.popleft()
                self.progress.working(task.label)
                worker.on_phase = partial(self._tell, task.label)
                lacking = self._lacking.get(task.scene or "")
                named = {"lacking": lacking} if lacking else {}
                worker.start(task.job, *task.arguments, **named)

    def _tell(self, label: str, phase: str, words: str) -> None:
        """Tell the reference that a task needs, while it is made, or the task."""
        self.progress.working(words if phase in (REFERENCE, WAITING) else label)

    def _next(self, queue: deque[deque[Task]], worker: _WorkerProcess) -> deque[Task]:
        """The first group whose programs, or else whose scene, the worker has had, else one that
        no other has: else it would compile them again, and may wait for the scene's reference."""
        others = set().union(*(w.had for w in self.workers if w is not worker))
        fit = [k for k, group in enumerate(queue) if group[0].sources == worker.sources]
        if not fit:
            return deque()

        def strangeness(k: int) -> list[bool]:
            needs = _needs(queue[k][0])
            return [known for need in needs for known in (need not in worker.had, need in others)]

        best = min(fit, key=strangeness)
        group = queue[best]
        del queue[best]
        worker.had.update(_needs(group[0]))
        return group

    def _busy(self) -> int:
        return sum(1 for worker in self.workers if worker.busy)

    def _take(self, worker: _WorkerProcess) -> Any:
        """The answer of a worker's task, NoAnswer, or None while it is in work or done again."""
        answer, task = worker.poll(), worker.task
        if answer is None or task is None:
            return None
        if text := worker.printed():
            self.progress.printed(task.label, text)
        worker.task = None
        if isinstance(answer, NoAnswer):
            if answer.phase == REFERENCE and answer.status != "interrupted" and task.scene:
                self._lacking[task.scene] = answer.message
                worker.group.appendleft(task)
                answer = None
        elif task.job is Worker.measure:
            self._owner[task.label] = worker
        self._replace_dead(worker)
        return answer

    def _replace_dead(self, worker: _WorkerProcess) -> None:
        """Give the rest of a dead worker's group to another worker."""
        if not worker.alive:
            self.workers.remove(worker)
            if worker.group:
                self._spawn(worker.sources).group = worker.group


def _needs(task: Task) -> list[tuple]:
    """The programs and the scene of a task."""
    return [(task.scene, task.programs), (task.scene,)]
