"""One-step methods written in JAX: the compiled march that turns a step into a run.

A method states ``numbers`` (its parameters as plain numbers), ``start``, ``step`` and ``read`` as
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
from problems.formulations import Start, consistent_start
from problems.runtime import jax, jnp
from problems.system import MechatronicSystem, Sizes

#: A run whose q or v has grown by this factor is called diverged.
GROWTH_LIMIT = 1e12

_PATTERN_SLOTS = 16
#: The first steps, the first macro steps and the spread: as many rows as a run can ask for.
_ROW_SLOTS = 2 * FIRST_ROWS + SPREAD_ROWS + 1
_OK, _NEWTON_FAILED, _DIVERGED = 0, 1, 2


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


class Reading(NamedTuple):
    """The variables that a state holds, as they are reported."""

    q: Any
    v: Any
    a: Any
    lam: Any
    x: Any
    xdot: Any
    y: Any


@dataclass(frozen=True)
class StepMethod(Integrator):
    """Base of fixed-step (or step-pattern) methods written as pure JAX functions."""

    controls: ClassVar[str] = "step"

    @abstractmethod
    def numbers(self) -> Any:
        """The method's parameters, a pytree of numbers; traced in ``start`` and ``step``."""

    @staticmethod
    @abstractmethod
    def start(scene: MechatronicSystem, sizes: Sizes, numbers: Any, start: Start, h: Any) -> Any:
        """The method's state at t0, before a first step of size h."""

    @staticmethod
    @abstractmethod
    def step(
        scene: MechatronicSystem, sizes: Sizes, numbers: Any, state: Any, t: Any, h: Any
    ) -> tuple[Any, StepReport]:
        """Advance the state by h to time t."""

    @staticmethod
    @abstractmethod
    def read(state: Any) -> Reading:
        """The variables in a state."""

    def prepare(self, scene: MechatronicSystem, t_end: float, resolution: Steps) -> PreparedRun:
        return _March(self, scene, t_end, resolution)


class _March(PreparedRun):
    def __init__(
        self, method: StepMethod, scene: MechatronicSystem, t_end: float, resolution: Steps
    ) -> None:
        t0 = scene.interval[0]
        macro = resolution.count(t0, t_end)
        slots = len(resolution.pattern)
        fractions = np.zeros(_PATTERN_SLOTS)
        fractions[:slots] = resolution.pattern
        ends = np.cumsum(fractions)
        ends[slots - 1 :] = 1.0  # exactly, whatever the fractions' rounding
        rows = np.union1d(
            np.arange(min(FIRST_ROWS, macro * slots) + 1), spread_rows(macro) * slots
        )
        self._t0, self._t_end = t0, t_end
        self._rows = rows[rows > 0]
        # Slots that are not needed repeat the last row, at which the march stands still.
        padded = np.full(_ROW_SLOTS, self._rows[-1])
        padded[: len(self._rows)] = self._rows
        start = consistent_start(scene)
        self._start = start
        clock = Clock(t0, t_end - t0, macro, fractions, ends, slots)
        self._kernel = kernel(type(method), scene.template(), scene.sizes)
        arguments = (scene.parameters(), method.numbers(), start, clock, padded)
        self._arguments = jax.tree.map(jnp.asarray, arguments)
        # A march of no steps compiles the kernel and costs nothing else.
        nothing = (*self._arguments[:-1], jnp.zeros_like(self._arguments[-1]))
        jax.block_until_ready(self._kernel(*nothing))

    def execute(self) -> Any:
        return jax.block_until_ready(self._kernel(*self._arguments))

    def measure(self) -> Trajectory:
        reading, reached, times, status, counts, t = self.execute()
        kept = np.flatnonzero(np.asarray(reached)[: len(self._rows)] == self._rows)
        z = self._start.z
        first = Reading(z.q, z.v, z.a, z.lam, z.x, self._start.xdot, z.y)
        values = {
            name: np.concatenate([np.asarray(row0)[None], np.asarray(rows)[kept]])
            for name, row0, rows in zip(Reading._fields, first, reading, strict=True)
        }
        counts = [int(c) for c in counts]
        work = Work(counts[0], 0, *counts[1:])
        name, message = _outcome(int(status), float(t))
        t_rows = np.concatenate([[self._t0], np.asarray(times)[kept]])
        return Trajectory(t=t_rows, **values, status=name, message=message, work=work)


def _outcome(status: int, t: float) -> tuple[str, str]:
    if status == _NEWTON_FAILED:
        return "newton_failed", (
            f"Newton's method did not converge in the step to t={t:.6g} s; take a smaller step "
            f"or more numerical damping."
        )
    if status == _DIVERGED:
        return "diverged", (
            f"The solution grew beyond all bounds or was no longer finite in the step to "
            f"t={t:.6g} s; take a smaller step or more numerical damping, or check the scene's "
            f"forces there."
        )
    return "ok", ""


@cache
def kernel(method: type[StepMethod], template: MechatronicSystem, sizes: Sizes) -> Callable:
    """The compiled march of a method class on a scene, for any numbers and parameters."""

    def step_times(clock: Clock, n: Any) -> tuple[Any, Any]:
        macro, j = n // clock.slots, n % clock.slots
        t = clock.t0 + clock.length * ((macro + clock.ends[j]) / clock.macro_steps)
        return t, clock.length / clock.macro_steps * clock.fractions[j]

    def march(p: dict, numbers: Any, start: Start, clock: Clock, rows: Any) -> tuple:
        scene = template.with_parameters(p)
        state = method.start(scene, sizes, numbers, start, step_times(clock, 0)[1])
        first = method.read(state)
        bound = GROWTH_LIMIT * (1.0 + _largest(first.q, first.v))

        def one_step(carry: tuple) -> tuple:
            n, state, _, counts, _ = carry
            t, h = step_times(clock, n)
            state, report = method.step(scene, sizes, numbers, state, t, h)
            now = method.read(state)
            # A comparison with NaN is false: not finite counts as grown beyond the bound.
            sane = (_largest(now.q, now.v) < bound) & jnp.isfinite(_largest(now.a, now.lam))
            status = jnp.where(
                sane, jnp.where(report.converged, _OK, _NEWTON_FAILED), _DIVERGED
            )
            counts = tuple(c + r for c, r in zip(counts, (1, *report[1:]), strict=True))
            return n + 1, state, status, counts, t

        def to_row(carry: tuple, row: Any) -> tuple:
            carry = jax.lax.while_loop(
                lambda c: (c[0] < row) & (c[2] == _OK), one_step, carry
            )
            n, state, status, _, t = carry
            return carry, (method.read(state), jnp.where(status == _OK, n, -1), t)

        counts = (jnp.asarray(0),) * len(StepReport._fields)
        carry = (jnp.asarray(0), state, jnp.asarray(_OK), counts, clock.t0)
        carry, (reading, reached, times) = jax.lax.scan(to_row, carry, rows)
        _, _, status, counts, t = carry
        return reading, reached, times, status, counts, t

    return jax.jit(march)


def _largest(*parts: Any) -> Any:
    """Largest absolute value over arrays that may be empty; NaN if there is one."""
    return jnp.max(jnp.abs(jnp.concatenate([jnp.atleast_1d(p) for p in parts])))
