"""Runs whose steps follow a tolerance: the compiled time loop with its step controller.

A method adds to ``begin``, ``step`` and ``read`` an estimate of the error that a step made, from
which `StepControl` chooses the steps, or a control of its own.

The controller chooses the steps so that the *achieved* error follows the tolerance: a method of
order p leaves local errors of order p + 1, and its global error goes with h^p. Holding every local
error at ``rtol^(1/p)`` times the tolerance makes h go with tol^(1/p), and the global error with tol
(see Soederlind & Wang 2006, doi:10.1016/j.cam.2005.03.008). Where the estimate is that of a method
of lower order e, the same argument allows ``rtol^((e+1)/p - 1)`` times the tolerance. Equal local
errors in all steps are the mesh with the fewest steps for a given sum of local errors.

An error is measured as the bench measures it: the Euclidean norm of a group (q, v, x) relative to
the norm of the group's values, at the larger end of the step, with atol added. This scale follows a
motion that slows down. The largest value so far would not, and costs up to a thousand times the
error where small errors grow.

The controller is proportional-integral (Gustafsson 1991, doi:10.1145/210232.210242)::

    h+ = h 0.9 err^(-0.7/(e+1)) err_before^(0.4/(e+1))

A method with a published control of its own states it by ``choose`` instead.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from integrators.contract import Trajectory, Work
from integrators.native.algebra.step_records import COUNTS, Errors, Reading, Scalar, Time, largest
from integrators.native.loops.kernel import (
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
)
from integrators.native.step.step_program import Carried, Numbers, StepFunctions, StepProgram
from integrators.output_rows import EVERY_STEP, is_row, row_times, width_of
from integrators.resolutions import Tolerances
from problems.base.runtime import Array, Bool, Float, Int, jax, jnp
from problems.equations.formulations import Start
from problems.equations.programs import turns
from problems.system import MechatronicSystem

_OK, _MOST_STEPS, _ERROR = map(int, (Ending.OK, Ending.BUDGET_EXCEEDED, Ending.ERROR_TEST_FAILED))
_NEWTON, _DIVERGED = int(Ending.NEWTON_FAILED), int(Ending.DIVERGED)

_SAFETY = 0.9
#: Factors of a rejected step.
_SHARPEST, _AFTER_FAILURE = 0.1, 0.25
#: The first step is at most this part of the interval.
_FIRST_PART = 0.01


class Span(NamedTuple):
    """Interval in s, tolerances and step limit of a run."""

    t0: Scalar
    t_end: Scalar
    rtol: Scalar
    atol: Scalar
    max_steps: Int[Array, ""] | int


class StepControl:
    """The choice of steps for a method; all functions can be traced."""

    def __init__(self, functions: StepFunctions) -> None:
        self._estimated, self._tested = functions.order_of_estimate, functions.tested
        self._first = functions.order_of_first_step
        #: States may err by the tolerance times this power of rtol.
        self._sharper = (self._estimated + 1) / functions.order - 1

    def error(self, errors: Errors, old: Reading, new: Reading, span: Span) -> Scalar:
        """Largest error relative to the allowed error, between values at both ends of a step; 1 is
        just accepted."""
        norm = jnp.linalg.norm

        def relative(group: str) -> Scalar:
            scale = jnp.maximum(norm(getattr(old, group)), norm(getattr(new, group)))
            return norm(getattr(errors, group)) / (span.atol + span.rtol * scale)

        largest_of_all = jnp.max(jnp.stack([relative(group) for group in errors._fields]))
        return largest_of_all / span.rtol**self._sharper

    def ratio(
        self,
        error: Scalar,
        before: Scalar,
        order: Scalar,
        limits: tuple[Scalar, Scalar],
        solved: Bool[Array, ""],
    ) -> Scalar:
        """Ratio of the next step to a tried one of some order.

        ``error`` and ``before`` are the relative sizes of its error and of the last accepted
        step's, ``limits`` the smallest and largest ratio after an accepted step; ``solved`` is true
        if its equations are solved and all values finite.
        """
        power = 1 / (order + 1)
        ratio = _SAFETY * error ** (-0.7 * power) * before ** (0.4 * power)
        growing = jnp.clip(ratio, jnp.maximum(limits[0], _SHARPEST), limits[1])
        shrinking = jnp.clip(_SAFETY * error**-power, _SHARPEST, _SAFETY)
        shrinking = jnp.where(solved, shrinking, _AFTER_FAILURE)
        return jnp.where(solved & (error <= 1.0), growing, shrinking)

    def first_step(self, start: Start, span: Span) -> Time:
        """Step at which the next term of the Taylor series of a tested group is the tolerance.

        Of methods above order two a later term counts; all have the same scale of time.
        """
        z, length = start.z, span.t_end - span.t0

        def limit(rate: Array, scale: Scalar, power: int) -> Scalar:
            size = span.atol / span.rtol + scale
            time = (size / (jnp.linalg.norm(rate) + 1e-300)) ** (1 / power)
            return time * span.rtol ** ((1 + self._sharper) / (power + self._first - 2))

        norm = jnp.linalg.norm
        speed = jnp.maximum(norm(z.v), _FIRST_PART * length * norm(z.a))
        limits = {
            "q": limit(start.jerk / 12, norm(z.q), 3),
            "v": limit(start.jerk, speed, 2),
            "x": limit(start.xddot, norm(z.x), 2),
        }
        h = jnp.min(jnp.stack([limits[group] for group in self._tested]))
        return jnp.minimum(h, _FIRST_PART * length)


class AdaptiveRun(LoopRun):
    """A run whose steps follow a tolerance."""

    def __init__(
        self, method: OnScene, t_end: float, resolution: Tolerances, max_steps: int
    ) -> None:
        t0 = method.scene.interval[0]
        self._span = Span(t0, float(t_end), resolution.rtol, resolution.atol, max_steps)
        super().__init__(kernel, method, self._span)
        # Of the types that `measure` gives: others would be compiled again.
        self.end_only = jnp.asarray(np.full(self._slots, EVERY_STEP)), jnp.asarray(1)
        # A loop over no time compiles the kernel and costs nothing else.
        nothing = self.kernel.form.pack(*self._parts, self._span._replace(t_end=t0))
        jax.block_until_ready(self.kernel(nothing, *self.end_only))

    def measure(self) -> Trajectory:
        width, windows, last, end = width_of(self._scene.sizes), [], np.zeros(0), np.zeros(0)
        first, times, full = 1, EVERY_STEP, True
        while full:  # each call begins at the start again, and keeps the next rows
            wanted = jnp.asarray(np.arange(first, first + self._slots)), jnp.asarray(times)
            window, last, end = map(np.asarray, self._called(*wanted))
            before, times = times, row_times(int(end[2]), width)
            if times == before:
                windows.append(window)
                first, full = first + self._slots, window[-1, 0] > 0
        self._turns = [*map(int, end[4 + len(COUNTS) :])]
        found = np.concatenate([*windows, last[None]])
        _, places = np.unique(found[:, 0], return_index=True)  # in the order of steps, each once
        rows = found[places[found[places, 0] > 0]]
        work = Work(*map(int, end[2 : 4 + len(COUNTS)]))
        return self._trajectory(rows, end, float(self._span.t_end), work, int(self._span.max_steps))


class _Progress(NamedTuple):
    """Progress of a run: time and state, the step to try next, control, counts and stored rows."""

    t: Scalar
    state: Carried
    h: Time
    #: Relative size of the last accepted step's error; 1 is just allowed.
    error: Scalar
    ending: Int[Array, ""]
    counts: tuple[Int[Array, ""], ...]
    table: Float[Array, "k n"]
    #: Number of rows so far, those before the first of the table included.
    number: Int[Array, ""]


@cache
def kernel(program: StepProgram, template: MechatronicSystem, form: Form) -> Kernel:
    """Return the compiled time loop of a method on a kind of scene, for any numbers and parameters.

    It returns rows and the last row, each ``[step, t, q, v, a, lam, x, xdot, y, notes]`` (step 0:
    no row), and ``[ending, t, steps, rejected, newton, ...]``. The rows are those of `is_row` with
    as many ``times``, and of these the ``wanted`` ones: numbers in a row, from 1.
    """
    control, (named, step) = StepControl(program.functions), step_on(program, template)

    def loop(
        p: dict, numbers: Numbers, start: Start, span: Span, wanted: Array, times: Array
    ) -> tuple[Array, ...]:
        scene, method = named.with_parameters(p), program.method(numbers)
        smallest = 16 * np.finfo(float).eps * jnp.maximum(jnp.abs(span.t0), jnp.abs(span.t_end))
        h0 = jnp.maximum(method.first_step(control.first_step(start, span)), smallest)
        begun = program.begin(scene, numbers, start, h0)
        first = program.read(scene, begun)
        is_bounded, limits = bounded(first), method.ratios()

        def goes_on(m: _Progress) -> Array:
            left = (m.t < span.t_end) & (m.ending == _OK)
            return left & (m.counts[0] + m.counts[1] < span.max_steps)

        def judged(
            m: _Progress, h: Time, after: Carried, now: Reading, converged: Any
        ) -> tuple[Array, Array, Scalar, Array]:
            """Whether a tried step counts, the next one, its error, and how the run ends by it."""
            finite, states = jnp.isfinite(largest(*now[:-1])), (m.state.state, after.state)
            solved = finite & converged
            choice, error = method.choose(*states, h, solved, span.rtol), m.error
            if choice is None:
                errors, before = method.estimate(*states, h), program.read(scene, m.state)
                error = control.error(errors, before, now, span)
                finite = finite & jnp.isfinite(error)
                solved = finite & converged
                error = jnp.maximum(error, 1e-4)
                ratio = control.ratio(error, m.error, method.order_of(after.state), limits, solved)
                choice = solved & (error <= 1.0), ratio
            accepted, h_next = choice[0], h * choice[1]
            reason = jnp.where(solved, _ERROR, jnp.where(finite, _NEWTON, _DIVERGED))
            ending = jnp.where(~accepted & (h_next < smallest), reason, _OK)
            ending = jnp.where(accepted & ~is_bounded(now), _DIVERGED, ending)
            return accepted, jnp.maximum(h_next, smallest), error, ending

        def one_step(m: _Progress) -> _Progress:
            left = span.t_end - m.t
            # The step is changed a little so that the last one is not tiny.
            h = jnp.where(left <= m.h * 1.001, left, jnp.where(left < 2 * m.h, left / 2, m.h))
            # Always h; without it XLA rounds the stages of `phem56` otherwise.
            h = jnp.where(goes_on(m), h, jnp.nan)
            t = jnp.where(h == left, span.t_end, m.t + h)
            state, report = step(p, numbers, m.state, t, h)
            now = program.read(scene, state)
            accepted, h_next, error, ending = judged(m, h, state, now, report.converged)
            counts = (accepted, ~accepted, *report.counts)
            counts = tuple(c + more for c, more in zip(m.counts, counts, strict=True))
            row = jnp.concatenate([jnp.stack([1.0 * counts[0], t]), flat_row(now)])
            before, part = ((at - span.t0) / (span.t_end - span.t0) for at in (m.t, t))
            kept, first = accepted & is_row(counts[0], before, part, times), wanted[0]
            number = m.number + kept
            place = jnp.where(kept & (number >= first), number - first, len(m.table))
            table = m.table.at[place].set(row, mode="drop")
            t, error = jnp.where(accepted, t, m.t), jnp.where(accepted, error, m.error)
            short = (counts[0] + counts[1] >= span.max_steps) & (t < span.t_end)
            ending = jnp.where((ending == _OK) & short, _MOST_STEPS, ending)
            state = program.chosen(accepted, state, m.state)
            return _Progress(t, state, h_next, error, ending, counts, table, number)

        counts, width = no_counts(2, step, p, numbers, begun), 2 + flat_row(first).size
        m = _Progress(
            span.t0, begun, h0, jnp.asarray(1.0), jnp.asarray(_OK), counts,
            jnp.zeros((wanted.size, width)), jnp.asarray(0),
        )  # fmt: skip
        with turns(STEPS):
            m = jax.lax.while_loop(goes_on, one_step, m)
        last = jnp.stack([1.0 * m.counts[0], m.t]), flat_row(program.read(scene, m.state))
        program.finish(m.state)
        return m.table, jnp.concatenate(last), jnp.stack([m.ending, m.t, *m.counts])

    return Kernel(loop, form)
