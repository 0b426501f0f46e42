"""Runs whose steps follow a tolerance: the compiled time loop with its step controller.

A method adds to ``begin``, ``step`` and ``read`` an estimate of the error that a step made. The
controller then chooses the steps so that the *achieved* error follows the tolerance: a method of
order p leaves local errors of order p + 1, and its global error goes with h^p. Holding every local
error at ``rtol^(1/p)`` times the tolerance makes h go with tol^(1/p), and the global error with tol
(see Soederlind & Wang 2006, doi:10.1016/j.cam.2005.03.008). Where the estimate is that of a method
of lower order e, the same argument allows ``rtol^((e+1)/p - 1)`` times the tolerance. Equal local
errors in all steps are the mesh with the fewest steps for a given sum of local errors.

An error is measured as the bench measures it: the Euclidean norm of a group (q, v, x, a, lam)
relative to the norm of the group's values, at the larger end of the step, with atol added. This
scale follows a motion that slows down. The largest value so far would not, and costs up to a
thousand times the error where small errors grow. Only a and lam, if they are tested, are relative
to their largest values: they have no history of their own, and after a cut they move by the error
of the step before, however small the next is.

The controller is proportional-integral (Gustafsson 1991, doi:10.1145/210232.210242)::

    h+ = h 0.9 err^(-0.7/(e+1)) err_before^(0.4/(e+1))

A method with a published control of its own states it by ``choose`` instead.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from integrators.contract import PreparedRun, Tolerances, Trajectory, Work
from integrators.kept_rows import FIRST_ROWS, MOST_ROWS
from integrators.native import small_matrices
from integrators.native.constant_steps import ROW_SLOTS
from integrators.native.endings import Ending
from integrators.native.kernel import Kernel, SparseKernel
from integrators.native.rows import GROWTH_LIMIT, flat, with_start
from integrators.native.step_operations import run_bill
from integrators.native.step_program import Numbers, StepProgram
from integrators.native.step_records import Attempt, Errors, Reading, StepReport, largest
from problems.formulations import Start
from problems.initial_values import consistent_start
from problems.runtime import jax, jnp
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Float, Int

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

_SAFETY = 0.9
#: Factors of a rejected step.
_SHARPEST, _AFTER_FAILURE = 0.1, 0.25
#: The first step is at most this part of the interval.
_FIRST_PART = 0.01

#: Rows of one run among many, besides the first: they are spread over the run.
_SPREAD_SLOTS = 400


class Span(NamedTuple):
    """Interval in s, tolerances and step limit of a run."""

    t0: Scalar
    t_end: Scalar
    rtol: Scalar
    atol: Scalar
    max_steps: Int[Array, ""] | int


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
    early: Float[Array, "e n"]
    spread: Float[Array, "s n"]
    stride: Int[Array, ""]


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
        self.end_only = (jnp.zeros(ROW_SLOTS, dtype=int),)
        # A loop over no time compiles the kernel and costs nothing else.
        nothing = self.kernel.pack(*packs, self._span._replace(t_end=t0))
        jax.block_until_ready(self.kernel(nothing, *self.end_only))

    def execute(self) -> Any:
        return jax.block_until_ready(self.kernel(self.arguments, *self.end_only))

    def measure(self) -> Trajectory:
        first, steps, parts, last, end = 1, MOST_ROWS, [], np.zeros(0), np.zeros(0)
        # Each call begins at the start again, and keeps the next rows.
        while first <= steps:
            wanted = jnp.full(ROW_SLOTS, first)
            window, spread, last, end = map(np.asarray, self.kernel(self.arguments, wanted))
            steps, first = int(end[2]), first + ROW_SLOTS
            parts.append(window)
            if steps > MOST_ROWS:
                parts.append(spread)
                break
        ending, t, *counts = end
        rows = in_order(np.concatenate([*parts, last[None]]))
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

    It returns the first rows, rows spread over the run, and the last row, each ``[step, t, q, v, a,
    lam, x, xdot, y, notes]`` (step 0: no row), and ``[ending, t, steps, rejected, newton, ...]``.
    ``wanted`` is the number of the step with which the first rows begin, repeated for each slot of
    them; a scalar has `FIRST_ROWS` slots. With 0 only the last row is stored. With None the program
    has no memory for other rows: many runs side by side would copy it in every step.
    """
    order, estimated = program.functions.order, program.functions.order_of_estimate
    first = program.functions.order_of_first_step
    #: States may err by the tolerance times this power of rtol.
    sharper = (estimated + 1) / order - 1

    def size_of(
        errors: Errors, old: Reading, new: Reading, peaks: tuple[Scalar, ...], span: Span
    ) -> Scalar:
        """Largest error relative to the allowed error; 1 is just accepted."""

        def relative(group: str, scale: Scalar) -> Scalar:
            return jnp.linalg.norm(getattr(errors, group)) / (span.atol + span.rtol * scale)

        def larger_end(group: str) -> Scalar:
            norm = jnp.linalg.norm
            return jnp.maximum(norm(getattr(old, group)), norm(getattr(new, group)))

        states = jnp.max(jnp.stack([relative(g, larger_end(g)) for g in ("q", "v", "x")]))
        algebraic = jnp.maximum(relative("a", peaks[0]), relative("lam", peaks[1]))
        # Estimates go with h^(e+1), those of a and lam with h^e.
        power = (estimated + 1) / estimated
        return jnp.maximum(states / span.rtol**sharper, algebraic**power)

    def sizes_of(reading: Reading) -> tuple[Scalar, Scalar]:
        return jnp.linalg.norm(reading.a), jnp.linalg.norm(reading.lam)

    def first_step(start: Start, span: Span) -> Time:
        """Step at which the next term of the Taylor series of a tested group is the tolerance.

        Of methods above order two a later term counts; all have the same scale of time.
        """
        z, length = start.z, span.t_end - span.t0

        def limit(rate: Array, scale: Scalar, power: int) -> Scalar:
            size = span.atol / span.rtol + scale
            time = (size / (jnp.linalg.norm(rate) + 1e-300)) ** (1 / power)
            return time * span.rtol ** ((1 + sharper) / (power + first - 2))

        norm = jnp.linalg.norm
        speed = jnp.maximum(norm(z.v), _FIRST_PART * length * norm(z.a))
        limits = {
            "q": limit(start.jerk / 12, norm(z.q), 3),
            "v": limit(start.jerk, speed, 2),
            "x": limit(start.xddot, norm(z.x), 2),
        }
        h = jnp.min(jnp.stack([limits[group] for group in program.functions.tested]))
        return jnp.minimum(h, _FIRST_PART * length)

    def fitted(h: Time, left: Scalar) -> Time:
        """The step, changed a little so that the last step to the end is not tiny."""
        return jnp.where(left <= h * 1.001, left, jnp.where(left < 2 * h, left / 2, h))

    def keep(m: _Progress, n: Array, row: Array, wanted: Array) -> _Progress:
        """Store the row of the n-th step among the first rows or in the spread.

        When the spread is full, every other row of it is dropped and the stride doubles.
        """
        slots = len(m.early)
        place = n - wanted
        early = m.early.at[jnp.where((wanted > 0) & (place >= 0), place, slots)].set(
            row, mode="drop"
        )
        slot, hit = n // m.stride - 1, (wanted > 0) & (n % m.stride == 0)
        spread = m.spread.at[jnp.where(hit, slot, _SPREAD_SLOTS)].set(row, mode="drop")
        full = hit & (slot == _SPREAD_SLOTS - 1)

        def thin(spread: Array) -> Array:
            return jnp.zeros_like(spread).at[: _SPREAD_SLOTS // 2].set(spread[1::2])

        spread = jax.lax.cond(full, thin, lambda spread: spread, spread)
        return m._replace(early=early, spread=spread, stride=jnp.where(full, 2, 1) * m.stride)

    @small_matrices.without_products
    def advance(p: dict, numbers: Numbers, state: Any, t: Time, h: Time) -> tuple[Any, StepReport]:
        return program.step(template.with_parameters(p), numbers, state, t, h)

    def loop(
        p: dict, numbers: Numbers, start: Start, span: Span, wanted: Array | None
    ) -> tuple[Array, ...]:
        scene = template.with_parameters(p)
        smallest = 16 * np.finfo(float).eps * jnp.maximum(jnp.abs(span.t0), jnp.abs(span.t_end))
        h0 = jnp.maximum(program.first_step(numbers, first_step(start, span)), smallest)
        state = program.begin(scene, numbers, start, h0)
        first = program.read(scene, state)
        bound = GROWTH_LIMIT * (1.0 + largest(first.q, first.v))
        lowest, highest = program.ratios(numbers)

        def going(m: _Progress) -> Array:
            return (m.t < span.t_end) & (m.ending == _OK)

        def try_step(m: _Progress) -> _Progress:
            left = span.t_end - m.t
            # Among many runs an ended run still takes steps, whose results are dropped. With a NaN
            # step Newton's method ends at once.
            h = jnp.where(going(m), fitted(m.h, left), jnp.nan)
            t = jnp.where(h == left, span.t_end, m.t + h)
            state, report = advance(p, numbers, m.state, t, h)
            now = program.read(scene, state)
            peaks = tuple(map(jnp.maximum, m.peaks, sizes_of(now)))
            sane = jnp.isfinite(largest(now.q, now.v, now.a, now.lam))
            solved = sane & report.converged
            own = program.choose(numbers, Attempt(m.state, state, h, solved, span.rtol))
            if own is not None:
                error, accepted, h_next = m.error, own.accepted, h * own.ratio
            else:
                errors = program.estimate(numbers, m.state, state, h)
                error = size_of(errors, program.read(scene, m.state), now, peaks, span)
                sane = sane & jnp.isfinite(error)
                solved = sane & report.converged
                accepted = solved & (error <= 1.0)
                error = jnp.maximum(error, 1e-4)
                power = 1 / (program.order_of(state) + 1)

                ratio = _SAFETY * error ** (-0.7 * power) * m.error ** (0.4 * power)
                growing = jnp.clip(ratio, jnp.maximum(lowest, _SHARPEST), highest)
                shrinking = jnp.clip(_SAFETY * error**-power, _SHARPEST, _SAFETY)
                shrinking = jnp.where(solved, shrinking, _AFTER_FAILURE)
                h_next = h * jnp.where(accepted, growing, shrinking)

            counts = (accepted, ~accepted, *report[1:])
            counts = tuple(c + now for c, now in zip(m.counts, counts, strict=True))
            reason = jnp.where(solved, _ERROR, jnp.where(sane, _NEWTON, _NOT_FINITE))
            ending = jnp.where(~accepted & (h_next < smallest), reason, _OK)
            ending = jnp.where(accepted & ~(largest(now.q, now.v) < bound), _DIVERGED, ending)
            used = counts[0] + counts[1]
            short = (used >= span.max_steps) & (m.t + h * accepted < span.t_end)
            ending = jnp.where((ending == _OK) & short, _MOST_STEPS, ending)

            row = jnp.concatenate([jnp.stack([1.0 * counts[0], t]), flat(now)])
            if wanted is not None:
                m = keep(m, counts[0], row, jnp.where(accepted, jnp.ravel(wanted)[0], 0))

            def choose(new: Any, old: Any) -> Any:
                return jax.tree.map(lambda a, b: jnp.where(accepted, a, b), new, old)

            state = program.after_try(accepted, state, m.state)
            t, error, peaks = choose((t, error, peaks), (m.t, m.error, m.peaks))
            return m._replace(
                t=t, state=state, h=jnp.maximum(h_next, smallest), error=error, peaks=peaks,
                ending=ending, counts=counts,
            )  # fmt: skip

        width, room = 2 + flat(first).size, 0 if wanted is None else 1
        slots = wanted.size if wanted is not None and wanted.ndim else room * FIRST_ROWS
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
                counts=(jnp.asarray(0),) * (1 + len(StepReport._fields)),
                early=jnp.zeros((slots, width)),
                spread=jnp.zeros((room * _SPREAD_SLOTS, width)),
                stride=jnp.asarray(1),
            ),
        )
        last = jnp.concatenate(
            [jnp.stack([1.0 * m.counts[0], m.t]), flat(program.read(scene, m.state))]
        )
        program.finish(m.state)
        return m.early, m.spread, last, jnp.stack([m.ending, m.t, *m.counts])

    return (_SparseKernel if program.patterns else Kernel)(loop)
