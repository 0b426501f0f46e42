"""The step control on plain numbers, and its time loop with errors that are prescribed."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from helpers import toy

from integrators import ErrorControl, Errors, Reading, StepMethod, Tolerances, option
from integrators.native.loops.adaptive_steps import Span, StepControl
from problems import jax, jnp

WIDE = 0.0, 5.0
#: Error at which the controller keeps the step of a method of order two: 0.9 E^(-0.3/3) = 1.
STEADY = 0.9**10


def control(
    order: int = 2, estimated: int | None = None, first: int = 2, tested: str = "qvx"
) -> Any:
    estimated = estimated or order
    about: Any = SimpleNamespace(
        order=order, order_of_estimate=estimated, order_of_first_step=first, tested=tested
    )
    return StepControl(about)


def ratio(error, before=1.0, order=2, limits=WIDE, solved=True, by=None):
    by = by or control()
    return float(by.ratio(*map(jnp.asarray, (error, before, order)), limits, jnp.asarray(solved)))


# ---- the next step -----------------------------------------------------------------------
def test_an_accepted_step_changes_by_its_error_and_the_one_before():
    assert ratio(STEADY, STEADY) == pytest.approx(1.0)
    assert ratio(1.0) == pytest.approx(0.9)
    assert ratio(2.0**-30, 1.0, order=2) == WIDE[1]
    assert ratio(1e-3, 1.0, order=6) == pytest.approx(0.9 * 10**0.3)
    assert ratio(1.0, 1e-3, order=5) == pytest.approx(0.9 * 10**-0.2)
    assert ratio(0.5, 0.1) < ratio(0.5, 0.5)  # errors that grow hold the step back


def test_limits_hold_and_steps_settle_where_the_error_stays():
    assert ratio(1e-12, limits=(0.8, 1.2)) == 1.2
    assert ratio(1.0, 1e-12, limits=(0.8, 1.2)) == 0.8
    assert ratio(1.0, 1e-40) == pytest.approx(0.1)
    # A rejected step shrinks by its own error alone.
    for before, limits in ((1.0, WIDE), (1e-4, (0.8, 1.2))):
        assert ratio(8.0, before, limits=limits) == pytest.approx(0.45)
        assert ratio(1.0 + 1e-9, before, limits=limits) == pytest.approx(0.9)
        assert ratio(1e9, before, limits=limits) == pytest.approx(0.1)
    assert ratio(0.5, solved=False) == ratio(1e9, solved=False) == 0.25
    h, before = 1e-3, 1.0
    for _ in range(80):
        error = (h / 0.1) ** 3
        h, before = h * ratio(error, before), error
    assert (h / 0.1) ** 3 == pytest.approx(STEADY, rel=1e-6)


def relative(errors, old, new, rtol=1e-4, atol=1e-6, by=None):
    """Largest error; errors and values are numbers by group, absent ones zero."""
    errors, old, new = (
        Errors(*(jnp.atleast_1d(jnp.asarray(given.get(g, 0.0))) for g in Errors._fields))
        for given in (errors, old, new)
    )
    at: Any = old, new
    return (by or control()).error(errors, *at, Span(0.0, 1.0, rtol, atol, 0))


def test_the_sum_of_errors_follows_the_tolerance():
    for order, estimated in [(2, 2), (3, 2)]:
        by, sums, counts = control(order, estimated), [], []

        @jax.jit
        def tried(size, before, rtol):
            one = {"q": 1.0}
            error = relative({"q": size ** (estimated + 1)}, one, one, rtol=rtol, atol=1e-12, by=by)
            return error, by.ratio(error, before, estimated, WIDE, jnp.asarray(True))

        for rtol in (1e-2, 1e-4):
            t, h, before, total, steps = 0.0, 1e-3, 1.0, 0.0, 0
            while t < 1.0:
                size = (1 + 9 * t) * h  # the motion becomes faster
                error, change = map(float, tried(size, before, rtol))
                if error <= 1:
                    t, before, total, steps = t + h, error, total + size ** (order + 1), steps + 1
                h *= change
            sums.append(total)
            counts.append(steps)
        assert sums[0] / sums[1] == pytest.approx(100, rel=0.3)
        assert counts[1] / counts[0] == pytest.approx(100 ** (1 / order), rel=0.3)


def test_errors_are_relative_to_the_larger_end_of_the_step():
    # Of states and order two, they may be tolerance times the root of rtol.
    for old, new in (([3.0, 4.0], [0.0, 1.0]), ([0.0, 1.0], [3.0, 4.0])):
        found = relative({"q": [3e-6, 4e-6]}, {"q": old}, {"q": new})
        assert found == pytest.approx(5e-6 / (1e-6 + 5e-4) / 1e-2)
    for group in ("v", "x"):
        found = relative({group: 1e-6, "q": 1e-9}, {group: 2.0, "q": 50.0}, {"q": 1.0})
        assert found == pytest.approx(1e-6 / (1e-6 + 2e-4) / 1e-2)


# ---- the first step ----------------------------------------------------------------------
def first_step(rtol=1e-6, t_end=1.0, tested="qvx", first=2, **values):
    zero = {name: np.zeros(1) for name in ("q", "v", "a", "x", "jerk", "xddot")}
    given = zero | {name: np.array([value]) for name, value in values.items()}
    start: Any = SimpleNamespace(z=SimpleNamespace(**given), **given)
    by = control(tested=tested, first=first)
    return float(by.first_step(start, Span(0.0, t_end, rtol, rtol / 100, 0)))


def test_the_first_step_makes_the_next_term_of_the_series_the_tolerance():
    for size, options in [
        (1e-3, {"q": 0.99, "v": 1e9, "jerk": 12.0}),  # rtol^(1.5/3)
        (10**-4.5, {"q": 1e9, "v": 0.99, "jerk": 1.0}),  # rtol^(1.5/2)
        (10**-4.5 / 2, {"x": 0.99, "xddot": 4.0, "tested": "x"}),
        (1e-3, {"q": 0.99, "v": 0.99, "jerk": 12.0, "tested": "q"}),
        (10**-1.5, {"q": 0.99, "v": 1e9, "jerk": 12.0, "first": 5, "t_end": 9.0}),  # rtol^(1.5/6)
        (10**-4.5 * np.sqrt(1.01), {"a": 100.0, "q": 1e9, "jerk": 1.0}),
        # At most a hundredth of the interval.
        *((0.01, of) for of in ({"q": 1.0}, {})),
        (0.05, {"t_end": 5.0}),
    ]:
        assert first_step(**options) == pytest.approx(size)


# ---- the time loop -----------------------------------------------------------------------
#: A mass at q = 1 that nothing moves.
Resting = toy("Resting", force=lambda self, q, v, t: 0.0 * q)
RTOL = 1e-4


@dataclass(frozen=True)
class Prescribed(ErrorControl, StepMethod):
    """A step errs by as much as is allowed where it is ``early`` or ``late`` long."""

    formulation: ClassVar = "ode"
    order: ClassVar = 2
    early: float = option(0.02, "allowed step in s before ``turn``")
    late: float = option(0.02, "allowed step in s after it")
    turn: float = option(0.5, "time in s")
    end: float = option(2.0, "time in s after which values are not numbers")

    def begin(self, scene, start, h):
        return jnp.asarray(start.z.t)

    def step(self, scene, state, t, h, work):
        return jnp.where(t <= self.end, t, jnp.nan)

    def read(self, scene, state):
        one, none = jnp.ones(1) + 0.0 * state, jnp.zeros(0)
        return Reading(one, 0 * one, 0 * one, none, none, none, none)

    def estimate(self, before, after, h):
        allowed = jnp.where(after <= self.turn, self.early, self.late)
        q = jnp.atleast_1d((h / allowed) ** 3 * 1.01 * RTOL**1.5)
        return Errors(q, 0 * q, jnp.zeros(0))


def run_of(**options):
    run = Prescribed(**options).prepare(Resting(), 1.0, Tolerances(RTOL)).measure()
    return run, np.diff(run.t)


def test_steps_go_to_the_steady_error_and_meet_the_end():
    run, h = run_of()
    assert (run.status, run.t[-1], run.work.rejected) == ("ok", 1.0, 0)
    assert h[0] == pytest.approx(0.01)
    assert h[40:-3] == pytest.approx(0.02 * STEADY ** (1 / 3), rel=1e-4)
    assert h[-1] == pytest.approx(h[-2], rel=1e-12)  # the rest is halved, so that no step is tiny
    assert h[-1] > h[-3] / 2


def test_rejected_steps_are_counted_and_change_nothing():
    run, h = run_of(late=1e-3)
    # From 0.014 to 0.1 of it, to 0.9/1.4 of that.
    assert (run.status, run.t[-1], run.work.rejected) == ("ok", 1.0, 2)
    late = run.t[1:] > 0.5
    assert h[late].max() <= 1e-3
    assert h[~late].max() > 0.01
    assert run.work.steps == len(h)
    assert (np.diff(run.t) > 0).all()


def test_steps_that_give_no_numbers_or_are_always_too_large_end_with_a_status():
    run, _ = run_of(end=0.4)  # quartered down to the rounding of time
    assert (run.status, run.t[-1]) == ("diverged", pytest.approx(0.4, abs=1e-14))
    assert 20 < run.work.rejected < 40
    assert np.isfinite(run.q).all()
    run, _ = run_of(late=1e-20)
    assert (run.status, run.t[-1]) == ("step_too_small", pytest.approx(0.5, abs=1e-13))
