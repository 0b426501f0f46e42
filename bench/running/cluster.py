"""Runs on other machines: groups of tasks go to a dask.distributed scheduler.

Only what does not depend on the machine is sent away: errors and counts. Timing stays here, in
one worker process, so that times of different machines are never compared.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from bench.plugins.registry import Registry
from bench.running.processes import NoAnswer
from bench.running.runner import Runner, Task
from problems.plain_text import named, said
from problems.spec import SpecError

CONNECT_SECONDS = 10


class ClusterRunner(Runner):
    """A runner whose tasks of ``run`` are done by a cluster; times are taken on this machine.

    A group goes to one worker of the cluster, which guards its budgets by a process of its own. A
    worker that dies costs its group nothing but time: the scheduler gives it to another one.

    Parameters
    ----------
    plugin_paths
        Plugin files and folders; the cluster's workers must find them under the same names.
    address
        Of the scheduler, such as tcp://host:8786.
    budget_s, memory_gib
        The most that one task may take, as in Runner.

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
        if address.startswith(("tls:", "wss:")):
            _require_certificates(address)
        try:
            self._client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError, RuntimeError) as error:
            raise SpecError(
                f"No dask scheduler answers at {address!r} ({said(error)}); start one by "
                f"'dask scheduler' and give its address, such as tcp://host:8786."
            ) from None
        self._arguments = list(map(str, plugin_paths)), 1, budget_s, memory_gib
        super().__init__(*self._arguments)

    def __enter__(self) -> ClusterRunner:
        return self

    def __exit__(self, *details: object) -> None:
        self._client.close()
        super().__exit__(*details)

    def expect(self, groups: int) -> None:
        """Do nothing: the workers of a cluster are there."""

    def run(
        self, groups: Iterable[list[Task]], on_start: Callable[[Task], None] = lambda _: None
    ) -> Iterator[tuple[Task, Any]]:
        """Yield every task with its answer, or NoAnswer, as the groups are finished."""
        from distributed import as_completed

        sent = {}
        for group in groups:
            if group:
                on_start(group[0])
                # Runs are repeatable, but not pure in dask's sense: nothing may be taken from
                # an earlier session of the same scheduler, whose code may be another.
                sent[self._client.submit(_run_group, group, self._arguments, pure=False)] = group
        for future in as_completed(sent, loop=self._client.loop):
            yield from self._collect(future, sent[future])

    @staticmethod
    def _collect(future: Any, group: list[Task]) -> list[tuple[Task, Any]]:
        try:
            return list(zip(group, future.result(), strict=True))
        except Exception as error:
            lost = NoAnswer("crashed", f"The cluster could not run it: {named(error)}")
            return [(task, lost) for task in group]


def _require_certificates(address: str) -> None:
    """Refuse an address whose encryption is not configured, which the client finds out by hanging.

    Raises
    ------
    SpecError
        If dask's configuration names no certificates, or they cannot be read.
    """
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


def _run_group(group: list[Task], arguments: tuple[list[str], int, float, float]) -> list[Any]:
    """Answer a group of tasks, in order, in a worker of the cluster."""
    # A worker that has a nanny may not have children by default; ours end with it.
    multiprocessing.current_process().daemon = False
    Registry(arguments[0]).require_files()  # says what is missing; a child would only die of it
    with Runner(*arguments) as runner:
        answers = dict(runner.run([group]))
    return [answers[task] for task in group]
