"""Newton's method on equations of one or two numbers, with the order of its tangents noted."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

from integrators.native.algebra.linear_solvers import LinearSolver, Once
from integrators.native.algebra.newton import Bounds, newton
from integrators.native.algebra.step_records import StepReport
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


class Solved(NamedTuple):
    u: np.ndarray
    report: StepReport
    log: str
    places: list[float]


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
    return Solved(np.asarray(u), report, linear.log, linear.places)


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
