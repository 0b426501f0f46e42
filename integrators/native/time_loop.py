"""One-step methods written in JAX: the compiled march that turns a step into a run.

A method states ``numbers`` (its parameters as plain numbers), ``begin``, ``step`` and ``read`` as
pure functions of a state. From these the march makes one compiled kernel per method class and
scene: schemes, steps, patterns, parameters and tolerances are traced arguments and compile
nothing new. Rows are kept inside the loop, so memory does not grow with the number of steps.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, NamedTuple

import numpy as np

from integrators.contract import (
    FIRST_ROWS,
    SPREAD_ROWS,
    Integrator,
    PreparedRun,
    Steps,
    Trajectory,
    Work,
    spread_rows,
)
from integrators.native import small_matrices
from problems.formulations import Start
from problems.initial_values import consistent_start
from problems.runtime import jax, jnp
from problems.system import MechatronicSystem

#: A run whose q or v has grown by this factor is called diverged.
GROWTH_LIMIT = 1e12

_PATTERN_SLOTS = 16
#: The first steps, the first macro steps and the spread: as many rows as a run can ask for.
_ROW_SLOTS = 2 * FIRST_ROWS + SPREAD_ROWS + 1
_OK, _NEWTON_FAILED, DIVERGED = 0, 1, 2


class StepReport(NamedTuple):
    """What a step did: whether Newton converged, and how often each part of it was done."""

    converged: Any
    newton: Any = 0
    residuals: Any = 0
    jacobians: Any = 0
    factorisations: Any = 0
    solves: Any = 0


class Clock(NamedTuple):
    """A grid of steps: n-th step ends at t0 + length (m + ends[j]) / macro_steps, where
    m, j = divmod(n, slots)."""

    t0: Any
    length: Any
    macro_steps: Any
    fractions: Any
    ends: Any
    slots: Any


def step_times(clock: Clock, n: Any) -> tuple[Any, Any]:
    """Time at the end of the n-th step (from zero), and its size."""
    macro, j = n // clock.slots, n % clock.slots
    t = clock.t0 + clock.length * ((macro + clock.ends[j]) / clock.macro_steps)
    return t, clock.length / clock.macro_steps * clock.fractions[j]


class Reading(NamedTuple):
    """The variables that a state holds, as they are reported, and scalars of the last step in the
    order of the method's ``noted``."""

    q: Any
    v: Any
    a: Any
    lam: Any
    x: Any
    xdot: Any
    y: Any
    notes: tuple = ()


@dataclass(frozen=True)
class StepMethod(Integrator):
    """Base of fixed-step (or step-pattern) methods written as pure JAX functions."""

    controls: ClassVar[str] = "step"
    #: Names of what ``read`` notes of the last step beside the variables.
    noted: ClassVar[tuple[str, ...]] = ()
    #: Whether its steps give q, v and x alone and count nothing: the equations give the rest.
    states_only: ClassVar[bool] = False

    @abstractmethod
    def numbers(self) -> Any:
        """The method's parameters, a pytree of numbers; traced in ``begin`` and ``step``."""

    @staticmethod
    @abstractmethod
    def begin(scene: MechatronicSystem, numbers: Any, start: Start, h: Any) -> Any:
        """The method's state at t0, before a first step of size h."""

    @staticmethod
    @abstractmethod
    def step(
        scene: MechatronicSystem, numbers: Any, state: Any, t: Any, h: Any
    ) -> tuple[Any, StepReport]:
        """Advance the state by h to time t."""

    @staticmethod
    @abstractmethod
    def read(state: Any) -> Reading:
        """The variables in a state."""

    def functions(self) -> tuple[Callable, Callable, Callable]:
        """The ``begin``, ``step`` and ``read`` of these options."""
        return type(self).begin, type(self).step, type(self).read

    def kernel(self, scene: MechatronicSystem) -> Kernel:
        """The compiled march on a scene; shared by all methods with the same functions."""
        return kernel(*self.functions(), scene.template())

    def stepped(self, scene: MechatronicSystem) -> StepMethod | None:
        return self if self.controls == "step" else None

    def on(self, scene: MechatronicSystem, start: Start) -> Any:
        """What marches on a scene: an object with ``numbers`` and ``kernel`` as here, which may be
        another one where the scene's size asks for it."""
        return self

    def prepare(self, scene: MechatronicSystem, t_end: float, resolution: Steps) -> PreparedRun:
        return _March(self, scene, t_end, resolution)


def grid(t0: float, t_end: float, resolution: Steps) -> tuple[Clock, np.ndarray]:
    """The clock of a run, and the numbers of the steps that are its rows, without the start."""
    macro = resolution.count(t0, t_end)
    slots = len(resolution.pattern)
    fractions = np.zeros(_PATTERN_SLOTS)
    fractions[:slots] = resolution.pattern
    ends = np.cumsum(fractions)
    ends[slots - 1 :] = 1.0  # exactly, whatever the fractions' rounding
    rows = np.union1d(np.arange(min(FIRST_ROWS, macro * slots) + 1), spread_rows(macro) * slots)
    return Clock(t0, t_end - t0, macro, fractions, ends, slots), rows[rows > 0]


class _March(PreparedRun):
    def __init__(
        self, method: StepMethod, scene: MechatronicSystem, t_end: float, resolution: Steps
    ) -> None:
        clock, self._rows = grid(scene.interval[0], t_end, resolution)
        padded = np.zeros(_ROW_SLOTS, dtype=np.int64)
        padded[: len(self._rows)] = self._rows
        start = consistent_start(scene)
        marching = method.on(scene, start)
        self._start, self._noted = start, method.noted
        self._kernel = marching.kernel(scene)
        self._arguments = self._kernel.pack(scene.parameters(), marching.numbers(), start, clock)
        self._all_rows = jnp.asarray(padded), jnp.asarray(len(self._rows))
        self._end_only = jnp.full(_ROW_SLOTS, self._rows[-1]), jnp.asarray(1)
        # A march that keeps no row takes no step: it compiles the kernel and costs nothing else.
        jax.block_until_ready(self._kernel(self._arguments, self._end_only[0], jnp.asarray(0)))

    def execute(self) -> Any:
        return jax.block_until_ready(self._kernel(self._arguments, *self._end_only))

    def measure(self) -> Trajectory:
        rows, end = (np.asarray(part) for part in self._kernel(self._arguments, *self._all_rows))
        kept = np.flatnonzero(rows[: len(self._rows), 0] == self._rows)
        status, t, *counts = end
        work = Work(int(counts[0]), 0, *map(int, counts[1:]))
        name, message = outcome(int(status), float(t))
        values = with_start(self._start, rows[kept, 1:], self._noted)
        return Trajectory(**values, status=name, message=message, work=work)


def with_start(start: Start, rows: np.ndarray, noted: tuple[str, ...]) -> dict[str, Any]:
    """Fields of a Trajectory from rows ``(k, [t, q, v, a, lam, x, xdot, y, notes])`` of a kernel.

    The scene's start comes before them; no step led to it, so its notes are NaN.
    """
    z, nothing = start.z, np.full(len(noted), np.nan)
    first = [np.atleast_1d(p) for p in (z.t, z.q, z.v, z.a, z.lam, z.x, start.xdot, z.y, nothing)]
    table = np.concatenate([np.concatenate(first)[None], rows])
    cuts = np.cumsum([len(part) for part in first])[:-1]
    t, *groups, notes = np.split(table, cuts, axis=1)
    return {
        "t": t[:, 0],
        **dict(zip(Reading._fields[:-1], groups, strict=True)),
        "notes": dict(zip(noted, notes.T, strict=True)),
    }


def outcome(status: int, t: float) -> tuple[str, str]:
    """Name and message of the status that a kernel gave at t."""
    if status == _NEWTON_FAILED:
        return "newton_failed", (
            f"Newton's method did not converge in the step to t={t:.6g} s; take a smaller step "
            f"or a method that damps more."
        )
    if status == DIVERGED:
        return "diverged", (
            f"The solution grew beyond all bounds or was no longer finite in the step to "
            f"t={t:.6g} s; take a smaller step or a method that damps more, or check the scene's "
            f"forces there."
        )
    return "ok", ""


class Kernel:
    """A compiled march; its many small arguments travel as one array, and so do its results.

    Each array that is handed to a compiled program or back costs as much as a step.

    At constant steps it returns rows ``(row, [steps done or -1, t, q, v, a, lam, x, xdot, y,
    notes])``, as many as it takes step numbers, and ``[status, t, counts...]``.
    """

    def __init__(self, march: Callable) -> None:
        self._unpack: Callable | None = None

        def run(packed: Any, *rows: Any) -> Any:
            return march(*self._unpack(packed), *rows)

        self._compiled = jax.jit(run)
        # Side by side, many numbers are treated alike: registers as wide as they come.
        wide = {"xla_cpu_prefer_vector_width": 512}
        self._many = jax.jit(jax.vmap(run), compiler_options=wide)

    def pack(self, *arguments: Any) -> Any:
        """Pack parameters, numbers, start and clock (floats, and integers below 2^53)."""
        leaves, tree = jax.tree.flatten(arguments)
        leaves = [np.asarray(leaf) for leaf in leaves]
        cuts = np.cumsum([leaf.size for leaf in leaves])[:-1]

        def unpack(packed: Any) -> Any:
            parts = jnp.split(packed, cuts)
            return jax.tree.unflatten(
                tree,
                [
                    part.reshape(leaf.shape).astype(leaf.dtype)
                    for part, leaf in zip(parts, leaves, strict=True)
                ],
            )

        self._unpack = self._unpack or unpack
        return jnp.asarray(np.concatenate([leaf.ravel().astype(float) for leaf in leaves]))

    def __call__(self, packed: Any, *rows: Any) -> Any:
        return self._compiled(packed, *rows)

    def clock(self, packed: Any) -> Any:
        """The clock among packed arguments."""
        return self._unpack(packed)[-1]

    def batched(self, packed: Any, *rows: Any) -> Any:
        """Many runs in one program: every argument has one more axis in front."""
        return self._many(packed, *rows)

    @property
    def compilations(self) -> int:
        """How many programs were compiled; one serves all schemes, steps and parameters."""
        return self._compiled._cache_size()


@cache
def kernel(
    begin: Callable,
    step: Callable,
    read: Callable,
    template: MechatronicSystem,
    finish: Callable | None = None,
) -> Kernel:
    """The compiled march of a method on a scene, for any numbers and parameters; ``finish`` frees
    what the last state holds."""

    @small_matrices.without_products
    def advance(p: dict, numbers: Any, state: Any, t: Any, h: Any) -> tuple[Any, StepReport]:
        return step(template.with_parameters(p), numbers, state, t, h)

    def march(
        p: dict, numbers: Any, start: Start, clock: Clock, rows: Any, row_count: Any
    ) -> tuple:
        scene = template.with_parameters(p)
        state = begin(scene, numbers, start, step_times(clock, 0)[1])
        first = read(state)
        bound = GROWTH_LIMIT * (1.0 + largest(first.q, first.v))

        def one_step(progress: tuple) -> tuple:
            n, state, status, counts, _ = progress
            t, h = step_times(clock, n)
            # Among many runs a step is taken for those that have failed, too, and dropped. It is
            # made one that Newton's method leaves at once.
            h = jnp.where(status == _OK, h, jnp.nan)
            state, report = advance(p, numbers, state, t, h)
            now = read(state)
            # A comparison with NaN is false: not finite counts as grown beyond the bound.
            sane = (largest(now.q, now.v) < bound) & jnp.isfinite(largest(now.a, now.lam))
            status = jnp.where(sane, jnp.where(report.converged, _OK, _NEWTON_FAILED), DIVERGED)
            counts = tuple(c + r for c, r in zip(counts, (1, *report[1:]), strict=True))
            return n + 1, state, status, counts, t

        def to_row(carry: tuple) -> tuple:
            k, kept, progress = carry
            progress = jax.lax.while_loop(
                lambda now: (now[0] < rows[k]) & (now[2] == _OK), one_step, progress
            )
            n, state, status, _, t = progress
            reached = jnp.where(status == _OK, n, -1)
            row = jnp.concatenate([jnp.stack([reached, t]), flat(read(state))])
            return k + 1, kept.at[k].set(row), progress

        counts = (jnp.asarray(0),) * len(StepReport._fields)
        progress = (jnp.asarray(0), state, jnp.asarray(_OK), counts, clock.t0)
        width = 2 + flat(first).size
        _, kept, progress = jax.lax.while_loop(
            lambda carry: (carry[0] < row_count) & (carry[2][2] == _OK),
            to_row,
            (jnp.asarray(0), jnp.zeros((len(rows), width)), progress),
        )
        _, state, status, counts, t = progress
        if finish:
            finish(state)
        return kept, jnp.stack([status, t, *counts])

    return Kernel(march)


def flat(reading: Reading) -> Any:
    """All numbers of a reading in one array."""
    return jnp.concatenate([jnp.atleast_1d(part) for part in jax.tree.leaves(reading)])


def largest(*parts: Any) -> Any:
    """Largest absolute value over arrays that may be empty; NaN if there is one."""
    return jnp.max(jnp.abs(jnp.concatenate([jnp.atleast_1d(p) for p in parts])))
