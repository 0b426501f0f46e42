"""Runs on other machines: groups of tasks go to a dask.distributed scheduler.

Only what does not depend on the machine is sent away: errors and counts. Timing stays here, in
one worker process, so that times of different machines are never compared.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from bench.plugins.registry import Registry
from bench.running.plan import Cell
from bench.running.runner import Lost, Runner, Task
from problems.spec import SpecError

_CONNECT_SECONDS = 10


class ClusterRunner:
    """Like `bench.running.runner.Runner`, with the tasks of ``run`` done by a cluster.

    A group goes to one worker of the cluster, which guards its budgets by a process of its own. A
    worker that dies costs its group nothing but time: the scheduler gives it to another one.

    Parameters
    ----------
    plugin_paths
        Plugin files and folders; the cluster's workers must find them under the same names.
    address
        Of the scheduler, such as tcp://host:8786.
    budget_s, memory_gib
        What one task may take, as in Runner.

    Raises
    ------
    SpecError
        If dask.distributed is not installed, or no scheduler answers.
    """

    def __init__(
        self, plugin_paths: list[str], address: str, budget_s: float, memory_gib: float
    ) -> None:
        try:
            from distributed import Client
        except ImportError:
            raise SpecError(
                "--cluster needs dask.distributed; install it by: pip install 'stepbench[cluster]'."
            ) from None
        try:
            self._client = Client(address, timeout=_CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise SpecError(
                f"No dask scheduler answers at {address!r} ({error or 'no answer'}); start one by "
                f"'dask scheduler' and give its address, such as tcp://host:8786."
            ) from None
        self._guards = (list(map(str, plugin_paths)), 1, budget_s, memory_gib)
        self._local = Runner(*self._guards)

    def __enter__(self) -> ClusterRunner:
        return self

    def __exit__(self, *details: object) -> None:
        self._client.close()
        self._local.__exit__(*details)

    def expect(self, groups: int) -> None:
        """As Runner.expect; the workers of a cluster are there."""

    def run(
        self, groups: Iterable[list[Task]], on_start: Callable[[Task], None] = lambda _: None
    ) -> Iterator[tuple[Task, Any]]:
        """Yield every task with its answer, or Lost, as the groups are finished."""
        from distributed import as_completed

        sent = {}
        for group in groups:
            if group:
                on_start(group[0])
                # Runs are repeatable, but not pure in dask's sense: nothing may be taken from
                # an earlier session of the same scheduler, whose code may be another.
                sent[self._client.submit(_answers, group, self._guards, pure=False)] = group
        for future in as_completed(sent, loop=self._client.loop):
            yield from self._collect(future, sent[future])

    def time(
        self, cells: list[Cell], samples: int, have: Mapping[str, Sequence[float]]
    ) -> Iterator[tuple]:
        """As Runner.time, on this machine."""
        return self._local.time(cells, samples, have)

    @staticmethod
    def _collect(future: Any, group: list[Task]) -> list[tuple[Task, Any]]:
        try:
            return list(zip(group, future.result(), strict=True))
        except Exception as error:
            lost = Lost("crashed", f"The cluster could not run it: {type(error).__name__}: {error}")
            return [(task, lost) for task in group]


def _answers(group: list[Task], guards: tuple) -> list[Any]:
    """Done by a worker of the cluster: the answers to a group of tasks, in order."""
    # A worker that has a nanny may not have children by default; ours end with it.
    multiprocessing.current_process()._config["daemon"] = False
    Registry(guards[0]).require_files()  # says what is missing; a child would only die of it
    with Runner(*guards) as runner:
        answers = dict(runner.run([group]))
    return [answers[task] for task in group]
