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
from integrators.native.loops.kernel import Form, Kernel
from integrators.native.loops.status import Ending
from integrators.native.step.step_program import StepProgram
from integrators.output_rows import FIRST_ROWS, SPREAD_ROWS
from integrators.resolutions import Steps, Tolerances
from problems.base.runtime import Float, Int, jax, most_callers
from problems.base.spec import SpecError
from problems.equations.formulations import complete
from problems.equations.initial_values import consistent_starts
from problems.equations.layouts import row_layout
from problems.system import MechatronicSystem
from problems.variables import Sizes

#: Most runs side by side, and most bytes of their tangents and rows. On a CPU more runs save
#: little time and overflow the caches; a GPU needs tens of thousands.
_MOST, _MOST_GPU = (64, 2**27), (65536, 2**32)
#: Approximate number of rows in a kernel's memory.
_ROWS = 256


class BatchRun(NamedTuple):
    """One of many runs; equal parts of several runs are made once."""

    scene: MechatronicSystem
    method: Integrator
    resolution: Steps | Tolerances


@dataclass(frozen=True)
class Block:
    """Results of k runs with at most r rows each.

    ``members`` are their places among all runs, ``t_last`` (s) is the last time of each; ``counts``
    are in the order of `Batch.counts`. ``t`` (s) and ``values`` of q, v, a, lam, x, xdot and y with
    n columns each are NaN in rows that a run did not reach, of ``rows`` if it is complete.
    """

    members: Int[np.ndarray, " k"]
    status: list[str]
    message: list[str]
    t_last: Float[np.ndarray, " k"]
    counts: Float[np.ndarray, "k c"]
    t: Float[np.ndarray, "k r"]
    values: dict[str, Float[np.ndarray, "k r n"]]
    rows: Int[np.ndarray, " k"]


class Batch:
    """Runs of one kind of scene by one kind of integrator, as tables of numbers.

    Float parameters, numeric options and steps or tolerances may differ between the ``runs``; all
    end at ``t_end`` (s). With ``every_row`` the start, the first rows and some 200 more are kept
    instead of the last one alone. ``lanes`` runs, a power of two, are side by side; by default the
    machine and the memory decide. ``compiled_at`` is the time in s of `time.perf_counter` at which
    `blocks` had compiled the program.

    Raises
    ------
    SpecError
        If the runs need different programs.
    """

    def __init__(
        self,
        runs: Sequence[BatchRun],
        t_end: float,
        every_row: bool = False,
        lanes: int | None = None,
    ) -> None:
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
        t0, resolutions = scenes[0].interval[0], [run.resolution for run in runs]
        steps = [of for of in resolutions if isinstance(of, Steps)]
        tolerances = [of for of in resolutions if isinstance(of, Tolerances)]
        if steps:
            self._times = _ConstantSteps(steps, t0, t_end, every_row)
        else:
            limits = [methods[k].step_limit for k in self._of_pair]
            self._times = _ChosenSteps(tolerances, limits, t0, t_end, every_row)
        program = kinds[0].pop()
        q, t = np.asarray(scenes[0].start().q), scenes[0].interval[0]
        # Why steps fail is told by the constraints at the first start: a map has thousands of them.
        about = program.functions, scenes[0], {"q": [q], "t": [t]}
        self._cause = cache(lambda ending: ending.with_cause(*about))
        self._states_only, self._every_row = methods[0].states_only, every_row
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
        form = Form.of(settings[0], numbers[0], start, self._times.numbers[0])
        self._kernel = self._times.kernel(program, self._template, form)
        names = sorted(settings[0])  # as JAX sorts the keys of a dictionary
        leaves = [leaf.reshape(len(scenes), -1) for leaf in jax.tree.leaves(self._starts)]
        self._parameters = np.array([[values[name] for name in names] for values in settings])
        self._tables = [
            (self._parameters, self._of_scene),
            (_table(numbers), of_method[self._of_pair]),
            (np.concatenate(leaves, axis=1), self._of_scene),
        ]
        self._time_table = _table(self._times.numbers)
        self._lanes = lanes or _lanes(self._sizes, len(runs))
        self.compiled_at = math.inf

    def blocks(
        self,
        jobs: int | None = None,
        begun: Callable[[], None] = lambda: None,
    ) -> Iterator[Block]:
        """Compile the program, and run all in threads, a block at a time in each.

        The longest runs come first, so that the last blocks are short. No more than ``jobs``
        threads, and `most_callers`, call the program; ``begun`` is called when it is compiled.
        """
        nobody = np.zeros(self._lanes, dtype=np.int64)
        jax.block_until_ready(self._called(nobody, nobody == 0))
        begun()
        self.compiled_at = time.perf_counter()
        order = self._times.longest_first()
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

    def _called(self, lanes: np.ndarray, idle: np.ndarray) -> tuple[Any, ...]:
        tables = [table[of[lanes]] for table, of in self._tables]
        packed = np.concatenate([*tables, self._time_table[self._times.of(lanes, idle)]], axis=1)
        return self._kernel.batched(packed, *self._times.wanted(lanes, idle))

    def _block(self, members: np.ndarray) -> Block:
        # Copies of the last member fill the block, so that all blocks have the compiled size. The
        # copies take no step.
        count = len(members)
        lanes = np.concatenate([members, np.repeat(members[-1:], self._lanes - count)])
        scene, pair = self._of_scene[lanes], self._of_pair[lanes]
        idle = (np.arange(self._lanes) >= count) | np.isin(pair, list(self._refused))
        answer = tuple(np.array(part) for part in self._called(lanes, idle))
        t, table, row_counts, ends, counts = self._times.read(lanes, answer)
        values = _split(table, self._sizes)
        if self._states_only:
            values |= self._completed(scene, t, values)
        last = [v[np.arange(self._lanes), row_counts - 1] for v in values.values()]
        finite = np.all(np.isfinite(np.concatenate(last, axis=1)), axis=1)
        sound = finite & ~idle & (ends[:, 0] == Ending.OK)
        endings = [
            ("ok", "") if sound[k] else self._ending(member, ends[k], finite[k])
            for k, member in enumerate(members)
        ]
        if self._every_row:
            t, values, row_counts = self._with_start(scene, t, values, row_counts)
        status, message = map(list, zip(*endings, strict=True))
        values = {name: value[:count] for name, value in values.items()}
        t, t_last, row_counts = t[:count], ends[:count, 1], row_counts[:count]
        return Block(members, status, message, t_last, counts[:count], t, values, row_counts)

    def _ending(self, member: int, end: np.ndarray, finite: bool) -> tuple[str, str]:
        refused = self._refused.get(int(self._of_pair[member]))
        if refused:
            return refused
        ending = self._cause(Ending(int(end[0])))
        status, message = self._times.outcome(member, ending, float(end[1]))
        if status == "ok" and not finite:
            return "diverged", "It ended with values that are not finite."
        return status, message

    def _completed(self, scene: np.ndarray, t: np.ndarray, values: dict) -> dict[str, np.ndarray]:
        """a, lam, y and xdot at the rows, from the equations of motion."""
        names = sorted(self._template.parameters())  # as JAX sorts the keys of a dictionary
        parameters = dict(zip(names, self._parameters[scene].T, strict=True))
        state = (values[name] for name in ("q", "v", "x"))
        z, xdot = _completion(self._template)(parameters, *state, t)
        found = z._asdict() | {"xdot": xdot}
        return {name: np.asarray(found[name]) for name in ("a", "lam", "y", "xdot")}

    def _with_start(
        self, scene: np.ndarray, t: np.ndarray, values: dict, row_counts: np.ndarray
    ) -> tuple[np.ndarray, dict[str, np.ndarray], np.ndarray]:
        first = self._starts.z._asdict() | {"xdot": self._starts.xdot}
        values = {
            name: np.concatenate([first[name][scene][:, None], rows], axis=1)
            for name, rows in values.items()
        }
        return np.concatenate([first["t"][scene][:, None], t], axis=1), values, row_counts + 1

    @property
    def counts(self) -> tuple[str, ...]:
        """Names of the valid counts, which come first in `Block.counts`."""
        return self._times.counts[:1] if self._states_only else self._times.counts


def _table(trees: Sequence[Any]) -> np.ndarray:
    rows = ([np.ravel(leaf).astype(float) for leaf in jax.tree.leaves(tree)] for tree in trees)
    return np.array([np.concatenate(row or [[]]) for row in rows])


def _split(table: np.ndarray, sizes: Sizes) -> dict[str, np.ndarray]:
    """Values by name from rows ``[q, v, a, lam, x, xdot, y, notes]``."""
    groups, layout = Reading._fields[:-1], row_layout(sizes)
    return {group: table[..., getattr(layout, group)] for group in groups}


def _lanes(sizes: Sizes, count: int) -> int:
    lanes, memory = _MOST if jax.default_backend() == "cpu" else _MOST_GPU
    unknowns = sizes.nv + 2 * sizes.nl + sizes.nx + sizes.ny
    most = memory // (8 * (4 * unknowns**2 + _ROWS * 4 * unknowns))
    while lanes > max(1, most) or lanes // 2 >= count:
        lanes //= 2
    return lanes


@cache
def _completion(template: MechatronicSystem) -> Callable:
    """Program that completes states (parameters, q, v, x, t) of many runs with many rows each."""

    def one(p: dict, q: Any, v: Any, x: Any, t: Any) -> tuple:
        return complete(template.with_parameters(p), q, v, x, t)

    over_rows = jax.vmap(one, in_axes=(None, 0, 0, 0, 0))
    return jax.jit(jax.vmap(over_rows))


# ---- times of runs -----------------------------------------------------------------------
#: Times, values, numbers of rows, endings [ending, t] and work counts of k runs.
_Rows = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class _ConstantSteps:
    """Times of runs at constant steps, or patterns of them.

    A kind of times gives a compiled time loop its last arguments, of which ``numbers`` are the
    different ones, and reads what it returns. ``places`` are indices of runs among all; an ``idle``
    run takes no step.
    """

    counts = ("steps", *COUNTS)

    def __init__(self, steps: Sequence[Steps], t0: float, t_end: float, every_row: bool) -> None:
        self._t_end = t_end
        different, self._of = _distinct(steps)
        clocks, ends = zip(*(constant_steps.grid(t0, t_end, s) for s in different), strict=True)
        rows = [
            constant_steps.kept_steps(clock, end, SPREAD_ROWS) if every_row else np.array([end])
            for clock, end in zip(clocks, ends, strict=True)
        ]
        self.numbers = list(clocks)
        self._row_counts = np.array([len(numbers) for numbers in rows])
        self._rows = np.zeros((len(rows), self._row_counts.max()), dtype=np.int64)
        for table, numbers in zip(self._rows, rows, strict=True):
            table[: len(numbers)] = numbers

    def kernel(self, program: StepProgram, template: MechatronicSystem, form: Form) -> Kernel:
        return constant_steps.kernel(program, template, form)

    def longest_first(self) -> np.ndarray:
        return np.argsort(-self._rows.max(axis=1)[self._of], kind="stable")

    def of(self, places: np.ndarray, idle: np.ndarray) -> np.ndarray:
        return self._of[places]

    def wanted(self, places: np.ndarray, idle: np.ndarray) -> tuple[Any, ...]:
        of = self._of[places]
        return self._rows[of], np.where(idle, 0, self._row_counts[of])

    def read(self, places: np.ndarray, answer: tuple[np.ndarray, ...]) -> _Rows:
        table, end = answer
        of = self._of[places]
        table[table[:, :, 0] != self._rows[of]] = np.nan
        return table[:, :, 1], table[:, :, 2:], self._row_counts[of], end[:, :2], end[:, 2:]

    def outcome(self, place: int, ending: Ending, t: float) -> tuple[str, str]:
        return ending.outcome(t, self._t_end)


class _ChosenSteps:
    """Times of runs whose steps follow a tolerance; methods as of `_ConstantSteps`."""

    counts = ("steps", "rejected", *COUNTS)

    def __init__(
        self,
        tolerances: Sequence[Tolerances],
        step_limits: Sequence[int],
        t0: float,
        t_end: float,
        every_row: bool,
    ) -> None:
        self._every_row = every_row
        spans = [
            Span(t0, t_end, asked.rtol, asked.atol, most)
            for asked, most in zip(tolerances, step_limits, strict=True)
        ]
        self.numbers, self._of = _distinct(spans)
        # A run over no time takes no step.
        self.numbers.append(self.numbers[0]._replace(t_end=t0))

    def kernel(self, program: StepProgram, template: MechatronicSystem, form: Form) -> Kernel:
        return adaptive_steps.kernel(program, template, form)

    def longest_first(self) -> np.ndarray:
        return np.argsort([self.numbers[k].rtol for k in self._of], kind="stable")

    def of(self, places: np.ndarray, idle: np.ndarray) -> np.ndarray:
        return np.where(idle, len(self.numbers) - 1, self._of[places])

    def wanted(self, places: np.ndarray, idle: np.ndarray) -> tuple[Any, ...]:
        if not self._every_row:
            return None, None
        rows = np.arange(1, FIRST_ROWS + SPREAD_ROWS + 1)
        return np.tile(rows, (len(places), 1)), np.full(len(places), SPREAD_ROWS)

    def read(self, places: np.ndarray, answer: tuple[np.ndarray, ...]) -> _Rows:
        rows, last, end = answer
        tables = np.concatenate([rows, last[:, None]], axis=1)
        if not self._every_row:
            tables[end[:, 0] != 0] = 0  # a run that failed early has no last row
        kept = [adaptive_steps.in_order(table) for table in tables]
        complete = np.array([max(1, len(rows)) for rows in kept])
        table = np.full((len(kept), complete.max(), last.shape[1]), np.nan)
        for place, rows in zip(table, kept, strict=True):
            place[: len(rows)] = rows
        return table[:, :, 1], table[:, :, 2:], complete, end[:, :2], end[:, 2:]

    def outcome(self, place: int, ending: Ending, t: float) -> tuple[str, str]:
        span = self.numbers[self._of[place]]
        return ending.outcome(t, float(span.t_end), int(span.max_steps))


def _distinct(values: Iterable[Any]) -> tuple[list[Any], np.ndarray]:
    """The different values in order of appearance, and for each value its place among them."""
    places: dict[Any, int] = {}
    of = [places.setdefault(value, len(places)) for value in values]
    return list(places), np.array(of)
