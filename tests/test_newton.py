"""Newton's method and the control of steps, on plain numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from helpers import toy

from integrators import ErrorControl, Errors, Reading, StepMethod, Tolerances, option
from integrators.native.algebra.linear_solvers import LinearSolver, Once
from integrators.native.algebra.newton import Bounds, newton
from integrators.native.loops.adaptive_steps import Span, StepControl
from problems import jax, jnp

NEVER = math.nan


class Slopes(LinearSolver):
    """Tangents of separate equations are numbers; ``log`` has "t" for a new one, "u" for a use."""

    def __init__(self, slope: Callable[[Any], Any]) -> None:
        self._slope, self.log, self.places = slope, "", []

    def once(self, residual, u):
        return Once(self.update(self.renewed(residual, u, u), residual(u)))

    def nothing_kept(self, size):
        return jnp.full(size, jnp.nan)

    def renewed(self, residual, u, kept):
        self.log += "t"
        self.places.append(float(u[0]))
        return self._slope(u)

    def update(self, kept, r):
        self.log += "u"
        return r / kept

    def known(self, kept):
        return ~jnp.isnan(kept[0])


def solve(
    residual, slope, guess, kept=None, old=None, tol=1e-12, most=20, rounding=0.0, noise=0.0,
    solved_after=math.inf, cuts=(), to_rounding=False,
):  # fmt: skip
    """Newton's method in Python's own time: nothing is compiled."""
    guess, groups, linear = np.atleast_1d(guess).astype(float), len(cuts) + 1, Slopes(slope)
    old = guess if old is None else np.atleast_1d(old).astype(float)
    with jax.disable_jit():
        u, _, report = newton(
            residual, jnp.asarray(guess), jnp.asarray(old),
            Bounds(list(cuts), tol, (rounding,) * groups, (noise,) * groups), most,
            None if kept is None else jnp.full(guess.shape, kept), linear, solved_after,
            to_rounding=to_rounding,
        )  # fmt: skip
    assert report.jacobians == linear.log.count("t") or kept is None
    assert report.newton == report.residuals == report.solves == linear.log.count("u")
    return SimpleNamespace(u=np.asarray(u), report=report, log=linear.log, places=linear.places)


def root_of_two(tol=1e-12, **options):
    return solve(lambda u: u**2 - 2, lambda u: 2 * u, 1.5, tol=tol, **options)


def alternating(size):
    """u = 1 with an error of rounding that changes its sign at each call."""
    calls = []

    def residual(u):
        calls.append(u)
        return u - 1 + size * (-1) ** len(calls)

    return residual


# ---- contraction -------------------------------------------------------------------------
def test_it_ends_when_the_error_left_by_the_contraction_is_small():
    for tol, iterations in [(1e-12, 4), (1e-8, 3), (1e-5, 3), (1e-2, 2)]:
        # Updates 0.083, 0.0025, 2.1e-6, 1.6e-12: the last leaves its size times the last quotient.
        found = root_of_two(tol)
        assert (found.report.solved, found.report.converged) == (True, True)
        assert found.report.newton == iterations
        assert abs(found.u[0] - math.sqrt(2)) < tol * math.sqrt(2)


def test_each_group_is_measured_by_its_own_size_now_or_before():
    def residual(u):
        return u**2 - jnp.array([2.0, 2e-20])

    guess = np.array([1.5, 1.5e-10])
    one, two = (solve(residual, lambda u: 2 * u, guess, cuts=cuts, tol=1e-8) for cuts in ((), (1,)))
    assert one.report.newton == two.report.newton == 3  # both contract alike
    slow = np.array([1.5, 1e-9])  # the second group starts far off, as seen by itself alone
    one, two = (solve(residual, lambda u: 2 * u, slow, cuts=cuts, tol=1e-8) for cuts in ((), (1,)))
    assert one.report.newton == 3 < two.report.newton
    assert two.u[1] == pytest.approx(math.sqrt(2e-20), rel=1e-8)
    before = solve(residual, lambda u: 2 * u, slow, cuts=(1,), old=[1.5, 1.0], tol=1e-8)
    assert before.report.newton == 3
    assert root_of_two(old=0.0).report.newton == 4


def test_linear_equations_and_known_solutions_need_no_further_update():
    for solved_after, iterations in [(0, 0), (1, 1), (math.inf, 2)]:
        found = solve(
            lambda u: 3 * u - 6,
            lambda u: 3 + 0 * u,
            2.0 if solved_after == 0 else 7.0,
            solved_after=solved_after,
        )
        assert found.report.solved
        assert found.report.newton == iterations
        assert found.u[0] == pytest.approx(2.0, rel=1e-15)


def test_an_update_by_an_old_tangent_is_never_enough():
    found = solve(lambda u: 3 * u - 6, lambda u: 3 + 0 * u, 7.0, kept=3.1, solved_after=1)
    assert found.report.newton > 1
    assert abs(found.u[0] - 2) < 7e-12  # its size is that of the guess


# ---- stale tangents ----------------------------------------------------------------------
def test_a_tangent_is_kept_while_updates_contract_tenfold_and_renewed_after_the_third_else():
    for kept, begins in ((1.05, "uuu"), (1.2, "uuut")):
        found = solve(lambda u: u - 1, lambda u: 1 + 0 * u, 1.5, kept=kept)
        assert found.report.solved
        assert found.log.startswith(begins)
        assert ("t" in found.log) == (kept == 1.2)
        assert abs(found.u[0] - 1) < 1e-12
    # The first update is no measure of the tangent: the second may be five times as large, as
    # where a guess is good in what weighs most.
    pulls = iter([0.02, 0.1, 0.001, 1e-5, 1e-7, 1e-9, 1e-11, 1e-13, 0.0])
    found = solve(lambda u: 0 * u + next(pulls), lambda u: NEVER * u, 1.0, kept=1.0)
    assert found.report.solved
    assert "t" not in found.log


def test_without_a_tangent_or_after_a_wild_update_a_new_one_is_computed_at_the_guess():
    for guess, kept, log in ((2.01, NEVER, "tu"), (2.1, 1e-14, "utu")):
        found = solve(lambda u: u**3 - 8, lambda u: 3 * u**2, guess, kept=kept, old=2.2)
        assert found.report.solved
        assert found.log.startswith(log)
        assert found.places[0] == guess  # and neither where the update led nor the start
        assert found.u[0] == pytest.approx(2.0, rel=1e-12)


# ---- round-off ---------------------------------------------------------------------------
def test_tiny_updates_that_no_longer_shrink_have_met_rounding():
    for kept in [None, 1.0]:
        for size, solved in [(1e-9, True), (1e-6, False)]:
            found = solve(
                alternating(size), lambda u: 1 + 0 * u, 1 + 3 * size, kept=kept, tol=1e-14
            )
            assert found.report.solved == solved
            assert abs(found.u[0] - 1) <= 3 * size
            assert found.report.newton == 2 or not solved or kept
            assert kept is None or "t" in found.log  # an old tangent may be what does not shrink


def test_the_rounding_of_a_group_counts_eightfold_for_a_new_tangent():
    for kept, factor in ((None, 8.0), (1.0, 1.0)):
        for part, iterations in ((0.9, 1), (1.1, 2)):
            update = iter([part * factor * 1e-6, 0.0])
            found = solve(
                lambda u, update=update: 0 * u + next(update), lambda u: 1 + 0 * u, 0.0,
                kept=kept, rounding=1e-6, most=2,
            )  # fmt: skip
            assert (found.report.solved, found.report.newton) == (True, iterations)


def test_updates_by_an_old_tangent_go_on_to_rounding_where_it_is_asked_for():
    def left(to_rounding):
        found = solve(
            lambda u: u - 1, lambda u: 1 + 0 * u, 1.5, kept=1.05, rounding=1e-8,
            to_rounding=to_rounding,
        )  # fmt: skip
        assert found.report.solved
        assert "t" not in found.log
        return abs(found.u[0] - 1)

    assert left(to_rounding=True) < 2e-11 < left(to_rounding=False) < 1e-8
    # Rounding within the bounds ends it, and no new tangent is computed for that.
    noisy = solve(alternating(1e-9), lambda u: NEVER * u, 1.5, kept=1.0, rounding=1e-8,
                  to_rounding=True)  # fmt: skip
    assert noisy.report.solved
    assert noisy.log == "u" * noisy.report.newton


def test_at_rest_updates_within_the_noise_of_forces_are_nothing():
    def at_rest(noise, **options):
        residual = alternating(1e-9)
        return solve(
            lambda u: residual(u + 1), lambda u: 1 + 0 * u, 0.0, noise=noise, most=8, **options
        )

    assert at_rest(1e-8).report.solved
    assert at_rest(1e-8).report.newton == 2  # the first has no predecessor to be compared with
    assert not at_rest(1e-10).report.solved
    assert "t" in at_rest(1e-8, kept=1.0, old=1e-6).log  # only a new tangent can tell
    for shrinks, iterations in ((0.5, 2), (0.05, 3)):  # the latter is convergence
        updates = iter([9e-9, 9e-9 * shrinks, 0.0])
        found = solve(lambda u, of=updates: next(of) + 0 * u, lambda u: 1 + 0 * u, 0.0, noise=1e-8)
        assert (found.report.solved, found.report.newton) == (True, iterations)


# ---- failures ----------------------------------------------------------------------------
def test_an_iteration_that_diverges_or_meets_no_number_ends_and_modified_newton_tries_full():
    def arctan(**options):
        return solve(jnp.arctan, lambda u: 1 / (1 + u**2), 1.5, most=4, **options)

    assert (arctan().report.solved, arctan().report.newton) == (False, 4)
    found = arctan(kept=NEVER, old=0.5)  # from the start of the step
    assert found.report.solved
    assert 4 < found.report.newton <= 8
    assert 0.5 in found.places
    assert abs(found.u[0]) < 1e-12
    for solved_after in (1, math.inf):
        found = solve(lambda u: NEVER * u, lambda u: 1 + 0 * u, 1.0, solved_after=solved_after)
        assert (found.report.solved, found.report.newton) == (False, 1)


def test_after_such_a_value_modified_newton_tries_new_tangents_and_then_the_start():
    def beyond(limit):
        return lambda u: jnp.where(u < limit, u**2 - 4, NEVER)

    # An old tangent led there; a new one at the guess does not.
    found = solve(beyond(3.0), lambda u: 2 * u, 2.5, kept=-0.1)
    assert (found.report.solved, found.places[0]) == (True, 2.5)
    # The guess itself lies there; the start of the step does not.
    found = solve(beyond(3.0), lambda u: 2 * u, 3.5, kept=5.0, old=2.2)
    assert (found.report.solved, found.places[-1]) == (True, pytest.approx(2.0))
    assert 2.2 in found.places
    # All lie there.
    found = solve(beyond(1.0), lambda u: 2 * u, 3.5, kept=5.0, old=2.2)
    assert not found.report.solved
    assert found.report.newton == 3


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
