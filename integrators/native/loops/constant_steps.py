"""Runs at constant steps, or patterns of steps: the compiled time loop, and a step by itself.

One compiled kernel serves a method on all scenes of one kind: schemes, steps, patterns, parameters
and tolerances are traced arguments and compile nothing new. The loop stores chosen rows only, so
memory does not grow with the number of steps.

`SingleStep` is the step that the host calls again and again, as a loop in real time does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from integrators.contract import Trajectory, Work
from integrators.native.algebra.step_records import COUNTS, Reading, Scalar, Time
from integrators.native.loops.kernel import (
    ROWS,
    STEPS,
    Ending,
    Form,
    Kernel,
    LoopRun,
    OnScene,
    bounded,
    flat_row,
    no_counts,
    step_on,
    with_start,
)
from integrators.native.step.step_program import Carried, Numbers, StepProgram
from integrators.output_rows import EVERY_STEP, is_row, row_times, width_of
from integrators.resolutions import Steps
from problems.base.runtime import Array, Float, Int, jax, jnp
from problems.equations.formulations import Start
from problems.equations.initial_values import consistent_start
from problems.equations.programs import turns
from problems.system import MechatronicSystem

_OK, _REFUSED, _DIVERGED = map(int, (Ending.OK, Ending.REFUSED, Ending.DIVERGED))
_NEWTON_FAILED = int(Ending.NEWTON_FAILED)
_PATTERN_SLOTS = 16


class Clock(NamedTuple):
    """A grid of steps: the n-th step ends at t0 + length (m + ends[j]) / macro_steps.

    Here m, j = divmod(n, slots), and n counts from zero. Times are in s.
    """

    t0: Scalar
    length: Scalar
    macro_steps: Scalar
    fractions: Float[Array, " p"] | Float[np.ndarray, " p"]
    ends: Float[Array, " p"] | Float[np.ndarray, " p"]
    slots: Int[Array, ""] | int


def step_times(clock: Clock, n: Int[Array, ""] | int) -> tuple[Time, Time]:
    """Time at the end of the n-th step (from zero) and size of the step, in s."""
    macro, j = n // clock.slots, n % clock.slots
    t = clock.t0 + clock.length * ((macro + clock.ends[j]) / clock.macro_steps)
    return t, clock.length / clock.macro_steps * clock.fractions[j]


def grid(t0: float, t_end: float, resolution: Steps) -> tuple[Clock, int]:
    """The clock of a run, and its number of steps."""
    macro = resolution.count(t0, t_end)
    slots = len(resolution.pattern)
    fractions = np.zeros(_PATTERN_SLOTS)
    fractions[:slots] = resolution.pattern
    ends = np.cumsum(fractions)
    ends[slots - 1 :] = 1.0  # exactly, whatever the fractions' rounding
    return Clock(t0, t_end - t0, macro, fractions, ends, slots), macro * slots


def kept_steps(clock: Clock, steps: int, times: int) -> Int[np.ndarray, " k"]:
    """Numbers of the steps that are rows (see `is_row`), in ascending order, the last among them.

    Only those beside the equally spaced times are asked, as there may be a million million.
    """
    if times == EVERY_STEP:
        return np.arange(1, steps + 1)
    beside = np.arange(-_PATTERN_SLOTS, _PATTERN_SLOTS + 2)
    near = np.arange(times + 1)[:, None] * (steps / times) + beside
    near: Any = np.unique(np.clip(near, 1, steps).astype(np.int64))
    before, part = ((step_times(clock, near - k)[0] - clock.t0) / clock.length for k in (2, 1))
    return near[is_row(near, before, part, times) | (near == steps)]


class ConstantStepsRun(LoopRun):
    """A run at constant steps or patterns."""

    def __init__(self, method: OnScene, t_end: float, resolution: Steps) -> None:
        self._clock, self._steps = grid(method.scene.interval[0], t_end, resolution)
        self._t_end = float(t_end)
        super().__init__(kernel, method, self._clock)
        self.end_only = jnp.asarray(np.full(self._slots, self._steps)), jnp.asarray(1)
        # A loop that keeps no row takes no step: it compiles the kernel and costs nothing else.
        jax.block_until_ready(self.kernel(self.arguments, self.end_only[0], jnp.asarray(0)))

    def measure(self) -> Trajectory:
        times = row_times(self._steps, width_of(self._scene.sizes))
        numbers = kept_steps(self._clock, self._steps, times)
        parts, end, done = [], np.zeros(0), 0
        # Each call begins at the start again, and keeps the next rows.
        for first in range(0, len(numbers), self._slots):
            part, end = self._rows(numbers[first : first + self._slots])
            parts.append(part)
            done = int(part[-1, 0]) if len(part) else done
            if Ending(int(end[0])) is not Ending.OK:
                break
        if int(end[2]) > done:
            parts.append(self._rows(np.array([int(end[2])]))[0])  # the last good step
        rows = np.concatenate(parts) if len(parts) > 1 else parts[0]
        work = Work(int(end[2]), 0, *map(int, end[3 : 3 + len(COUNTS)]))
        self._turns = [*map(int, end[3 + len(COUNTS) :])]
        run = self._trajectory(rows, end, self._t_end, work)
        numbers: Any = rows[:, 0].astype(int) - 1  # all at once
        _, sizes = step_times(self._clock, numbers)
        run.notes.setdefault("h", np.append(np.nan, sizes))
        return run

    def _rows(self, wanted: Int[np.ndarray, " k"]) -> tuple[np.ndarray, np.ndarray]:
        """The rows of wanted steps, up to a failure, and the end of the run."""
        asked = jnp.asarray(np.resize(wanted, self._slots)), jnp.asarray(len(wanted))
        kept, end = map(np.asarray, self._called(*asked))
        # After a failure no row is reached. A slice is no copy of a large table.
        return kept[: (kept[: len(wanted), 0] == wanted).sum()], end


def _one_step(
    program: StepProgram, step: Callable, named: MechatronicSystem, sane: Callable[[Reading], Array]
) -> Callable[..., tuple]:
    """The n-th step (from zero) of a loop, from its state.

    It gives the end in s, the state and ending after it, the values there, and the report. A step
    that is not solved is no failure with ``goes_on``.
    """

    def take(
        p: dict, numbers: Numbers, clock: Clock, n: Array, state: Carried, goes_on: bool = False
    ) -> tuple:
        t, h = step_times(clock, n)
        state, report = step(p, numbers, state, t, h)
        now = program.read(named.with_parameters(p), state)
        failed = jnp.where(report.solved, _REFUSED, _OK if goes_on else _NEWTON_FAILED)
        ending = jnp.where(sane(now), jnp.where(report.converged, _OK, failed), _DIVERGED)
        return t, state, ending, now, report

    return take


def _row(number: Array, t: Array, values: Reading) -> Float[Array, " n"]:
    return jnp.concatenate([jnp.stack([number, t]), flat_row(values)])


@cache
def kernel(program: StepProgram, template: MechatronicSystem, form: Form) -> Kernel:
    """The compiled time loop of a method on a kind of scene, for any numbers and parameters.

    It takes the step numbers of the rows to keep ``(rows,)`` and their count; later entries are
    ignored. It returns the rows ``(rows, [steps done or -1, t, q, v, a, lam, x, xdot, y, notes])``
    and ``[ending, t, counts...]``.
    """
    named, step = step_on(program, template)

    def loop(
        p: dict, numbers: Numbers, start: Start, clock: Clock, rows: Array, row_count: Array
    ) -> tuple[Array, Array]:
        scene = named.with_parameters(p)
        state = program.begin(scene, numbers, start, step_times(clock, 0)[1])
        first = program.read(scene, state)
        take = _one_step(program, step, named, bounded(first))

        def one_step(progress: tuple) -> tuple:
            n, state, _, counts, _ = progress
            t, state, ending, _, report = take(p, numbers, clock, n, state)
            counts = tuple(c + r for c, r in zip(counts, (1, *report.counts), strict=True))
            return n + 1, state, ending, counts, t

        def to_row(carry: tuple) -> tuple:
            k, kept, progress = carry
            with turns(STEPS):
                progress = jax.lax.while_loop(
                    lambda now: (now[0] < rows[k]) & (now[2] == _OK), one_step, progress
                )
            n, state, ending, _, t = progress
            row = _row(jnp.where(ending == _OK, n, -1), t, program.read(scene, state))
            return k + 1, kept.at[k].set(row), progress

        counts = no_counts(1, step, p, numbers, state)
        progress = (jnp.asarray(0), state, jnp.asarray(_OK), counts, clock.t0)
        width = 2 + flat_row(first).size
        with turns(ROWS):
            _, kept, progress = jax.lax.while_loop(
                lambda carry: (carry[0] < row_count) & (carry[2][2] == _OK),
                to_row,
                (jnp.asarray(0), jnp.zeros((len(rows), width)), progress),
            )
        _, state, ending, (steps, *counts), t = progress
        program.finish(state)
        return kept, jnp.stack([ending, t, steps - (ending != _OK), *counts])

    return Kernel(loop, form)


class SingleStep:
    """A compiled step of constant size; the state stays on the device as one array.

    A state holds the ending, the time and values of the last step, whether it was solved, the
    number of steps, and all that the method passes on.

    Parameters
    ----------
    program, numbers
        A native method at constant steps.
    scene
        The scene; the run begins at its start.
    h, steps
        Size of the step in s, and number of steps in a run.
    most
        Most iterations in each call of Newton's method, after which the step goes on; None for
        those of the method, without which a step has failed. A method that keeps tangents takes no
        limit: what few iterations by an old tangent leave adds up over steps.

    Attributes
    ----------
    iterates, keeps_tangents
        Whether a step calls Newton's method, and whether that keeps tangents over steps.
    first
        The state at the start, an array.
    """

    iterates: bool

    def __init__(
        self,
        program: StepProgram,
        numbers: Numbers,
        scene: MechatronicSystem,
        h: float,
        steps: int,
        most: int | None = None,
    ) -> None:
        from jax.flatten_util import ravel_pytree  # JAX is loaded late

        self._scene, self._program = scene, program
        self.keeps_tangents = program.keeps_tangents
        numbers = numbers if most is None else numbers._replace(most=most)
        t0, self._start = scene.interval[0], consistent_start(scene)
        self._t_end = t0 + steps * h
        clock = grid(t0, self._t_end, Steps(h))[0]._replace(macro_steps=steps)
        parts = scene.parameters(), numbers, self._start, clock
        form = Form.of(*parts)
        self._packed = form.pack(*parts)
        named, step = step_on(program, scene.template())

        @jax.jit
        def begun(packed: Array) -> tuple[Array, Array, Carried]:
            p, numbers, start, clock = form.unpack(packed)
            scene = named.with_parameters(p)
            state = program.begin(scene, numbers, start, step_times(clock, 0)[1])
            values = program.read(scene, state)._replace(notes=())
            return _row(jnp.asarray(float(_OK)), clock.t0, values), jnp.array([1.0, 0.0]), state

        first = begun(self._packed)
        self._width = first[0].size
        self.first, parted = ravel_pytree(first)

        def advance(now: Array, packed: Array) -> Array:
            p, numbers, start, clock = form.unpack(packed)
            _, (_, n), state = parted(now)
            sane = bounded(Reading.of(start.z, start.xdot))
            take = _one_step(program, step, named, sane)
            t, state, ending, values, report = take(
                p, numbers, clock, n.astype(int), state, most is not None
            )
            self.iterates = any(name.startswith("newton") for name in report.turns)
            row = _row(1.0 * ending, t, values._replace(notes=()))
            return ravel_pytree((row, jnp.stack([1.0 * report.solved, n + 1]), state))[0]

        self._advance = jax.jit(advance)
        jax.eval_shape(self._advance, self.first, self._packed)  # tells whether it iterates

    def __call__(self, state: Float[Array, " n"]) -> Float[Array, " n"]:
        """Take one step; the result may not be ready yet."""
        return self._advance(state, self._packed)

    def run(self, states: Sequence[Float[Array, " n"]]) -> tuple[Trajectory, int]:
        """Return the run that states after each step make, and the number of unconverged steps.

        It ends before the first step that has no result: not solved though its iterations are not
        limited, refused by the method, not finite, or grown beyond all bounds.
        """
        table = np.stack([np.asarray(state)[: self._width + 1] for state in states])
        bad, solved = table[:, 0] != _OK, table[:, -1] > 0
        done = int(bad.argmax()) if bad.any() else len(bad)
        last = table[min(done, len(bad) - 1)]
        values = with_start(self._start, self._scene, table[:done, 1:-1], ())
        ending = Ending(int(last[0])).with_cause(self._program.functions, self._scene, values)
        status, message = ending.outcome(float(last[1]), self._t_end)
        return Trajectory(**values, status=status, message=message), int((~solved[:done]).sum())
