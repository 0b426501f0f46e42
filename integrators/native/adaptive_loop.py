"""Error-controlled steps for methods written in JAX: the compiled march with a step controller.

A method adds to ``begin``, ``step`` and ``read`` an estimate of the error that a step made. The
controller then chooses the steps so that the *achieved* error follows the tolerance: a method of
order p leaves local errors of order p + 1, and its global error goes with h^p. Holding every local
error at ``rtol^(1/p)`` times the tolerance makes h go with tol^(1/p), and the global error with tol
(see Soederlind & Wang 2006, doi:10.1016/j.cam.2005.03.008). Equal local errors in all steps are the
mesh with the fewest steps for a given sum of local errors.

An error is measured as the bench measures it: the Euclidean norm of a group (q, v, x, a, lam)
relative to the norm of the group's values, at the larger end of the step, with atol added. That
follows the motion alike when it speeds up and when it slows down; a scale that remembers the
largest value so far does not, and costs up to a thousand times the error where small errors grow.
Only a and lam, if they are tested, are taken relative to their largest values: they have no history
of their own, and after a cut they move by the error of the step before, however small the next is.

The controller is proportional-integral (Gustafsson 1991, doi:10.1145/210232.210242)::

    h+ = h 0.9 err^(-0.7/(p+1)) err_before^(0.4/(p+1))
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
    PreparedRun,
    Tolerances,
    Trajectory,
    Work,
    option,
)
from integrators.native import small_matrices
from integrators.native.time_loop import (
    GROWTH_LIMIT,
    Kernel,
    Reading,
    StepMethod,
    StepReport,
    flat,
    largest,
    with_start,
)
from problems.formulations import Start
from problems.initial_values import consistent_start
from problems.runtime import jax, jnp
from problems.system import MechatronicSystem

_OK, _MOST_STEPS, _ERROR, _NEWTON, _NOT_FINITE, _DIVERGED = range(6)

_SAFETY = 0.9
#: Factors of a rejected step.
_SHARPEST, _AFTER_FAILURE = 0.1, 0.25
#: The first step is at most this part of the interval.
_FIRST_PART = 0.01

_SPREAD_SLOTS = 2 * SPREAD_ROWS


class Errors(NamedTuple):
    """Estimated errors of a step per entry of q, v, x, a and lam; those of a and lam, of order p
    instead of p + 1, may be zero: not tested."""

    q: Any
    v: Any
    x: Any
    a: Any
    lam: Any


class Span(NamedTuple):
    """From where to where, to what tolerance, in how many steps at most."""

    t0: Any
    t_end: Any
    rtol: Any
    atol: Any
    max_steps: Any


class _March(NamedTuple):
    """Where a march is: the method's state at t, the step to try next, the error of the last that
    was accepted, the largest a and lam so far, how the last try ended, counts, and rows kept."""

    t: Any
    state: Any
    h: Any
    error: Any
    peaks: Any
    ending: Any
    counts: tuple
    early: Any
    spread: Any
    stride: Any


@dataclass(frozen=True)
class AdaptiveMethod(StepMethod):
    """Base of one-step methods with an error estimate, written as pure JAX functions."""

    controls: ClassVar[str] = "tolerance"

    max_steps: int = option(1_000_000, "most steps in a run, rejected ones included", low=1)

    @abstractmethod
    def functions(self) -> tuple[Callable, Callable, Callable, Callable, Callable, int]:
        """``begin``, ``step`` and ``read`` as in StepMethod; then three for the control:

        ``estimate(numbers, before, after, h) -> Errors``
            of the step from one state to the next
        ``ratios(numbers)``
            smallest and largest ratio of neighbouring steps that the controller chooses of its own
            accord
        the order p
        """

    def kernel(self, scene: MechatronicSystem) -> Kernel:
        return kernel(*self.functions(), scene.template())

    def span(self, t0: float, t_end: float, tolerances: Tolerances) -> Span:
        """What a run's kernel takes last."""
        return Span(t0, t_end, tolerances.rtol, tolerances.atol, self.max_steps)

    def prepare(
        self, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> PreparedRun:
        return _AdaptiveRun(self, scene, t_end, resolution)


class _AdaptiveRun(PreparedRun):
    def __init__(
        self, method: AdaptiveMethod, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> None:
        self._method, self._start = method, consistent_start(scene)
        t0 = scene.interval[0]
        self._span = method.span(t0, float(t_end), resolution)
        self._kernel = method.kernel(scene)
        packs = [scene.parameters(), method.numbers(), self._start]
        self._arguments = self._kernel.pack(*packs, self._span)
        self._keep, self._drop = jnp.asarray(1), jnp.asarray(0)
        # A march over no time compiles the kernel and costs nothing else.
        nothing = self._kernel.pack(*packs, self._span._replace(t_end=t0))
        jax.block_until_ready(self._kernel(nothing, self._drop))

    def execute(self) -> Any:
        return jax.block_until_ready(self._kernel(self._arguments, self._drop))

    def measure(self) -> Trajectory:
        early, spread, last, end = map(np.asarray, self._kernel(self._arguments, self._keep))
        ending, t, *counts = end
        status, message = outcome(int(ending), float(t), self._span)
        rows = in_order(np.concatenate([early, spread, last[None]]))
        values = with_start(self._start, rows[:, 1:], self._method.noted)
        work = Work(*map(int, counts))
        return Trajectory(**values, status=status, message=message, work=work)


def in_order(rows: np.ndarray) -> np.ndarray:
    """The rows of a kernel that are there, each once, step by step."""
    _, places = np.unique(rows[:, 0], return_index=True)
    return rows[places[rows[places, 0] > 0]]


def outcome(ending: int, t: float, span: Span) -> tuple[str, str]:
    """Status and message of the ending that a kernel gave at t."""
    if ending == _OK:
        return "ok", ""
    status, reason, cure = {
        _MOST_STEPS: (
            "budget_exceeded",
            f"{span.max_steps} steps were used up",
            "raise max_steps or use a larger rtol",
        ),
        _ERROR: (
            "step_too_small",
            "the error test kept failing down to the smallest step",
            "use a larger rtol, or look for a jump in the scene's equations",
        ),
        _NEWTON: (
            "newton_failed",
            "Newton's method kept failing down to the smallest step",
            "use another rtol or a larger newton_max",
        ),
        _NOT_FINITE: (
            "diverged",
            "the equations are not finite from here on",
            "check the scene's equations beyond this time",
        ),
        _DIVERGED: (
            "diverged",
            "the solution grew beyond all bounds",
            "use a smaller rtol or check the scene's forces",
        ),
    }[ending]
    return status, f"Ended at t={t:.6g} s of {span.t_end:g} s: {reason}; {cure}."


@cache
def kernel(
    begin: Callable,
    step: Callable,
    read: Callable,
    estimate: Callable,
    ratios: Callable,
    order: int,
    template: MechatronicSystem,
) -> Kernel:
    """The compiled march of an adaptive method on a scene, for any numbers and parameters.

    It returns the first rows, rows spread over the run, and the last row, each ``[step, t, ...]``
    as in the march of fixed steps (step 0: no row), and ``[ending, t, steps, rejected,
    newton, ...]``. With ``wanted`` 0 the last row is the only one; with None the program has no
    room for others, which many runs side by side would copy in every step.
    """

    def size_of(errors: Errors, old: Reading, new: Reading, peaks: Any, span: Span) -> Any:
        """Largest error relative to what is allowed; 1 is just accepted."""

        def relative(group: str, scale: Any) -> Any:
            return jnp.linalg.norm(getattr(errors, group)) / (span.atol + span.rtol * scale)

        def larger_end(group: str) -> Any:
            norm = jnp.linalg.norm
            return jnp.maximum(norm(getattr(old, group)), norm(getattr(new, group)))

        states = jnp.max(jnp.stack([relative(g, larger_end(g)) for g in ("q", "v", "x")]))
        algebraic = jnp.maximum(relative("a", peaks[0]), relative("lam", peaks[1]))
        # Local errors go with h^(p+1), those of a and lam with h^p.
        return jnp.maximum(states / span.rtol ** (1 / order), algebraic ** ((order + 1) / order))

    def sizes_of(reading: Reading) -> tuple[Any, Any]:
        return jnp.linalg.norm(reading.a), jnp.linalg.norm(reading.lam)

    def first_step(start: Start, span: Span) -> Any:
        """Where the next term of the Taylor series of q or v reaches the tolerance."""
        z, length = start.z, span.t_end - span.t0

        def limit(rate: Any, scale: Any, power: int) -> Any:
            allowed = (span.atol + span.rtol * scale) * span.rtol ** (1 / order)
            return (allowed / (jnp.linalg.norm(rate) + 1e-300)) ** (1 / power)

        norm = jnp.linalg.norm
        speed = jnp.maximum(norm(z.v), _FIRST_PART * length * norm(z.a))
        h = jnp.minimum(limit(start.jerk / 12, norm(z.q), 3), limit(start.jerk, speed, 2))
        h = jnp.minimum(h, limit(start.xddot, norm(z.x), 2))
        return jnp.minimum(h, _FIRST_PART * length)

    def fitted(h: Any, left: Any) -> Any:
        """The step or a little more or less of it, so that the end is met without a sliver."""
        return jnp.where(left <= h * 1.001, left, jnp.where(left < 2 * h, left / 2, h))

    def keep(m: _March, n: Any, row: Any, wanted: Any) -> _March:
        """Store the row of the n-th step among the first or in the spread; when the spread is
        full, every other of its rows goes and the stride doubles."""
        early = m.early.at[jnp.where(wanted & (n <= FIRST_ROWS), n - 1, FIRST_ROWS)].set(
            row, mode="drop"
        )
        slot, hit = n // m.stride - 1, wanted & (n % m.stride == 0)
        spread = m.spread.at[jnp.where(hit, slot, _SPREAD_SLOTS)].set(row, mode="drop")
        full = hit & (slot == _SPREAD_SLOTS - 1)

        def thin(spread: Any) -> Any:
            return jnp.zeros_like(spread).at[:SPREAD_ROWS].set(spread[1::2])

        spread = jax.lax.cond(full, thin, lambda spread: spread, spread)
        return m._replace(early=early, spread=spread, stride=jnp.where(full, 2, 1) * m.stride)

    @small_matrices.without_products
    def advance(p: dict, numbers: Any, state: Any, t: Any, h: Any) -> tuple:
        return step(template.with_parameters(p), numbers, state, t, h)

    def march(p: dict, numbers: Any, start: Start, span: Span, wanted: Any) -> tuple:
        scene = template.with_parameters(p)
        smallest = 16 * np.finfo(float).eps * jnp.maximum(jnp.abs(span.t0), jnp.abs(span.t_end))
        h0 = jnp.maximum(first_step(start, span), smallest)
        state = begin(scene, numbers, start, h0)
        first = read(state)
        bound = GROWTH_LIMIT * (1.0 + largest(first.q, first.v))
        lowest, highest = ratios(numbers)
        power = 1 / (order + 1)

        def going(m: _March) -> Any:
            return (m.t < span.t_end) & (m.ending == _OK)

        def try_step(m: _March) -> _March:
            left = span.t_end - m.t
            # Among many runs those that have ended step on, too, and the step is dropped. It is
            # made one that Newton's method leaves at once.
            h = jnp.where(going(m), fitted(m.h, left), jnp.nan)
            t = jnp.where(h == left, span.t_end, m.t + h)
            state, report = advance(p, numbers, m.state, t, h)
            now = read(state)
            errors = estimate(numbers, m.state, state, h)
            peaks = tuple(map(jnp.maximum, m.peaks, sizes_of(now)))
            error = size_of(errors, read(m.state), now, peaks, span)
            sane = jnp.isfinite(error) & jnp.isfinite(largest(now.q, now.v, now.a, now.lam))
            solved = sane & report.converged
            accepted = solved & (error <= 1.0)
            error = jnp.maximum(error, 1e-4)

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
                m = keep(m, counts[0], row, accepted & (wanted > 0))

            def choose(new: Any, old: Any) -> Any:
                return jax.tree.map(lambda a, b: jnp.where(accepted, a, b), new, old)

            t, state, error, peaks = choose(
                (t, state, error, peaks), (m.t, m.state, m.error, m.peaks)
            )
            return m._replace(
                t=t, state=state, h=jnp.maximum(h_next, smallest), error=error, peaks=peaks,
                ending=ending, counts=counts,
            )  # fmt: skip

        width, room = 2 + flat(first).size, 0 if wanted is None else 1
        m = jax.lax.while_loop(
            going,
            try_step,
            _March(
                t=span.t0,
                state=state,
                h=h0,
                error=jnp.asarray(1.0),
                peaks=sizes_of(first),
                ending=jnp.asarray(_OK),
                counts=(jnp.asarray(0),) * (1 + len(StepReport._fields)),
                early=jnp.zeros((room * FIRST_ROWS, width)),
                spread=jnp.zeros((room * _SPREAD_SLOTS, width)),
                stride=jnp.asarray(1),
            ),
        )
        last = jnp.concatenate([jnp.stack([1.0 * m.counts[0], m.t]), flat(read(m.state))])
        return m.early, m.spread, last, jnp.stack([m.ending, m.t, *m.counts])

    return Kernel(march)
