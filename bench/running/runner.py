"""A runner: shares tasks out to worker processes, and takes times in one of them."""

from __future__ import annotations

import math
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

from bench.plugins.registry import Sources
from bench.results.records import TIMING_SECONDS
from bench.running.inventory import SceneFacts
from bench.running.plan import Cell
from bench.running.process import REFERENCE, GuardedProcess, Limits, NoAnswer, wait_for_any
from bench.running.worker import Worker, start_worker

#: Help for whoever has a run that was stopped.
_ADVICE = "take larger steps or tolerances, a shorter interval, or a larger --budget"
#: Workers without a task that are kept, as they have prepared runs, beside those in work.
_MOST_IDLE = 8


@dataclass(frozen=True)
class Task:
    """A job for a worker process: a function of a module, called with the `Worker` of the process
    and ``arguments``, which can be sent there.

    ``label`` names it to the person who waits. ``scene`` is the one whose reference it needs, if
    any; then the job takes a keyword ``lacking``, the reason why there is no reference. ``sources``
    are the plugins from outside that it needs: workers load nothing else, so that no plugin can
    change the numbers of others. Tasks with the same names of compiled ``programs`` share these.
    """

    job: Callable[..., Any]
    arguments: tuple
    label: str = ""
    scene: str | None = None
    sources: Sources = frozenset()
    programs: str = ""


def cell_task(job: Callable[..., Any], cell: Cell, *more: Any) -> Task:
    """Make the task of a cell: to measure it (`Worker.measure`), or to time it (`Worker.time`)."""
    sources = cell.scene.sources | cell.method.sources
    return Task(job, (cell, *more), cell.key, cell.problem, sources, cell.method.affinity)


def scene_task(scene: SceneFacts, t_end: float) -> Task:
    """Make the task that describes a scene up to ``t_end`` in s; it answers a `SceneRecord`."""
    about = f"reference of {scene.spec}"
    return Task(Worker.scene, (scene.spec, t_end), about, scene.spec, scene.sources)


class Progress:
    """Messages to the person who waits; this one passes them over."""

    def __init__(self) -> None:
        self._printed: set[str] = set()

    def phase(self, name: str, total: int | None) -> None:
        """Say that a phase begins, with its number of steps if it is known."""

    def working(self, text: str) -> None:
        """Say that this is in work."""

    def advance(self) -> None:
        """Say that one step is done."""

    def note(self, text: str) -> None:
        """Say that something went wrong that costs no cell."""

    def printed(self, label: str, text: str) -> None:
        """Note what a task printed, each line once: a library says the same in every worker."""
        lines = [line for line in text.splitlines() if line not in self._printed]
        self._printed.update(lines)
        if lines:
            self.note(f"{label} printed: " + "\n".join(lines))


class OnStandardError(Progress):
    """Notes on the standard error, and nothing else."""

    def note(self, text: str) -> None:
        """Print a line."""
        print(text, file=sys.stderr)


class _WorkerProcess(GuardedProcess):
    """A worker process with the task in work, the rest of its group, and the scenes, programs and
    labels of tasks that it has had."""

    def __init__(self, sources: Sources, limits: Limits, draft: bool) -> None:
        super().__init__(start_worker, (sources, draft), limits)
        self.sources = sources
        self.group: deque[Task] = deque()
        self.task: Task | None = None
        self.had: set[str | tuple] = set()

    @property
    def busy(self) -> bool:
        return bool(self.task or self.group)


class Runner:
    """Runs tasks in worker processes; use as a context manager.

    At most ``jobs`` processes are in work at a time; times are taken by one alone. One task may
    take what ``limits`` allow. ``progress`` is told which task is in work, and what tasks print.
    ``run`` ends when the answers are not ``wanted`` any more. New processes of a ``draft`` compile
    without optimisation: sooner, for runs that are not timed.
    """

    draft = False

    def __init__(
        self,
        jobs: int,
        limits: Limits,
        progress: Progress | None = None,
        wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        self._jobs, self._limits = jobs, replace(limits, advice=limits.advice or _ADVICE)
        self.progress, self._wanted = progress or Progress(), wanted
        self.workers: list[_WorkerProcess] = []
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

    def run(
        self, groups: Iterable[list[Task]], offers: Callable[[], list[list[Task]]] = list
    ) -> Iterator[tuple[Task, Any]]:
        """Yield every task with its answer, or NoAnswer, as they finish; a group stays together.

        ``offers`` is called whenever a process is free of the ``groups``, and gives all groups that
        are worth their work now, the best first. Those that are not begun are forgotten.
        """
        queue = [deque(group) for group in groups if group]
        while self._wanted():
            self._feed(queue)
            if not queue and self._busy() < self._jobs:
                self._feed([*map(deque, offers())])
            working = [worker for worker in self.workers if worker.task]
            if not working:
                return
            wait_for_any(working)
            for worker in working:
                task = worker.task
                if task and (answer := self._take(worker, task)) is not None:
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
                spent[key] += answer
                yield task, number, answer

    # ---- parts -------------------------------------------------------------------------
    def _busy(self) -> int:
        return sum(worker.busy for worker in self.workers)

    def _spawn(self, sources: Sources) -> _WorkerProcess:
        idle = [worker for worker in self.workers if not worker.busy]
        for worker in idle[: max(0, len(idle) - _MOST_IDLE + 1)]:
            worker.end()
            self.workers.remove(worker)
        self.workers.append(worker := _WorkerProcess(sources, self._limits, self.draft))

        def tell(phase: str, words: str) -> None:
            """Name the reference while it is made, else the task."""
            if worker.task:
                self.progress.working(words if phase == REFERENCE else worker.task.label)

        worker.on_phase = tell
        return worker

    def _timekeeper(self, task: Task) -> _WorkerProcess:
        """The worker that has prepared a task's run, or any that may."""
        fit = (w for w in self.workers if w.sources == task.sources)
        worker = min(fit, key=lambda w: task.label not in w.had, default=None)
        worker = worker or self._spawn(task.sources)
        worker.had.add(task.label)
        return worker

    def _feed(self, queue: list[deque[Task]]) -> None:
        """Give groups to processes that are free, and have all begin their next tasks."""
        while queue and self._busy() < self._jobs:
            sources = {group[0].sources for group in queue}
            free = (w for w in self.workers if not w.busy and w.sources in sources)
            worker = next(free, None) or self._spawn(queue[0][0].sources)
            worker.group = self._next(queue, worker)
        for worker in self.workers:
            if worker.group and not worker.task:
                worker.task = task = worker.group.popleft()
                worker.had.add(task.label)
                self.progress.working(task.label)
                lacking = self._lacking.get(task.scene or "")
                named = {"lacking": lacking} if lacking else {}
                worker.start(task.job, *task.arguments, **named)

    def _next(self, queue: list[deque[Task]], worker: _WorkerProcess) -> deque[Task]:
        """The first group whose programs, or else whose scene, the worker has had, else one that
        no other has: else it would compile them, or make the reference, again."""
        others = set().union(*(w.had for w in self.workers if w is not worker))

        needs = [[(t.scene, t.programs), (t.scene,)] for t in (group[0] for group in queue)]

        def strangeness(k: int) -> list[bool]:
            return [known for n in needs[k] for known in (n not in worker.had, n in others)]

        fit = (k for k, group in enumerate(queue) if group[0].sources == worker.sources)
        best = min(fit, key=strangeness)
        worker.had.update(needs[best])
        return queue.pop(best)

    def _take(self, worker: _WorkerProcess, task: Task) -> Any:
        """The answer of a worker's task, NoAnswer, or None while it is in work or done again."""
        if (answer := worker.poll()) is None:
            return None
        self.progress.printed(task.label, worker.printed())
        worker.task = None
        failed = isinstance(answer, NoAnswer) and answer.status != "interrupted"
        if failed and answer.phase == REFERENCE and task.scene:
            self._lacking[task.scene] = answer.message
            worker.group.appendleft(task)
            answer = None
        self._replace_dead(worker)
        return answer

    def _replace_dead(self, worker: _WorkerProcess) -> None:
        """Give the rest of a dead worker's group to another worker."""
        if not worker.alive:
            self.workers.remove(worker)
            if worker.group:
                self._spawn(worker.sources).group = worker.group
