"""Many runs in one compiled program, in blocks of bounded memory.

Runs of a block wait for the one with the most steps, so the longest runs begin first, together. A
run that fails costs the others nothing. Several threads work at blocks: the compiled program needs
no Python. Nothing calls back to Python, so the same code runs on a GPU.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from integrators.checks import refusal
from integrators.contract import Integrator
from integrators.native.algebra.step_records import COUNTS, Reading
from integrators.native.loops import adaptive_steps, constant_steps
from integrators.native.loops.adaptive_steps import Span
from integrators.native.loops.kernel import Ending, Form
from integrators.resolutions import Steps, Tolerances
from problems.base.runtime import Float, Int, jax, most_callers
from problems.base.spec import SpecError
from problems.equations.compiled import compiled
from problems.equations.initial_values import consistent_starts
from problems.system import MechatronicSystem
from problems.variables import Sizes, row_layout

#: Most runs side by side, and most bytes of their tangents. On a CPU more runs save little time and
#: overflow the caches; a GPU needs tens of thousands.
_MOST, _MOST_GPU = (64, 2**27), (65536, 2**32)


class BatchRun(NamedTuple):
    """One of many runs; equal parts of several runs are made once."""

    scene: MechatronicSystem
    method: Integrator
    resolution: Steps | Tolerances


@dataclass(frozen=True)
class Block:
    """Results of k runs.

    ``members`` are their places among all runs, ``t_last`` (s) is the last time of each; ``counts``
    are in the order of `Batch.counts`. ``values`` of q, v, a, lam, x, xdot and y with n columns
    each are those at the end, NaN of a run that failed.
    """

    members: Int[np.ndarray, " k"]
    status: list[str]
    message: list[str]
    t_last: Float[np.ndarray, " k"]
    counts: Float[np.ndarray, "k c"]
    values: dict[str, Float[np.ndarray, "k n"]]


class Batch:
    """Runs of one kind of scene by one kind of integrator, as tables of numbers.

    Float parameters, numeric options and steps or tolerances may differ between the ``runs``; all
    end at ``t_end`` (s). ``lanes`` runs, a power of two, are side by side; by default the machine
    and the memory decide. ``counts`` are the names of valid counts, which come first in
    `Block.counts`. ``compiled_at`` is the time in s of `time.perf_counter` at which `blocks` had
    compiled the program.

    Raises
    ------
    SpecError
        If the runs need different programs.
    """

    def __init__(self, runs: Sequence[BatchRun], t_end: float, lanes: int | None = None) -> None:
        scenes, self._of_scene = _distinct(run.scene for run in runs)
        pairs, self._of_pair = _distinct((run.method, run.scene) for run in runs)
        methods = [method.step_method(scene) for method, scene in pairs]
        by_id = {id(method): method for method in methods}  # many scenes may share a method
        programs = {k: m.program(scenes[0], sparse=False) for k, m in by_id.items()}
        kinds = {program for program, _ in programs.values()}, {s.template() for s in scenes}
        if any(len(kind) > 1 for kind in kinds):
            raise SpecError(
                "The members need different compiled programs; only float parameters of the "
                "scene, numeric options of the integrator and steps or tolerances can differ."
            )
        self._template, self._sizes = scenes[0].template(), scenes[0].sizes
        t0, self._t_end = scenes[0].interval[0], t_end
        self._constant = isinstance(runs[0].resolution, Steps)
        # The last arguments of a compiled time loop, and how long runs last beside others.
        if self._constant:
            loop, names = constant_steps, ("steps", *COUNTS)
            different, self._of_time = _distinct(run.resolution for run in runs)
            grids = (constant_steps.grid(t0, t_end, s) for s in different if isinstance(s, Steps))
            clocks, steps = zip(*grids, strict=True)
            self._times, self._lengths = list(clocks), np.array(steps)
        else:
            loop, names = adaptive_steps, ("steps", "rejected", *COUNTS)
            of_runs = zip((run.resolution for run in runs), self._of_pair, strict=True)
            self._times, self._of_time = _distinct(
                Span(t0, t_end, of.rtol, of.atol, methods[k].step_limit)
                for of, k in of_runs
                if isinstance(of, Tolerances)
            )
            self._lengths = -np.array([span.rtol for span in self._times])
            # A run over no time takes no step.
            self._times.append(self._times[0]._replace(t_end=t0))
        program = kinds[0].pop()
        q, t = np.asarray(scenes[0].start().q), scenes[0].interval[0]
        # Why steps fail is told by the constraints at the first start: a map has thousands of them.
        about = program.functions, scenes[0], {"q": [q], "t": [t]}
        self._cause = cache(lambda ending: ending.with_cause(*about))
        self._states_only = methods[0].states_only
        self.counts = names[:1] if self._states_only else names
        self._starts, without = consistent_starts(scenes)
        refused = {
            k: ("unsupported", reason)
            for k, (method, scene) in enumerate(pairs)
            if (reason := refusal(method, scene))
        }
        self._refused = refused | {
            int(self._of_pair[k]): ("crashed", without[scene])
            for k, scene in enumerate(self._of_scene)
            if scene in without
        }
        settings = [scene.parameters() for scene in scenes]
        keys, of_method = _distinct(map(id, methods))
        numbers = [programs[key][1] for key in keys]
        start = jax.tree.map(lambda leaf: leaf[0], self._starts)
        # All runs have the form of the first: one part after the other.
        form = Form.of(settings[0], numbers[0], start, self._times[0])
        self._kernel = loop.kernel(program, self._template, form)
        self._names = sorted(settings[0])  # as JAX sorts the keys of a dictionary
        leaves = [leaf.reshape(len(scenes), -1) for leaf in jax.tree.leaves(self._starts)]
        self._parameters = np.array([[values[name] for name in self._names] for values in settings])
        self._tables = [
            (self._parameters, self._of_scene),
            (_table(numbers), of_method[self._of_pair]),
            (np.concatenate(leaves, axis=1), self._of_scene),
        ]
        self._time_table = _table(self._times)
        self._lanes = lanes or _lanes(self._sizes, len(runs))
        self.compiled_at = math.inf

    def blocks(
        self, jobs: int | None = None, begun: Callable[[], None] = lambda: None
    ) -> Iterator[Block]:
        """Compile the program, and run all in threads, a block at a time in each.

        The longest runs come first, so that the last blocks are short. No more than ``jobs``
        threads, and `most_callers`, call the program; ``begun`` is called when it is compiled.
        """
        nobody = np.zeros(self._lanes, dtype=np.int64)
        jax.block_until_ready(self._called(nobody, nobody == 0))
        begun()
        self.compiled_at = time.perf_counter()
        order = np.argsort(-self._lengths[self._of_time], kind="stable")
        jobs = min(jobs or most_callers(), most_callers())
        parts = (order[k : k + self._lanes] for k in range(0, len(order), self._lanes))
        pool = ThreadPoolExecutor(jobs)
        try:
            # Blocks that are not submitted yet take no memory.
            waiting = deque(pool.submit(self._block, part) for part in islice(parts, 2 * jobs))
            while waiting:
                waiting += [pool.submit(self._block, part) for part in islice(parts, 1)]
                yield waiting.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)

    def _called(self, lanes: np.ndarray, idle: np.ndarray) -> tuple[np.ndarray, ...]:
        """Last rows ``[number, t, q, v, ...]`` and ends ``[ending, t, counts...]`` of runs; those
        that are ``idle`` take no step."""
        tables, of = [table[of[lanes]] for table, of in self._tables], self._of_time[lanes]
        wanted: tuple[Any, Any] = None, None
        if self._constant:
            wanted = self._lengths[of][:, None], np.where(idle, 0, 1)
        else:
            of = np.where(idle, len(self._times) - 1, of)
        packed = np.concatenate([*tables, self._time_table[of]], axis=1)
        *_, rows, ends = map(np.array, self._kernel.batched(packed, *wanted))
        return rows[:, 0] if self._constant else rows, ends

    def _block(self, members: np.ndarray) -> Block:
        # Copies of the last member fill the block, so that all blocks have the compiled size. The
        # copies take no step.
        count = len(members)
        lanes = np.concatenate([members, np.repeat(members[-1:], self._lanes - count)])
        refused = np.isin(self._of_pair[lanes], list(self._refused))
        idle = (np.arange(self._lanes) >= count) | refused
        rows, ends = self._called(lanes, idle)
        table, layout = rows[:, 2:], row_layout(self._sizes)
        values = {group: table[:, getattr(layout, group)] for group in Reading._fields[:-1]}
        if self._states_only:
            values |= self._completed(self._of_scene[lanes], rows[:, 1], values)
        finite = np.all(np.isfinite(np.concatenate([*values.values()], axis=1)), axis=1)
        sound = finite & ~idle & (ends[:, 0] == Ending.OK)
        endings = [
            ("ok", "") if sound[k] else self._ending(member, ends[k], finite[k])
            for k, member in enumerate(members)
        ]
        status, message = map(list, zip(*endings, strict=True))
        values = {g: np.where(sound[:, None], v, np.nan)[:count] for g, v in values.items()}
        return Block(members, status, message, ends[:count, 1], ends[:count, 2:], values)

    def _ending(self, member: int, end: np.ndarray, finite: bool) -> tuple[str, str]:
        refused = self._refused.get(int(self._of_pair[member]))
        if refused:
            return refused
        ending = self._cause(Ending(int(end[0])))
        # The clock of constant steps has no limit of their number.
        most = getattr(self._times[self._of_time[member]], "max_steps", 0)
        status, message = ending.outcome(float(end[1]), self._t_end, int(most))
        if status == "ok" and not finite:
            return "diverged", "It ended with values that are not finite."
        return status, message

    def _completed(self, scene: np.ndarray, t: np.ndarray, values: dict) -> dict[str, np.ndarray]:
        """a, lam, y and xdot at the end, from the equations of motion."""
        parameters = dict(zip(self._names, self._parameters[scene].T, strict=True))
        state = (values[name] for name in ("q", "v", "x"))
        z, xdot = compiled(self._template).complete(parameters, *state, t)
        found = z._asdict() | {"xdot": xdot}
        return {name: np.asarray(found[name]) for name in ("a", "lam", "y", "xdot")}


def _table(trees: Sequence[Any]) -> np.ndarray:
    rows = ([np.ravel(leaf).astype(float) for leaf in jax.tree.leaves(tree)] for tree in trees)
    return np.array([np.concatenate(row or [[]]) for row in rows])


def _lanes(sizes: Sizes, count: int) -> int:
    lanes, memory = _MOST if jax.default_backend() == "cpu" else _MOST_GPU
    unknowns = sizes.nv + 2 * sizes.nl + sizes.nx + sizes.ny
    most = memory // (32 * unknowns**2)
    while lanes > max(1, most) or lanes // 2 >= count:
        lanes //= 2
    return lanes


def _distinct(values: Iterable[Any]) -> tuple[list[Any], np.ndarray]:
    """The different values in order of appearance, and for each value its place among them."""
    places: dict[Any, int] = {}
    of = [places.setdefault(value, len(places)) for value in values]
    return list(places), np.array(of)
