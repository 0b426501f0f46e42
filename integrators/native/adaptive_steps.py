"""Runs whose steps follow a tolerance: the compiled time loop with its step controller.

A method adds to ``begin``, ``step`` and ``read`` an estimate of the error that a step made, from
which `integrators.native.step_control` chooses the steps, or a control of its own.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from integrators.contract import PreparedRun, Tolerances, Trajectory, Work
from integrators.kept_rows import EVERY_STEP, is_row, row_times, width_of
from integrators.native import small_matrices
from integrators.native.constant_steps import row_slots
from integrators.native.endings import Ending
from integrators.native.kernel import Kernel, SparseKernel
from integrators.native.rows import KeptRows, bounded, flat, with_start
from integrators.native.step_control import Span, StepControl
from integrators.native.step_operations import run_bill
from integrators.native.step_program import Numbers, StepProgram
from integrators.native.step_records import COUNTS, Attempt, Choice, Reading, StepReport, largest
from problems.formulations import Start
from problems.initial_values import consistent_start
from problems.runtime import jax, jnp
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Int

    from integrators.native.step_records import MethodState, Scalar, Time

_OK, _MOST_STEPS, _ERROR, _NEWTON, _NOT_FINITE, _DIVERGED = (
    int(ending)
    for ending in (
        Ending.OK,
        Ending.BUDGET_EXCEEDED,
        Ending.ERROR_TEST_FAILED,
        Ending.NEWTON_KEPT_FAILING,
        Ending.NOT_FINITE,
        Ending.UNBOUNDED,
    )
)


class _Progress(NamedTuple):
    """Progress of a run: time and state, the step to try next, control, counts and stored rows."""

    t: Scalar
    state: MethodState
    h: Time
    #: Relative size of the last accepted step's error; 1 is just allowed.
    error: Scalar
    #: Largest norms of a and lam so far.
    peaks: tuple[Scalar, ...]
    ending: Int[Array, ""]
    counts: tuple[Int[Array, ""], ...]
    rows: KeptRows


class AdaptiveRun(PreparedRun):
    """A run whose steps follow a tolerance; ``noted`` are the names of a reading's notes."""

    def __init__(
        self,
        program: StepProgram,
        numbers: Numbers,
        noted: tuple[str, ...],
        scene: MechatronicSystem,
        t_end: float,
        resolution: Tolerances,
        max_steps: int,
    ) -> None:
        self._start, self._noted = consistent_start(scene), noted
        self._program, self._scene = program, scene
        t0 = scene.interval[0]
        self._span = Span(t0, float(t_end), resolution.rtol, resolution.atol, max_steps)
        self.kernel = kernel(program, scene.template())
        packs = [scene.parameters(), numbers, self._start]
        self.arguments = self.kernel.pack(*packs, self._span)
        self._slots = row_slots(scene)
        self.end_only = jnp.full(self._slots, EVERY_STEP), jnp.asarray(1)
        # A loop over no time compiles the kernel and costs nothing else.
        nothing = self.kernel.pack(*packs, self._span._replace(t_end=t0))
        jax.block_until_ready(self.kernel(nothing, *self.end_only))

    def execute(self) -> Any:
        return jax.block_until_ready(self.kernel(self.arguments, *self.end_only))

    def measure(self) -> Trajectory:
        width, windows, last, end = width_of(self._scene.sizes), [], np.zeros(0), np.zeros(0)
        first, times, full = 1, EVERY_STEP, True
        while full:  # each call begins at the start again, and keeps the next rows
            wanted = jnp.arange(first, first + self._slots), jnp.asarray(times)
            window, last, end = map(np.asarray, self.kernel(self.arguments, *wanted))
            before, times = times, row_times(int(end[2]), width)
            if times == before:
                windows.append(window)
                first, full = first + self._slots, window[-1, 0] > 0
        ending, t, *counts = end
        rows = in_order(np.concatenate([*windows, last[None]]))
        values = with_start(self._start, rows[:, 1:], self._noted)
        ended = self._program.cause(Ending(int(ending)), self._scene, values)
        status, message = ended.outcome(
            float(t), float(self._span.t_end), int(self._span.max_steps)
        )
        work = Work(*map(int, counts))
        return Trajectory(**values, status=status, message=message, work=work)

    def bill(self, run: Trajectory) -> dict[str, float]:
        return run_bill(self._program, self._scene, run, self.kernel.shapes(self.arguments))


def in_order(rows: np.ndarray) -> np.ndarray:
    """The stored rows of a kernel in the order of steps, without repetitions and empty rows."""
    _, places = np.unique(rows[:, 0], return_index=True)
    return rows[places[rows[places, 0] > 0]]


class _SparseKernel(SparseKernel):
    """A sparse kernel at chosen steps; its step limit counts rejected steps, too."""

    def most_steps(self, packed: Array, *wanted: Any) -> int:
        return int(self.unpacked(packed)[-1].max_steps)

    def limited(self, steps: int, packed: Array, *wanted: Any) -> tuple:
        *others, last = self.unpacked(packed)
        return self.pack(*others, last._replace(max_steps=steps)), *wanted

    def up_to(self, steps: int, packed: Array, *wanted: Any) -> Any:
        *rows, end = self._attempt(*self.limited(steps, packed, *wanted))
        return *rows, end.at[0].set(_NOT_FINITE)


@cache
def kernel(program: StepProgram, template: MechatronicSystem) -> Kernel:
    """Return the compiled time loop of a method on a kind of scene, for any numbers and parameters.

    It returns rows and the last row, each ``[step, t, q, v, a, lam, x, xdot, y, notes]`` (step 0:
    no row), and ``[ending, t, steps, rejected, newton, ...]``. The rows are those of `is_row` with
    as many ``times``, and of these the ``wanted`` ones: numbers in a row, from 1. With None the
    program has no memory for them: many runs side by side would copy it in every step.
    """
    control = StepControl(program.functions)

    def sizes_of(reading: Reading) -> tuple[Scalar, Scalar]:
        return jnp.linalg.norm(reading.a), jnp.linalg.norm(reading.lam)

    def fitted(h: Time, left: Scalar) -> Time:
        """The step, changed a little so that the last step to the end is not tiny."""
        return jnp.where(left <= h * 1.001, left, jnp.where(left < 2 * h, left / 2, h))

    @small_matrices.without_products
    def advance(p: dict, numbers: Numbers, state: Any, t: Time, h: Time) -> tuple[Any, StepReport]:
        return program.step(template.with_parameters(p), numbers, state, t, h)

    def loop(
        p: dict, numbers: Numbers, start: Start, span: Span, wanted: Array | None, times: Array
    ) -> tuple[Array, ...]:
        scene = template.with_parameters(p)
        smallest = 16 * np.finfo(float).eps * jnp.maximum(jnp.abs(span.t0), jnp.abs(span.t_end))
        h0 = jnp.maximum(program.first_step(numbers, control.first_step(start, span)), smallest)
        state = program.begin(scene, numbers, start, h0)
        first = program.read(scene, state)
        bound = bounded(first)
        limits = program.ratios(numbers)

        def going(m: _Progress) -> Array:
            left = (m.t < span.t_end) & (m.ending == _OK)
            return left & (m.counts[0] + m.counts[1] < span.max_steps)

        def try_step(m: _Progress) -> _Progress:
            left = span.t_end - m.t
            # Among many runs an ended run still takes steps, whose results are dropped. With a NaN
            # step Newton's method ends at once.
            h = jnp.where(going(m), fitted(m.h, left), jnp.nan)
            t = jnp.where(h == left, span.t_end, m.t + h)
            state, report = advance(p, numbers, m.state, t, h)
            now = program.read(scene, state)
            peaks = tuple(map(jnp.maximum, m.peaks, sizes_of(now)))
            sane = jnp.isfinite(largest(*now[:-1]))
            solved = sane & report.converged
            choice = program.choose(numbers, Attempt(m.state, state, h, solved, span.rtol))
            error = m.error
            if choice is None:
                errors = program.estimate(numbers, m.state, state, h)
                error = control.error(errors, program.read(scene, m.state), now, peaks, span)
                sane = sane & jnp.isfinite(error)
                solved = sane & report.converged
                error = jnp.maximum(error, 1e-4)
                ratio = control.ratio(error, m.error, program.order_of(state), limits, solved)
                choice = Choice(solved & (error <= 1.0), ratio)
            accepted, h_next = choice.accepted, h * choice.ratio

            counts = (accepted, ~accepted, *report.counts)
            counts = tuple(c + now for c, now in zip(m.counts, counts, strict=True))
            reason = jnp.where(solved, _ERROR, jnp.where(sane, _NEWTON, _NOT_FINITE))
            ending = jnp.where(~accepted & (h_next < smallest), reason, _OK)
            ending = jnp.where(accepted & ~bound(now), _DIVERGED, ending)
            used = counts[0] + counts[1]
            short = (used >= span.max_steps) & (jnp.where(accepted, t, m.t) < span.t_end)
            ending = jnp.where((ending == _OK) & short, _MOST_STEPS, ending)

            rows = m.rows
            if wanted is not None:
                row = jnp.concatenate([jnp.stack([1.0 * counts[0], t]), flat(now)])
                before, part = ((at - span.t0) / (span.t_end - span.t0) for at in (m.t, t))
                kept = accepted & is_row(counts[0], before, part, times)
                rows = rows.with_row(row, kept, wanted[0])

            def choose(new: Any, old: Any) -> Any:
                return jax.tree.map(lambda a, b: jnp.where(accepted, a, b), new, old)

            state = program.after_try(accepted, state, m.state)
            t, error, peaks = choose((t, error, peaks), (m.t, m.error, m.peaks))
            return m._replace(
                t=t, state=state, h=jnp.maximum(h_next, smallest), error=error, peaks=peaks,
                ending=ending, counts=counts, rows=rows,
            )  # fmt: skip

        width, slots = 2 + flat(first).size, 0 if wanted is None else wanted.size
        m = jax.lax.while_loop(
            going,
            try_step,
            _Progress(
                t=span.t0,
                state=state,
                h=h0,
                error=jnp.asarray(1.0),
                peaks=sizes_of(first),
                ending=jnp.asarray(_OK),
                counts=(jnp.asarray(0),) * (2 + len(COUNTS)),
                rows=KeptRows(jnp.zeros((slots, width)), jnp.asarray(0)),
            ),
        )
        last = jnp.concatenate(
            [jnp.stack([1.0 * m.counts[0], m.t]), flat(program.read(scene, m.state))]
        )
        program.finish(m.state)
        return m.rows.table, last, jnp.stack([m.ending, m.t, *m.counts])

    if program.patterns:
        return _SparseKernel(loop)
    return Kernel(loop, ("adaptive steps", program, template))
