"""The runner: shares cells out to worker processes and guards their budgets of time and memory."""

from __future__ import annotations

import signal
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing import get_context
from multiprocessing.connection import wait
from typing import Any

import psutil

from bench.results.records import TIMING_SECONDS
from bench.running.plan import Cell
from bench.running.worker import serve

#: How often the memory of a worker is looked at.
_WATCH_SECONDS = 0.1


@dataclass(frozen=True)
class Task:
    """A job for a worker: ``kind`` is a method of its bench ("measure", "scene", "time")."""

    kind: str
    arguments: tuple

    @property
    def scene(self) -> str | None:
        """The scene whose reference it needs, if any."""
        if self.kind == "scene":
            return self.arguments[0]
        return self.arguments[0].problem if self.kind == "measure" else None


@dataclass(frozen=True)
class Lost:
    """A task that a worker could not answer, with the status and message of its row."""

    status: str
    message: str


@dataclass
class _Worker:
    process: Any
    pipe: Any
    group: deque[Task] = field(default_factory=deque)
    task: Task | None = None
    started: float = 0.0
    phase: str | None = None
    scenes: set[str | None] = field(default_factory=set)

    def end(self) -> None:
        """Kill it; it never holds anything that is not elsewhere."""
        self.process.kill()
        self.process.join()
        self.pipe.close()


class Runner:
    """Runs tasks in worker processes; use as a context manager.

    Parameters
    ----------
    plugin_paths
        Plugin files and folders, loaded in every worker.
    jobs
        Most workers at a time. Timing is always done by one alone.
    budget_s, memory_gib
        What one task may take; more ends it with status "budget_exceeded".
    """

    def __init__(
        self, plugin_paths: list[str], jobs: int, budget_s: float, memory_gib: float
    ) -> None:
        self._paths, self._jobs = plugin_paths, jobs
        self._budget, self._memory = budget_s, memory_gib * 2**30
        self._context = get_context("spawn")
        self._workers: list[_Worker] = []
        self._owner: dict[str, _Worker] = {}

    def __enter__(self) -> Runner:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.end()
        self._workers.clear()

    def expect(self, groups: int) -> None:
        """Start the workers that so many groups will need: they load what they need meanwhile."""
        while len(self._workers) < min(self._jobs, groups):
            self._spawn()

    def run(
        self, groups: Iterable[list[Task]], on_start: Callable[[Task], None] = lambda _: None
    ) -> Iterator[tuple[Task, Any]]:
        """Yield every task with its answer, or Lost, as they finish; a group stays together."""
        queue = deque(deque(group) for group in groups if group)
        while queue or any(w.task or w.group for w in self._workers):
            self._feed(queue, on_start)
            for worker in self._news():
                task, answer = worker.task, self._collect(worker)
                if answer is not None and task is not None:
                    yield task, answer

    def time(
        self, cells: list[Cell], samples: int, have: Mapping[str, Sequence[float]]
    ) -> Iterator[tuple]:
        """Yield (cell, number, seconds): samples taken in turn over all cells, one at a time.

        ``have`` are the samples, in s, that were taken before.
        """
        spent = {cell.key: sum(have.get(cell.key, ())) for cell in cells}
        for number in range(samples):
            for cell in cells:
                if number < len(have.get(cell.key, ())) or spent[cell.key] > TIMING_SECONDS:
                    continue
                worker = self._owner.get(cell.key)
                if worker not in self._workers:
                    worker = self._workers[0] if self._workers else self._spawn()
                answer = self._ask(worker, Task("time", (cell,)))
                if isinstance(answer, Lost):
                    spent[cell.key] = float("inf")
                    continue
                self._owner[cell.key] = worker
                spent[cell.key] += answer
                yield cell, number, answer

    # ---- plumbing ----------------------------------------------------------------------
    def _spawn(self) -> _Worker:
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=serve, args=(theirs, self._paths), daemon=True)
        process.start()
        theirs.close()
        worker = _Worker(process, ours)
        self._workers.append(worker)
        return worker

    def _start(self, worker: _Worker, task: Task) -> None:
        worker.task, worker.started, worker.phase = task, time.monotonic(), None
        with suppress(OSError):  # its death is seen by _collect
            worker.pipe.send((task.kind, *task.arguments))

    def _feed(self, queue: deque[deque[Task]], on_start: Callable[[Task], None]) -> None:
        while queue and len(self._workers) < min(self._jobs, len(queue) + self._busy()):
            self._spawn()
        for worker in self._workers:
            if worker.task:
                continue
            if not worker.group and queue:
                worker.group = self._next(queue, worker)
            if worker.group:
                task = worker.group.popleft()
                on_start(task)
                self._start(worker, task)

    def _next(self, queue: deque[deque[Task]], worker: _Worker) -> deque[Task]:
        """The first group of a scene that the worker has had, else of one that no other has: each
        worker makes its own references, which can take longer than the runs."""
        others = set().union(*(w.scenes for w in self._workers if w is not worker))
        scenes = [group[0].scene for group in queue]
        ranks = [(scene not in worker.scenes, scene in others) for scene in scenes]
        best = ranks.index(min(ranks))
        group = queue[best]
        del queue[best]
        worker.scenes.add(scenes[best])
        return group

    def _busy(self) -> int:
        return sum(1 for w in self._workers if w.task or w.group)

    def _news(self) -> list[_Worker]:
        """Workers that have an answer, have died, or have outrun a budget."""
        busy = [w for w in self._workers if w.task]
        ready = wait([w.pipe for w in busy], timeout=_WATCH_SECONDS)
        return [w for w in busy if w.pipe in ready or self._excess(w)]

    def _excess(self, worker: _Worker) -> str:
        seconds = time.monotonic() - worker.started
        if seconds > self._budget:
            return f"it took longer than the time budget of {self._budget:g} s"
        with suppress(psutil.Error):
            if psutil.Process(worker.process.pid).memory_info().rss > self._memory:
                return f"it used more memory than the budget of {self._memory / 2**30:g} GiB"
        return ""

    def _collect(self, worker: _Worker) -> Any:
        """The answer of a worker's task; None if it only said that it is ready."""
        task = worker.task
        if not worker.pipe.poll():
            excess = self._excess(worker)
            self._replace(worker)
            return Lost(
                "budget_exceeded",
                f"Stopped while {worker.phase or 'running'} because {excess}; take larger steps "
                f"or tolerances, a shorter interval, or a larger budget.",
            )
        try:
            kind, answer = worker.pipe.recv()
        except (EOFError, OSError):
            worker.process.join()
            code = worker.process.exitcode
            how = signal.Signals(-code).name if code and code < 0 else f"exit code {code}"
            self._replace(worker)
            return Lost("crashed", f"The worker process died during the run ({how}).")
        if kind in ("ready", "phase"):
            # The clock starts anew: imports and references are not the integrator's.
            worker.started, worker.phase = time.monotonic(), answer
            return None
        worker.task = None
        if kind == "failed":
            return Lost("crashed", answer)
        if task and task.kind == "measure":
            self._owner[task.arguments[0].key] = worker
        return answer

    def _replace(self, worker: _Worker) -> None:
        """End a worker; another one goes on with the rest of its group."""
        worker.end()
        self._workers.remove(worker)
        if worker.group:
            self._spawn().group = worker.group

    def _ask(self, worker: _Worker, task: Task) -> Any:
        self._start(worker, task)
        while True:
            if worker in self._news():
                answer = self._collect(worker)
                if answer is not None:
                    return answer
