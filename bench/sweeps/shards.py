"""Shards of an ensemble: run by worker processes, or by a cluster, and kept as they come.

How the members are divided depends on their number and the kind of device alone, and a member's
values on its own number: whoever runs a shard, and when, gives the same bits, on processors of the
same kind with the same libraries.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.guard.process import NoAnswer, Refused
from bench.plugins.facts import Sources
from bench.plugins.fingerprint import fingerprint
from bench.running.progress import Progress
from bench.running.runner import Runner, Task
from bench.running.session import OTHER_ANSWER
from bench.sweeps.ensemble import Ensemble
from bench.sweeps.jobs import EnsemblePlan, EnsembleRequest, plan_job, shard_job
from bench.sweeps.parts import Columns, Parts, TemporaryParts, read_part
from bench.sweeps.variation import drawn
from problems.spec import SpecError

#: A shard that something ended from outside is begun so many times.
_TRIES = 3
#: So many shards that fail, and none that succeeds, end the ensemble.
_MOST_FAILED = 8
#: A worker draws the values with its own exponential function, which may round differently.
_SAME_DRAW = 1e-9


class ShardRun:
    """The shards of an ensemble that one command runs.

    Parameters
    ----------
    runner
        Plans the ensemble in a process of this machine.
    request, sources
        What is run.
    progress
        Told how many shards are done.

    Attributes
    ----------
    plan
        What the request means.
    lost
        Members of shards that have no answer, or whose budget did not last, with the reason.
    members, compile_s, run_s, wall_s
        Number of members that were run now, and seconds that their shards took to prepare and to
        run, added up, and by the clock.

    Raises
    ------
    SpecError
        If the request is refused.
    """

    def __init__(
        self, runner: Runner, request: EnsembleRequest, sources: Sources, progress: Progress
    ) -> None:
        self._request, self._sources, self._progress = request, sources, progress
        self._about = f"{request.integrator} on {request.problem}"
        task = Task(plan_job, (request,), self._about, sources=sources)
        ((_, answer),) = runner.run([[task]])
        self.plan: EnsemblePlan = self._answered(answer)
        self.lost = TemporaryParts()
        self.members, self.compile_s, self.run_s, self.wall_s = 0, 0.0, 0.0, 0.0

    @property
    def about(self) -> dict[str, Any]:
        """Causes of the members' values, without the sources of scene and integrator, for JSON."""
        asked = self._request
        given = {name: repr(value) for name, value in asked.given.items()}
        return {
            "problem": asked.problem,
            "integrator": asked.integrator,
            "t_end": self.plan.t_end,
            **given,
            "vary": list(asked.vary),
            "seed": asked.seed,
            "members": asked.count,
            "shards": self.plan.shards,
            "code": fingerprint(ShardRun),  # with the draw, and the versions of libraries
        }

    def complete(self, runner: Runner, parts: Parts, threads: int, together: int = 1) -> None:
        """Run the shards that are missing among the parts, and put each there when it comes.

        A shard that is ended from outside is run again. One that ends its process itself, or uses
        up its budget, costs its own members alone, unless none succeeds.

        Parameters
        ----------
        runner
            Runs the shards.
        parts
            Where the results are kept.
        threads
            Threads of each worker.
        together
            Number of shards that a worker gets at a time.

        Raises
        ------
        SpecError
            If no shard can be run, or one is ended from outside again and again.
        """
        tries, began = Counter[int](), time.perf_counter()
        failed: dict[int, NoAnswer] = {}
        have = parts.numbers()
        pattern = read_part(parts.opened(min(have))) if have else {}
        missing = [k for k in range(self.plan.shards) if k not in have]
        if len(missing) > 1:
            self._progress.phase("running shards", len(missing))
        while missing:
            tasks = {self._task(k, threads): k for k in missing}
            missing, due = [], [*tasks]
            groups = [due[k : k + together] for k in range(0, len(due), together)]
            together = 1  # whatever ends a worker costs no other shard a second time
            for task, answer in runner.run(groups):
                k, (_, first, count, _) = tasks[task], task.arguments
                tries[k] += 1
                columns = answer.columns(first) if isinstance(answer, Ensemble) else {}
                if columns and not self._is_of(columns, first, count, pattern):
                    answer = NoAnswer(status="crashed", message=OTHER_ANSWER)
                if not isinstance(answer, NoAnswer):
                    pattern = pattern or columns
                    (parts if answer.whole else self.lost).put(k, columns)
                    self.members += count
                    self.compile_s += answer.compile_s
                    self.run_s += answer.run_s
                elif answer.status == "interrupted" and tries[k] < _TRIES:
                    missing.append(k)
                    continue
                elif answer.status == "interrupted" or isinstance(answer, Refused):
                    self._answered(answer)
                else:
                    failed[k] = answer
                    if not pattern and len(failed) == min(_MOST_FAILED, self.plan.shards):
                        self._answered(failed[min(failed)])
                self._progress.advance()
        for k, answer in failed.items():
            first, count = self._members(k)
            values = drawn(self.plan.ranges, self._request.seed, first, count)
            self.lost.put(k, _nothing(pattern, answer, first, values))
        self.wall_s = time.perf_counter() - began

    def _members(self, k: int) -> tuple[int, int]:
        """Number of the first member of a shard, and of its members."""
        count, shards = self._request.count, self.plan.shards
        first, after = (number * count // shards for number in (k, k + 1))
        return first, after - first

    def _task(self, k: int, threads: int) -> Task:
        first, count = self._members(k)
        given = self._request, first, count, threads
        label = f"{self._about}, members {first} to {first + count - 1}"
        return Task(shard_job, given, label, sources=self._sources)

    def _is_of(self, columns: Columns, first: int, count: int, pattern: Columns) -> bool:
        """Whether columns are those of this shard, and like those of another one."""
        asked = drawn(self.plan.ranges, self._request.seed, first, count)
        kinds, wanted = ([(n, c.dtype.kind) for n, c in x.items()] for x in (columns, pattern))
        if pattern and kinds != wanted:
            return False
        try:
            return all(column.shape == (count,) for column in columns.values()) and all(
                np.allclose(columns[name], values, rtol=_SAME_DRAW, atol=0.0)
                for name, values in asked.items()
            )
        except (TypeError, ValueError, KeyError):  # a plugin may have made it
            return False

    def _answered(self, answer: Any) -> Any:
        if isinstance(answer, Refused):
            raise SpecError(answer.message)
        if isinstance(answer, NoAnswer):
            raise SpecError(f"{self._about}: {answer.message}")
        return answer


def _nothing(
    pattern: Columns, answer: NoAnswer, first: int, values: Mapping[str, np.ndarray]
) -> Columns:
    """The columns of members that are lost."""
    count = len(next(iter(values.values())))
    empty = {"f": np.nan, "i": 0}
    columns = {
        name: np.full(count, empty.get(column.dtype.kind, ""), column.dtype)
        for name, column in pattern.items()
    }
    return columns | {
        "member": first + np.arange(count),
        **values,
        "status": np.full(count, answer.status),
        "message": np.full(count, answer.message),
    }
