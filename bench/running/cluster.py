"""Runs on other machines: groups of tasks go to a dask.distributed scheduler.

Only what does not depend on the machine is sent away: errors and counts. Timing stays here, in
one worker process, so that times of different machines are never compared.
"""

from __future__ import annotations

import time
from asyncio import CancelledError
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import Any

from bench.plugins.registry import plugin_files
from bench.running.process import Limits, NoAnswer
from bench.running.runner import Progress, Runner, Task
from problems.base.spec import SpecError
from problems.base.text import described, said

CONNECT_SECONDS = 10
#: Most short tasks in a group, which costs a process of its own, and fewest groups for each thread
#: of the workers, so that they end together.
_MOST_TOGETHER, _FEWEST_GROUPS = 16, 4
#: Time in s between two looks for answers.
_BETWEEN = 0.05


class ClusterRunner(Runner):
    """A runner whose tasks of ``run`` are done by a cluster; times are taken on this machine.

    A group goes to one worker of the cluster, which guards its budgets by a process of its own. A
    worker that dies costs its group nothing but time: the scheduler gives it to another one. The
    ``address`` is that of the scheduler, such as tcp://host:8786, whose workers must find plugin
    files under the same names.

    Raises
    ------
    SpecError
        If dask.distributed is not installed, or no scheduler answers.
    """

    def __init__(self, address: str, limits: Limits, progress: Progress | None = None) -> None:
        try:
            from distributed import Client
        except ImportError:
            raise SpecError(
                "--cluster needs dask.distributed; install it by: pip install 'stepbench[cluster]'."
            ) from None
        if address.startswith(("tls:", "wss:")):
            _require_certificates(address)
        try:
            self._client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError, RuntimeError) as error:
            raise SpecError(
                f"No dask scheduler answers at {address!r} ({said(error)}); start one by "
                f"'dask scheduler' and give its address, such as tcp://host:8786."
            ) from None
        super().__init__(1, limits, progress)

    def __exit__(self, *details: object) -> None:
        self._client.close()
        super().__exit__(*details)

    def together(self, count: int) -> int:
        """Return how many of so many short tasks are best sent as a group."""
        threads: Any = {}  # of each worker; there may be none yet
        with suppress(Exception, CancelledError):  # the scheduler is gone, as run() will tell
            threads = self._client.nthreads()
        groups = max(1, _FEWEST_GROUPS * sum(threads.values()))
        return max(1, min(_MOST_TOGETHER, count // groups))

    def run(
        self, groups: Iterable[list[Task]], offers: Callable[[], list[list[Task]]] = list
    ) -> Iterator[tuple[Task, Any]]:
        """Yield every task with its answer, or NoAnswer, as the groups are finished."""
        from distributed import as_completed

        sent, due = {}, {id(group): group for group in groups if group}
        try:
            for group in due.values():
                self.progress.working(group[0].label)
                # Runs are repeatable, but not pure in dask's sense: nothing may be taken from
                # an earlier session of the same scheduler, whose code may be another.
                sent[self._client.submit(_run_group, group, self._limits, pure=False)] = group
            completed = as_completed(list(sent), loop=self._client.loop)
            while due:
                # A wait without end would not see that the client has given its scheduler up.
                for future in completed.next_batch(block=False):
                    # Nobody else may keep it: the cluster holds an answer as long as it lives.
                    group = due.pop(id(sent.pop(future)))
                    yield from self._collect(future, group)
                if self._client.status == "closed":
                    raise ConnectionError("the scheduler does not answer any more")
                time.sleep(_BETWEEN)
        except (Exception, CancelledError) as error:  # the scheduler is gone
            for group in due.values():
                yield from _lost(group, error)

    def _collect(self, future: Any, group: list[Task]) -> list[tuple[Task, Any]]:
        try:
            answers = []
            for task, (printed, answer) in zip(group, future.result(), strict=True):
                if printed:
                    self.progress.printed(task.label, printed)
                answers.append((task, answer))
            return answers
        except Exception as error:
            return _lost(group, error)


def _lost(group: list[Task], error: BaseException) -> list[tuple[Task, Any]]:
    """The tasks of a group, each with the reason why it has no answer."""
    reason = f"The cluster could not run it: {described(error)}"
    return [(task, NoAnswer(status="interrupted", message=reason)) for task in group]


def _require_certificates(address: str) -> None:
    """Refuse an address without certificates, which the client finds out by hanging."""
    import dask.config
    from distributed import Security

    loader = dask.config.get("distributed.client.security-loader", None)
    try:
        context = Security().get_connection_args("client").get("ssl_context")
    except OSError as error:
        raise SpecError(f"Certificates for {address!r} cannot be read: {said(error)}.") from None
    if not (context or loader):
        raise SpecError(
            f"{address!r} needs certificates; name them in dask's configuration, by "
            "DASK_DISTRIBUTED__COMM__TLS__CA_FILE, ..._TLS__CLIENT__CERT and ..._TLS__CLIENT__KEY."
        )


def _run_group(group: list[Task], limits: Limits) -> list[tuple[str, Any]]:
    """Answer a group of tasks, in order, in a worker of the cluster; with what each printed."""
    for task in group:
        plugin_files(sorted(task.sources))  # says what is missing; a child would die of it
    texts, progress = dict[str, str](), Progress()
    progress.printed = lambda label, text: texts.update({label: text})
    with Runner(1, limits, progress, _wanted()) as runner:
        answers = dict(runner.run([group]))
    return [(texts.get(t.label, ""), answers[t]) for t in group if t in answers]


def _wanted() -> Callable[[], bool]:
    """Return a function that tells, in a worker of the cluster, whether its task is wanted still:
    the scheduler takes it back when the client has ended."""
    from distributed import get_worker

    worker = get_worker()
    key, tasks = worker.get_current_task(), worker.state.tasks
    return lambda: key in tasks and tasks[key].state != "cancelled"
